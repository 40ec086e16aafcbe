"""Folders of PNG or JPEG pictures, or of films."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import naming
from tracker.conventions import Image
from tracker.errors import LogError
from tracker.files import read_bounded, told_of
from tracker.logs.films import FilmPicture
from tracker.logs.folder_layout import Picture, find_shots
from tracker.logs.frame import LogFrame, checked_stamp
from tracker.logs.log import MAX_SIDE, Source, rig_beside
from tracker.logs.pictures import decode, encoded_size

TRUTH_FILE = "ground_truth.json"
"""What `python -m synthetic dataset` writes beside the pictures; stamps are taken from it."""

_PAUSE = 8  # frames; dropped pictures of a sequence are single ones, between motions there are 10 or more

_MAX_FILE = 4 * MAX_SIDE * MAX_SIDE  # more bytes than the largest picture, uncompressed
_MAX_TRUTH = 1 << 28  # bytes; a frame has about 1000


class FolderSource(Source):
    """A folder of pictures."""

    gaps = True  # pictures may have been taken at any time

    def __init__(self, path: Path, *, rate: float) -> None:
        super().__init__(path)
        self.camera_names, self._shots = find_shots(path, rate)
        self.count = len(self._shots)
        self.format = "folder of images"
        pictures = (file for shot in self._shots for file in shot.files)
        self._films = {file.film for file in pictures if isinstance(file, FilmPicture)}
        if self._films:
            self.format = "films"
        self._truth: dict[str, float] | None = None
        if (path / TRUTH_FILE).is_file():
            self._read_truth(path / TRUTH_FILE)
        sizes = [self._first_size(camera) for camera in range(len(self.camera_names))]
        self.image_sizes = tuple(size or (0, 0) for size in sizes)

    def read(self, index: int) -> LogFrame:
        """See Source."""
        shot = self._shots[index]
        where = self.where(index)
        images = tuple(
            None if file is None else self._picture(file, size)
            for file, size in zip(shot.files, self.image_sizes, strict=True)
        )
        stamps = np.array(shot.stamps)
        if self._truth is not None:
            if shot.name not in self._truth:
                raise self.error(index, f"{shot.name} is missing in {TRUTH_FILE}, expected its stamp there")
            stamps[:] = self._truth[shot.name]
        stamps[[file is None for file in shot.files]] = np.nan
        stamp = checked_stamp(float(np.nanmean(stamps)), what=where)
        return LogFrame(index, stamp, stamps, images, None, None)

    def rig(self) -> CameraRig | None:
        """See Source."""
        inside = rig_beside(self.path, self.camera_names)
        return inside or super().rig()

    def where(self, index: int) -> str:
        """See Source."""
        return f"{self.path}: frame {index} ({self._shots[index].name})"

    def close(self) -> None:
        """See Source."""
        for film in self._films:
            film.close()

    def _picture(self, file: Picture, size: tuple[int, int]) -> Image:
        if isinstance(file, FilmPicture):
            return file.film.picture(file.number)
        with naming(file, LogError):
            image = decode(_content(file))
        found = (image.shape[1], image.shape[0])
        if found != size:
            raise LogError(
                f"{file}: found {found[0]}×{found[1]} px, expected {size[0]}×{size[1]} as before it"
            )
        return image

    def _first_size(self, camera: int) -> tuple[int, int] | None:
        """(width, height) [px] of the camera's first picture that states it, or None."""
        for shot in self._shots:
            file = shot.files[camera]
            if isinstance(file, FilmPicture):
                return file.film.size
            if file is not None:
                try:
                    return encoded_size(_content(file))
                except LogError:
                    continue
        return None

    def _read_truth(self, file: Path) -> None:
        text = _content(file, _MAX_TRUTH)
        try:
            content = json.loads(text.decode("utf-8"))
            self._truth = {str(item["frame"]): float(item["timestamp"]) for item in content["frames"]}
            settings = {"rate": 10.0, "sequence": True, **content.get("settings", {})}
            settings["rate"] = max(1e-3, float(settings["rate"]))
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            raise LogError(f"{file}: found no stamps of frames: {' '.join(str(error).split())}") from error
        self.format += ", synthetic"
        self.episode_starts = self._starts(settings)

    def _starts(self, settings: dict[str, Any]) -> tuple[int, ...]:
        """Where the synthetic robot starts again: with each single scene, and after a pause in a sequence."""
        truth = self._truth or {}
        stamps = np.array([truth.get(shot.name, np.nan) for shot in self._shots])
        pause = _PAUSE / settings["rate"] if settings["sequence"] else 0.0
        return (0, *(int(k) for k in np.flatnonzero(np.diff(stamps) > pause) + 1))


def _content(file: Path, largest: int = _MAX_FILE) -> bytes:
    with told_of(file):
        return read_bounded(file, largest)
