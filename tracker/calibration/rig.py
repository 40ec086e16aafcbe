"""The rig: all cameras that see the arena, in a fixed order, and the arena."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from tracker.calibration.arena_file import read_arena, write_arena
from tracker.calibration.platform_files import read_camera, write_camera
from tracker.errors import CalibrationError
from tracker.geometry.arena import Arena
from tracker.geometry.camera import Camera


@dataclasses.dataclass(frozen=True, eq=False)
class CameraRig:
    """One or more cameras with different names; images are given in the order of `cameras`.

    Raises:
        CalibrationError: there is no camera, or two have the same name.
    """

    cameras: tuple[Camera, ...]
    """The cameras, in the order of the images."""
    arena: Arena = dataclasses.field(default_factory=Arena)
    """Where the object may be, and where the table is."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if not self.cameras:
            raise CalibrationError("camera rig: found no camera, expected at least one")
        if not isinstance(self.arena, Arena):
            raise CalibrationError(f"camera rig: arena: found {self.arena!r}, expected a tracker.Arena")
        names = [camera.name for camera in self.cameras]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise CalibrationError(f"camera rig: found {twice[0]} twice, expected different names")

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def __getitem__(self, index: int) -> Camera:
        return self.cameras[index]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras, in order."""
        return tuple(camera.name for camera in self.cameras)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
        *,
        pattern: str | None = None,
        correct_halved_principal_point: bool = False,
    ) -> CameraRig:
        """Load the calibration files of a folder, or those listed, and `arena.toml` beside them.

        Args:
            path: a folder with one platform file per camera; or a file; or files, whose order is kept.
                A folder's cameras are ordered by the number in their name, then by name. The arena's file
                is looked for beside files that are all in one folder; without it the arena is the default.
            pattern: which files of the folder to load, e.g. `*_cropped.yml`; by default every .yml and
                .yaml file with `camera` in its name.
            correct_halved_principal_point: see `platform_files.read_camera`.

        Raises:
            CalibrationError: a file is missing or malformed, the folder has no calibration file, or
                several of the same camera (the message says how to select).
        """
        if not isinstance(path, (str, os.PathLike)):
            return cls._of_files([Path(item) for item in path], correct_halved_principal_point)
        root = Path(path)
        if not root.is_dir():
            return cls._of_files([root], correct_halved_principal_point)
        files = calibration_files(root, pattern)
        cameras = {file: _read(file, correct_halved_principal_point) for file in files}
        refuse_variants(root, {file.name: camera.name for file, camera in cameras.items()})
        ordered = sorted(cameras, key=lambda file: camera_order(cameras[file].name, file.name))
        return cls(tuple(cameras[file] for file in ordered), read_arena(root))

    @classmethod
    def _of_files(cls, files: list[Path], correct_halved_principal_point: bool) -> CameraRig:
        cameras = tuple(_read(file, correct_halved_principal_point) for file in files)
        folders = {file.parent.resolve() for file in files}
        return cls(cameras, read_arena(files[0].parent) if len(folders) == 1 else Arena())

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write one platform file per camera, e.g. `camera60.yml`, so that `load(folder)` finds them.

        An arena other than the default is written beside them; an `arena.toml` of old is replaced by it, or
        removed.

        Raises:
            CalibrationError: a name cannot be a file's, or a file cannot be written.
        """
        root = Path(folder)
        for name in self.names:
            if not re.fullmatch(r"[\w-][\w.-]*", name):
                raise CalibrationError(f"{name!r}: as a file's name expected letters, digits, '_', '-', '.'")
        try:
            root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CalibrationError(f"{root}: cannot be made a folder: {error.strerror or error}") from error
        for camera in self.cameras:
            stem = camera.name if "camera" in camera.name else f"camera_{camera.name}"
            write_camera(camera, root / f"{stem}.yml")
        write_arena(self.arena, root)

    def resized(self, width: int, height: int) -> CameraRig:
        """The rig of images scaled to `width` × `height` [px]; see `Camera.resized`."""
        return dataclasses.replace(
            self, cameras=tuple(camera.resized(width, height) for camera in self.cameras)
        )


def _read(path: Path, correct_halved_principal_point: bool) -> Camera:
    return read_camera(path, correct_halved_principal_point=correct_halved_principal_point)


def calibration_files(root: Path, pattern: str | None) -> list[Path]:
    """A folder's calibration files, or those whose names match; CalibrationError where there is none."""
    names = sorted(file.name for file in root.iterdir() if file.is_file())
    if pattern is None:
        files = [
            name for name in names if re.fullmatch(r"[^.].*\.ya?ml|[^.]\.ya?ml", name) and "camera" in name
        ]
        wanted = "a file like camera60.yml"
    else:
        files = [name for name in names if fnmatchcase(name, pattern)]
        wanted = f"a file that matches {pattern!r}"
    if not files:
        found = ", ".join(names[:12]) or "no files"
        raise CalibrationError(f"{root}: found {found}, expected {wanted}")
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
