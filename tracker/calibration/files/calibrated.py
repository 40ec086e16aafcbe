"""A camera as a calibration leaves it: with the standard deviation of every parameter, and its file.

The file is the platform's, with two keys more, `camera_matrix_std` and `distortion_coefficients_std`,
which other readers pass over. Where only the lens has been calibrated, it has no `tf_world_to_camera`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from tracker.calibration.files import platform
from tracker.calibration.files.folder import read_folder, refuse_variants
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera

_MATRIX_KEY, _DISTORTION_KEY = "camera_matrix_std", "distortion_coefficients_std"


@dataclasses.dataclass(frozen=True, eq=False)
class Calibrated:
    """A camera and how well its parameters are known."""

    camera: Camera
    matrix_std: FloatArray | None = None
    """(3, 3) standard deviations of `camera.matrix` [px], or None where unknown."""
    distortion_std: FloatArray | None = None
    """(5,) standard deviations of `camera.distortion`, or None where unknown."""
    placed: bool = True
    """Whether the camera's place in the world is known; if not, `camera_from_world` is the identity."""

    def cropped(self, left: int, top: int, width: int, height: int) -> Calibrated:
        """Of the images' part of `width` × `height` that starts at (left, top) [px].

        Raises:
            CalibrationError: there is no such part.
        """
        one = self.camera
        if not (0 <= left <= one.width - width and 0 <= top <= one.height - height and width > 0 < height):
            raise CalibrationError(
                f"{one.name}: found the part {width}x{height}+{left}+{top}, expected one inside of "
                f"{one.width}x{one.height}"
            )
        return dataclasses.replace(self, camera=one.cropped(left, top, width, height))

    def resized(self, width: int, height: int) -> Calibrated:
        """Of the images scaled to `width` × `height` [px], see `Camera.resized`."""
        scale = np.array([[width / self.camera.width], [height / self.camera.height], [1.0]])
        std = None if self.matrix_std is None else self.matrix_std * scale
        return dataclasses.replace(self, camera=self.camera.resized(width, height), matrix_std=std)


def read_calibrated(path: str | os.PathLike[str]) -> Calibrated:
    """Read a file of the platform, or one of a lens alone, with the deviations that it states.

    Raises:
        CalibrationError: the file is missing, unreadable or malformed; the message names file and key.
    """
    data = platform.read_mapping(Path(path))
    placed = any(key in data for key in platform.TRANSFORM_KEYS)
    if not placed:
        data[platform.TRANSFORM_KEYS[0]] = platform.matrix_entry(np.eye(4))
    try:
        camera = platform.camera_of(data)
        matrix_std = platform.matrix_of(data, _MATRIX_KEY, (3, 3)) if _MATRIX_KEY in data else None
        distortion_std = (
            platform.matrix_of(data, _DISTORTION_KEY, (1, 5)).ravel() if _DISTORTION_KEY in data else None
        )
    except CalibrationError as error:
        raise CalibrationError(f"{os.fspath(path)}: {error}") from error
    return Calibrated(camera, matrix_std, distortion_std, placed)


def write_calibrated(calibrated: Calibrated, path: str | os.PathLike[str]) -> None:
    """Write the file, whole or not at all; `read_calibrated` returns the same bits.

    Raises:
        CalibrationError: the file cannot be written.
    """
    data = platform.entries(calibrated.camera)
    if not calibrated.placed:
        del data[platform.TRANSFORM_KEYS[0]]
    if calibrated.matrix_std is not None:
        data[_MATRIX_KEY] = platform.matrix_entry(calibrated.matrix_std)
    if calibrated.distortion_std is not None:
        data[_DISTORTION_KEY] = platform.matrix_entry(calibrated.distortion_std[None])
    platform.write_mapping(data, path)


def read_all_calibrated(paths: Sequence[Path], pattern: str | None = None) -> tuple[Calibrated, ...]:
    """Read the files given; or those of a folder, one of each camera, in the order of `CameraRig.load`.

    Raises:
        CalibrationError: a file is missing or malformed, or the folder holds none or several of a camera.
    """
    if len(paths) == 1 and paths[0].is_dir():
        return read_folder(paths[0], pattern, read_calibrated, lambda one: one.camera.name)
    found = {path: read_calibrated(path) for path in paths}
    refuse_variants(Path(), {str(path): one.camera.name for path, one in found.items()})
    return tuple(found.values())


def focal_deviations(found: Iterable[Calibrated]) -> dict[str, float]:
    """By the camera's name, the larger standard deviation of its focal lengths [themselves], where stated."""
    return {
        one.camera.name: float((one.matrix_std[(0, 1), (0, 1)] / one.camera.matrix[(0, 1), (0, 1)]).max())
        for one in found
        if one.matrix_std is not None
    }


def halved_by_rows(path: Path) -> bool:
    """Whether a file's principal point c/2 was halved with K[:2], where pixel centres ask for c/2 - ¼.

    The file of twice the size beside it shows this, else the name that the platform gives to such
    files; those that state their deviations are of this package, which does it right.
    """
    mine = read_calibrated(path)
    for other in path.parent.glob("*.y*ml"):
        with contextlib.suppress(CalibrationError):
            whole = read_calibrated(other).camera
            sizes = (whole.width, whole.height) == (2 * mine.camera.width, 2 * mine.camera.height)
            same = np.allclose(
                whole.matrix[(0, 1), (0, 1)], 2 * mine.camera.matrix[(0, 1), (0, 1)], rtol=1e-9
            )
            if whole.name == mine.camera.name and sizes and same:
                return np.allclose(whole.matrix[:2, 2], 2 * mine.camera.matrix[:2, 2], atol=1e-6)
    return mine.matrix_std is None and path.stem.endswith("_downsampled")
