"""The rig: all cameras that see the arena, in a fixed order, and the arena.

The arena is stated beside the camera files, in one TOML file, `arena.toml`: the fields of
`geometry.arena.Arena`, each optional; table = "none" means that the arena has none.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tracker.calibration.files import Calibrated, calibration_text, file_name, read_all_calibrated
from tracker.checks import naming, of_kind, path_of
from tracker.errors import CalibrationError, shown
from tracker.files import claimed, write_together, writing
from tracker.files.toml import read_toml
from tracker.geometry.arena import Arena
from tracker.geometry.camera import Camera

ARENA_FILE = "arena.toml"
"""Name of the arena's file in the folder of the camera files."""

_NO_TABLE = "none"


def read_arena(folder: Path) -> Arena:
    """Return the arena of a folder, or the default; CalibrationError: its file is unreadable or malformed."""
    path = folder / ARENA_FILE
    if not os.path.lexists(path):  # a link to nothing is an error
        return Arena()
    values = read_toml(path, CalibrationError, tuple(field.name for field in dataclasses.fields(Arena)))
    if values.get("table") == _NO_TABLE:
        values["table"] = None
    with naming(path, CalibrationError):
        return Arena(**values)


def rig_texts(rig: CameraRig, lenses: Mapping[str, Calibrated] = {}) -> dict[str, str]:
    """Return the texts of a rig's files by name, see `save_rig`; CalibrationError: two have the same one."""
    texts: dict[str, str] = {}
    for camera in rig:
        file = file_name(camera.name)
        if file in texts:
            raise CalibrationError(f"camera rig: found two cameras for {file}, expected other names")
        lens = lenses.get(camera.name, Calibrated(camera))
        texts[file] = calibration_text(dataclasses.replace(lens, camera=camera))
    if rig.arena != Arena():
        values = dataclasses.asdict(rig.arena)
        if rig.arena.table is None:
            values["table"] = _NO_TABLE
        # Strings, numbers and lists look the same in JSON and TOML.
        lines = [f"{key} = {json.dumps(value)}\n" for key, value in values.items()]
        title = "# Where the object may be and where the table is, in the cameras' world [m, rad].\n"
        texts[ARENA_FILE] = title + "".join(lines)
    return texts


def save_rig(
    rig: CameraRig,
    folder: str | os.PathLike[str],
    lenses: Mapping[str, Calibrated] = {},
    others: Mapping[str, str] = {},
) -> None:
    """Write a rig as `CameraRig.save` does: all files, or none if one cannot be written.

    lenses: how well lenses are known, by the cameras' names; others: texts of further files, by name.
    """
    texts = rig_texts(rig, lenses)
    with writing(CalibrationError, folder):
        root = Path(folder)
        root.mkdir(parents=True, exist_ok=True)
        with claimed(root / ARENA_FILE):  # the files of two runs would mix
            write_together((root / name, text) for name, text in {**texts, **others}.items())
            if ARENA_FILE not in texts:
                (root / ARENA_FILE).unlink(missing_ok=True)


@dataclasses.dataclass(frozen=True, eq=False)
class CameraRig:
    """One or more cameras with different names; images are given in the order of `cameras`.

    Attributes:
        cameras: the cameras, in the order of the images.
        arena: where the object may be, and where the table is.

    Raises:
        CalibrationError: there is no camera, something is not a Camera, or two have the same name.
    """

    cameras: tuple[Camera, ...]
    arena: Arena = dataclasses.field(default_factory=Arena)

    def __post_init__(self) -> None:
        given: Any = self.cameras
        alone = not isinstance(given, Iterable) or isinstance(given, str | np.ndarray)
        cameras = (given,) if alone else tuple(given)
        for one in cameras:
            if not isinstance(one, Camera):
                valid = "tracker.Cameras (CameraRig.load reads files)"
                raise CalibrationError(f"camera rig: found {shown(one)}, expected {valid}")
        object.__setattr__(self, "cameras", cameras)
        if not cameras:
            raise CalibrationError("camera rig: found no camera, expected at least one")
        of_kind(self.arena, Arena, "camera rig: arena", CalibrationError)
        twice = sorted(name for name in self.names if self.names.count(name) > 1)
        if twice:
            raise CalibrationError(f"camera rig: found {twice[0]} twice, expected different names")

    def __repr__(self) -> str:
        sizes = [f" of {camera.width}×{camera.height} px" for camera in self.cameras]
        of_all = sizes[0] if len(set(sizes)) == 1 else ""
        each = ("" if of_all else size for size in sizes)
        cameras = ", ".join(map("".join, zip(self.names, each, strict=True)))
        return f"CameraRig({cameras}{of_all}; {self.arena})"

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def __getitem__(self, index: int) -> Camera:
        return self.cameras[index]

    def agrees_with(self, other: CameraRig) -> bool:
        """Whether arena and cameras, in their order, are bitwise the same."""
        return (self.names, self.arena) == (other.names, other.arena) and all(
            np.array_equal(getattr(first, field.name), getattr(second, field.name))
            for first, second in zip(self, other, strict=True)
            for field in dataclasses.fields(first)
        )

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
            path: a folder with one file per camera; or a file; or files, whose order is kept. The cameras of
                a folder are ordered by the number in their name, then by name. Without `arena.toml`, or with
                files of several folders, the arena is the default.
            pattern: the files of the folder to load, e.g. `*_cropped.yml`; by default every .yml and
                .yaml file with `camera` in its name, or all if none has it.
            correct_halved_principal_point: move the principal point back by a quarter of a pixel, left and
                up, for files made by halving K[:2] (the platform's `*_cropped_and_downsampled.yml` and the
                270×270 `camera*.yml` of a job's output).

        Raises:
            CalibrationError: a file is missing or malformed, or the folder has no calibration file or
                several files of one camera (the message says how to select).
        """
        of_kind(correct_halved_principal_point, bool, "correct_halved_principal_point", CalibrationError)
        if pattern is not None and not isinstance(pattern, str):
            raise CalibrationError(f"pattern: found {shown(pattern)}, expected a text, e.g. '*_cropped.yml'")
        alone = not isinstance(path, Iterable) or isinstance(path, str | os.PathLike | bytes | np.ndarray)
        items: Any = [path] if alone else path
        valid = "cameras' files, or their folder"
        files = [path_of(item, "camera rig", CalibrationError, valid) for item in items]
        cameras = [one.camera for one in read_all_calibrated(files, pattern, alone=False)]
        folders = [file if file.is_dir() else file.parent for file in files]
        together = len({folder.resolve() for folder in folders}) == 1
        arena = read_arena(folders[0]) if together else Arena()
        if correct_halved_principal_point:
            cameras = [camera.with_halved_principal_point_corrected() for camera in cameras]
        return cls(tuple(cameras), arena)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write one platform file per camera, e.g. `camera60.yml`, so that `load(folder)` finds them.

        An arena other than the default is written to `arena.toml` beside them; for the default arena, an
        existing `arena.toml` is removed. Files of other cameras stay, and `load(folder)` loads them, too.

        Raises:
            CalibrationError: a file cannot be written, and none was; or two would have the same name (left,
                camera_left).
        """
        save_rig(self, folder)

    def resized(self, width: int, height: int) -> CameraRig:
        """Return the rig for images scaled to `width` × `height` [px]; see `Camera.resized`."""
        return dataclasses.replace(self, cameras=tuple(camera.resized(width, height) for camera in self))
