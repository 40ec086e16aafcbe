"""Calibration files of several robots in one folder, such as `r1_camera60.yml` and `r3_camera60.yml`."""

from __future__ import annotations

import re
from pathlib import Path

_NAME = re.compile(r"(r\d+)_camera.*\.ya?ml")


def robots_in(folder: Path) -> list[str]:
    """The robots, such as `r1`, whose calibration files are in a folder; none where there are none."""
    names = (file.name for file in folder.iterdir()) if folder.is_dir() else ()
    found = {match[1] for name in names if (match := _NAME.fullmatch(name))}
    return sorted(found, key=lambda robot: (int(robot[1:]), robot))


def pattern_of(robot: str) -> str:
    """Which files of the folder are of a robot."""
    return f"{robot}_camera*.y*ml"
