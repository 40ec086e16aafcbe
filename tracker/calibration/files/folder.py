"""Which files of a folder are of the cameras, one of each, and in what order.

Files of several robots may lie in one folder, such as `r1_camera60.yml` and `r3_camera60.yml`.
"""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from pathlib import Path

from tracker.errors import CalibrationError


def calibration_files(root: Path, pattern: str | None) -> list[Path]:
    """A folder's calibration files, or those whose names match; CalibrationError where there is none."""
    names = sorted(file.name for file in root.iterdir() if file.is_file())
    yaml = [name for name in names if re.fullmatch(r"[^.].*\.ya?ml|[^.]\.ya?ml", name)]
    if pattern is None:
        files, expected = [name for name in yaml if "camera" in name], "a file like camera60.yml"
        if yaml:
            star = f"*{Path(yaml[0]).suffix}"
            expected += f", or --pattern '{star}' (in Python pattern='{star}') for other names"
    else:
        files = [name for name in names if fnmatchcase(name, pattern)]
        expected = f"a file that matches {pattern!r}"
    if not files:
        found = ", ".join(names[:12]) or "no files"
        raise CalibrationError(f"{root}: found {found}, expected {expected}")
    return [root / name for name in files]


def camera_order(camera_name: str, file_name: str) -> tuple[float, str, str]:
    """Sorting key: the number in the camera's name, else in the file's; without one, last."""
    number = re.search(r"\d+", camera_name) or re.search(r"camera\D*(\d+)", file_name)
    digits = number.group(number.lastindex or 0) if number else ""
    return (float(digits) if digits else float("inf"), camera_name, file_name)


def refuse_variants(root: Path, camera_of_file: dict[str, str]) -> None:
    """Raise where several files hold the same camera, naming the patterns that tell them apart."""
    names = list(camera_of_file.values())
    twice = sorted({name for name in names if names.count(name) > 1})
    if not twice:
        return
    same = sorted(file for file, name in camera_of_file.items() if name == twice[0])
    patterns = sorted({_pattern(file, camera_of_file) for file in camera_of_file} - {""})
    how = f'CameraRig.load(folder, pattern="{patterns[0]}"), or ' if patterns else ""
    variants = f"; variants: {', '.join(patterns)}" if patterns else ""
    raise CalibrationError(
        f"{root}: found {len(same)} files of {twice[0]} ({', '.join(same)}), expected one of each camera"
        f"{variants}; select with {how}CameraRig.load([file, ...])"
    )


def _pattern(file: str, camera_of_file: dict[str, str]) -> str:
    """A pattern that selects the variant of `file`, one file per camera; empty where there is none."""
    for star in ("*", "*[0-9]"):
        pattern = re.sub(r"(camera\D*?)\d+", rf"\g<1>{star}", file, count=1)
        chosen = [name for other, name in camera_of_file.items() if fnmatchcase(other, pattern)]
        if pattern != file and len(chosen) == len(set(chosen)):
            return pattern
    return ""


_NAME = re.compile(r"(r\d+)_camera.*\.ya?ml")


def robots_in(folder: Path) -> list[str]:
    """The robots, such as `r1`, whose calibration files are in a folder; none where there are none."""
    names = (file.name for file in folder.iterdir()) if folder.is_dir() else ()
    found = {match[1] for name in names if (match := _NAME.fullmatch(name))}
    return sorted(found, key=lambda robot: (int(robot[1:]), robot))


def pattern_of(robot: str) -> str:
    """Which files of the folder are of a robot."""
    return f"{robot}_camera*.y*ml"
