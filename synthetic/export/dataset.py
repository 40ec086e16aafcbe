"""Data sets in folders: images and label maps of each frame, the calibration, and one file of ground truth.

A frame's folder and `ground_truth.json` are written atomically. An interrupted run can therefore be
continued by calling `make_dataset` again, which skips the frames that exist.
"""

from __future__ import annotations

import functools
import itertools
import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from synthetic.camera.rigs import KNOWN, choose_rig, sized
from synthetic.export.bop import finish_bop, write_bop_frame, write_png
from synthetic.export.workers import run_tasks
from synthetic.frames import DatasetError, Frame, FrameMaker, FrameOptions
from synthetic.render.renderer import NAME
from tracker.calibration.rig import CameraRig
from tracker.files import write_whole

TRUTH_FILE = "ground_truth.json"

MAX_FRAMES = 1_000_000
"""Largest number of frames: their names have six digits."""

_SAVE_EVERY = 2.0
"""Shortest time between two saves of the ground truth [s]; longer if saving takes long."""


@dataclass(frozen=True)
class DatasetOptions:
    """Contents of a data set."""

    frames: FrameOptions
    """Everything that determines the pixels, except the cameras."""
    count: int
    calibration: str = "simulation"
    """One of `synthetic.camera.rigs.KNOWN`, or a folder with one platform file for each camera."""
    bop: bool = False
    """Whether to add the data set in the BOP layout, in the folder `bop`."""

    def rig(self) -> CameraRig:
        """Return the cameras of the data set."""
        return sized(choose_rig(self.calibration, self.frames.seed), self.frames.size)

    def settings(self) -> dict[str, Any]:
        """Return the settings that a run and its continuation must share."""
        result = asdict(self.frames)
        for key in ("seed", "object_name"):  # stored elsewhere in the ground truth
            del result[key]
        result["effects"] = list(self.frames.effects)  # as JSON returns it
        named = self.calibration in KNOWN
        return {**result, "calibration": self.calibration if named else "folder", "bop": self.bop}


def make_worker(options: DatasetOptions, folder: Path) -> Callable[[Sequence[int]], Iterator[dict[str, Any]]]:
    """Return a function that makes and writes frames of a chunk, given their numbers; yields their truth."""
    maker = FrameMaker(options.frames, options.rig())

    def work(numbers: Sequence[int]) -> Iterator[dict[str, Any]]:
        for frame in maker.numbered(numbers):
            if options.bop:
                write_bop_frame(folder / "bop", frame)
            write_frame(folder, frame)
            yield frame.truth()

    return work


def write_frame(folder: Path, frame: Frame) -> None:
    """Write a frame's images and label maps to a folder named by its number, atomically."""
    final = folder / f"{frame.index:06d}"
    temporary = folder / f".{final.name}.{os.getpid()}"
    temporary.mkdir(exist_ok=True)
    try:
        for name, image, labels in zip(frame.rig.names, frame.images, frame.labels, strict=True):
            write_png(temporary / f"{name}.png", image)
            write_png(temporary / f"labels_{name}.png", labels)
        if frame.given is not frame.rig:
            frame.given.save(temporary)
        if final.exists():  # written by an interrupted run that had not yet saved its ground truth
            shutil.rmtree(final)
        os.rename(temporary, final)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def make_dataset(
    options: DatasetOptions,
    folder: str | os.PathLike[str],
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Make a data set, or the missing frames of one.

    Args:
        options: contents; nothing else affects the pixels.
        folder: target folder; created if missing.
        workers: number of processes; 1: this process does all the work.
        progress: called with the numbers of finished frames and of all frames.

    Returns:
        Number of frames made by this call.

    Raises:
        TrackerError: an option is invalid, the folder holds something else, or a worker failed.
        OSError: a file cannot be written.
    """
    if not 1 <= options.count <= MAX_FRAMES:
        raise DatasetError(f"frames: found {options.count}, expected 1 to {MAX_FRAMES}")
    root = Path(folder)
    rig = options.rig()
    truth = _Truth.open(root, options)
    done = truth.done(root)
    _save_rig(root, rig, begun=bool(done))
    for path in filter(_is_left, root.iterdir()):
        shutil.rmtree(path, ignore_errors=True)
    missing = (number for number in range(options.count) if number not in done)
    tasks = [list(numbers) for _, numbers in itertools.groupby(missing, lambda n: n // options.frames.chunk)]
    if progress:
        progress(len(done), options.count)
    made = 0
    try:
        for entry in run_tasks(functools.partial(make_worker, options, root), tasks, workers):
            truth.add(entry)
            made += 1
            if progress:
                progress(len(done) + made, options.count)
    finally:
        truth.save()
    if options.bop:
        name, raw = options.frames.object_name, options.frames.raw
        finish_bop(root / "bop", rig, truth.entries(), name, raw=raw)
    return made


class _Truth:
    """The ground truth file of a data set."""

    def __init__(self, path: Path, head: dict[str, Any], frames: dict[int, dict[str, Any]]) -> None:
        self._path, self._head, self._frames = path, head, frames
        self._next_save = time.monotonic() + _SAVE_EVERY

    @classmethod
    def open(cls, root: Path, options: DatasetOptions) -> _Truth:
        """Open the file in a folder made with the same options, or start one in a new folder."""
        head: dict[str, Any] = {
            "seed": options.frames.seed,
            "object": options.frames.object_name,
            "renderer": NAME,
            "settings": options.settings(),
        }
        path = root / TRUTH_FILE
        if not path.exists():
            if root.exists() and (not root.is_dir() or any(root.iterdir())):
                raise DatasetError(f"{root}: found something else there, expected an empty folder or none")
            root.mkdir(parents=True, exist_ok=True)
            result = cls(path, head, {})
            result.save()
            return result
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            frames = {int(entry["frame"]): entry for entry in found.pop("frames")}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise DatasetError(f"{path}: cannot be read as a data set's truth: {error}") from error
        _refuse_difference(root, found, head)
        if max(frames, default=0) >= options.count:
            raise DatasetError(
                f"{root}: found frames up to {max(frames)}, expected fewer than the {options.count} asked for"
            )
        return cls(path, head, frames)

    def done(self, root: Path) -> set[int]:
        """Return the numbers of the frames that exist together with their ground truth."""
        return {number for number in self._frames if (root / f"{number:06d}").is_dir()}

    def add(self, entry: dict[str, Any]) -> None:
        """Add a frame's entry; save the file at intervals."""
        self._frames[int(entry["frame"])] = entry
        if time.monotonic() >= self._next_save:
            self.save()

    def entries(self) -> list[dict[str, Any]]:
        """Return the entries of all frames, in order."""
        return [self._frames[number] for number in sorted(self._frames)]

    def save(self) -> None:
        """Replace the file."""
        start = time.monotonic()
        content = {**self._head, "frames": self.entries()}
        # Options may be numbers of NumPy's types.
        write_whole(self._path, json.dumps(content, indent=1, default=np.generic.item) + "\n")
        now = time.monotonic()
        self._next_save = now + max(_SAVE_EVERY, 20 * (now - start))


def _is_left(path: Path) -> bool:
    """Whether a path is a frame's temporary folder whose process has ended."""
    name = re.fullmatch(r"\.\d{6}\.(\d{1,9})", path.name)
    if name is None:
        return False
    try:
        os.kill(int(name[1]), 0)
    except OSError as error:
        return isinstance(error, ProcessLookupError)
    return False


def _save_rig(root: Path, rig: CameraRig, *, begun: bool) -> None:
    files = list(root.glob("*camera*.yml"))
    if not begun:  # files of a run that ended before its first frame
        for path in files:
            path.unlink()
    elif files and not CameraRig.load(root).agrees_with(rig):
        raise DatasetError(f"{root}: found frames of another calibration, expected the one asked for")
    rig.save(root)


def _refuse_difference(root: Path, found: dict[str, Any], expected: dict[str, Any]) -> None:
    found, expected = ({**head, **head.get("settings", {})} for head in (found, expected))
    for key, value in expected.items():
        if key != "settings" and found.get(key) != value:
            raise DatasetError(
                f"{root}: found a data set made with {key} {found.get(key)!r}, expected {value!r}; "
                "continue it with the same options, or choose another folder"
            )
