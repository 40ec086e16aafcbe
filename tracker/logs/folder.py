"""Reads folders of PNG or JPEG images or of films frame by frame, and writes folders of images."""

import itertools
import json
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig, rig_texts
from tracker.checks import naming
from tracker.conventions import FloatArray, Image
from tracker.errors import LogError
from tracker.files import read_bounded, reading, whole_file, writing
from tracker.logs.frame import LogFrame, checked_stamp
from tracker.logs.layout import RECORDING_FILE, STAMPS_FILE, Picture, find_layout
from tracker.logs.log import MAX_SIDE, Log, Progress, Source, check_same_size, check_sides, rig_beside
from tracker.logs.pictures import RECORDED, FilmPicture, decode, from_bayer, head_of

TRUTH_FILE = "ground_truth.json"
"""File that `python -m synthetic dataset` writes beside the images; timestamps are read from it."""

_PAUSE = 8
"""Longest pause within an episode [frames]: sequences lack single frames, between motions ten or more."""

_MAX_FILE = 4 * MAX_SIDE * MAX_SIDE  # bytes; more than the largest image uncompressed


class FolderSource(Source):
    """A folder of images, or of films."""

    gaps = True  # images may have been taken at any time

    def __init__(self, path: Path, *, rate: float) -> None:
        super().__init__(path)
        self._layout = layout = find_layout(path, rate)
        self.camera_names, self.count = layout.cameras, len(layout.names)
        pictures = itertools.chain.from_iterable(layout.files)
        self._films = {file.film for file in pictures if isinstance(file, FilmPicture)}
        self.format = "films" if self._films else "folder of images"
        self._stamps, self._raw = layout.stamps, False
        # (n,) of the frames. Without the image of a late camera, the mean alone might go back.
        self._times: FloatArray = np.maximum.accumulate(np.nanmean(layout.stamps, axis=1))
        self._given: CameraRig | None = None
        if os.path.lexists(path / TRUTH_FILE):
            self._read_truth(path / TRUTH_FILE)
        self.image_sizes = tuple(map(_first_size, zip(*layout.files, strict=True)))

    def read(self, index: int) -> LogFrame:
        """See Source."""
        files = zip(self._layout.files[index], self.image_sizes, strict=True)
        images = tuple(None if file is None else _picture(file, size) for file, size in files)
        stamps, where = self._stamps[index].copy(), self.where(index)
        if np.isnan(stamps).all():
            name = self._layout.names[index]
            raise LogError(f"{where}: {name} is missing in {TRUTH_FILE}, expected its stamp there")
        for own in stamps[~np.isnan(stamps)]:
            checked_stamp(own, what=where)
        stamp = checked_stamp(self._times[index], what=where)
        raw = None
        if self._raw:
            mosaics = [None if one is None else np.ascontiguousarray(one[:, :, 0]) for one in images]
            images = tuple(None if one is None else from_bayer(one) for one in mosaics)
            raw = tuple(mosaics)
        return LogFrame(index, stamp, stamps, images, None, None, raw)

    def rig(self) -> CameraRig | None:
        """See Source; a synthetic film may state an imperfect calibration, single scenes one each."""
        if self._given is not None:
            return self._given if len(self.episode_starts) == 1 else None
        return rig_beside(self.path, self.camera_names) or super().rig()

    def where(self, index: int) -> str:
        """See Source."""
        return f"{self.path}: frame {index} ({self._layout.names[index]})"

    def close(self) -> None:
        """See Source."""
        for film in self._films:
            film.close()

    def _read_truth(self, file: Path) -> None:
        """Read the timestamps of frames and images from the truth, NaN for frames that it does not have."""
        text = _content(file, 1 << 28)  # a frame has about 1000 bytes
        faults = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
        with naming(f"{file}: found no stamps of frames", LogError, *faults):
            content = json.loads(text.decode("utf-8"))
            truth = {str(item["frame"]): self._stamps_in(item) for item in content["frames"]}
            settings = {"rate": 10.0, "sequence": True, **content.get("settings", {})}
            rate = max(1e-3, float(settings["rate"]))
            self._raw = settings.get("raw") is True
        self.format += ", synthetic"
        self._given = rig_beside(self.path / self._layout.names[0], self.camera_names)
        unknown = [np.nan] * (1 + len(self.camera_names))
        stated = np.array([truth.get(name, unknown) for name in self._layout.names])
        self._times, self._stamps = stated[:, 0], np.where(np.isnan(self._stamps), np.nan, stated[:, 1:])
        # An episode starts with each single scene, and after a pause in a sequence.
        pause = _PAUSE / rate if settings["sequence"] else 0.0
        self.episode_starts = (0, *(int(k) for k in np.flatnonzero(np.diff(self._times) > pause) + 1))

    def _stamps_in(self, item: Any) -> list[float]:
        """Return a frame's timestamp in the truth and those of its images, where they have their own."""
        cameras, stamp = item.get("cameras", {}), item["timestamp"]
        own = (cameras.get(name, {}).get("timestamp", stamp) for name in self.camera_names)
        return [float(one) for one in (stamp, *own)]


def _picture(file: Picture, size: tuple[int, int]) -> Image:
    """Read an image; LogError if its size differs from that of the camera's first."""
    if isinstance(file, FilmPicture):
        return file.film.picture(file.number)
    content = _content(file)
    with naming(file, LogError):
        image = decode(content)
        check_same_size(image.shape[1::-1], size)
        return image


def _first_size(files: Iterable[Picture | None]) -> tuple[int, int]:
    """Return (width, height) [px] of the camera's first image with a readable size; else zeros."""
    for file in files:
        if isinstance(file, FilmPicture):
            return file.film.size
        if file is not None:
            with suppress(LogError):
                size = head_of(_content(file), RECORDED).size
                check_sides(*size)
                return size
    return 0, 0


def _content(file: Path, largest: int = _MAX_FILE) -> bytes:
    with reading(file):
        return read_bounded(file, largest)


def write_folder(path: Path, log: Log, rig: CameraRig, progress: Progress) -> int:
    """Write frames as one folder of PNG files per camera, named by the frames' numbers, with the calibration.

    `recording.toml` and `stamps.csv` keep each image's frame and timestamp. The folder appears only once
    everything is written. Frames without images are left out; LogError if there are no others. Return the
    number of frames written.
    """
    stamps, seen = [], np.zeros(len(rig), bool)
    with writing(LogError, path), whole_file(path) as folder:
        for name in rig.names:
            (folder / name).mkdir(parents=True)
        for name, text in rig_texts(rig).items():
            (folder / name).write_text(text, "utf-8")
        for frame in log:
            taken = np.array([image is not None for image in frame.images])
            for name, image in zip(rig.names, frame.images, strict=True):
                if image is not None:
                    content = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1]
                    (folder / name / f"{frame.index:06d}.png").write_bytes(content.tobytes())
            if taken.any():
                stamps.append(np.where(taken, frame.camera_timestamps, frame.timestamp))
            seen |= taken
            progress(1)
        if not stamps:
            raise LogError(f"{path}: found no image in the recording, expected at least one")
        np.savetxt(folder / STAMPS_FILE, np.array(stamps)[:, seen], "%s", ",")
        lines = "".join(f'"{name}" = "{name}/*.png"\n' for name in np.array(rig.names)[seen])
        (folder / RECORDING_FILE).write_text(f"[cameras]\n{lines}", "utf-8")
    return len(stamps)
