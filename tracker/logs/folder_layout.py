"""Which images of a folder belong together.

    ROOT/camera60.png, camera180.png …              one frame
    ROOT/camera60/000000.png, camera180/000000.png  a folder for each camera
    ROOT/000000/camera60.png, camera180.png …       a folder for each frame
Pictures of one moment have the same name in the cameras' folders, or names that are stamps close together.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import LogError
from tracker.logs.name_stamps import counted_stamps, natural_key, stamps_of_names

SUFFIXES = (".png", ".jpg", ".jpeg")
"""Of pictures."""

_CAMERA = re.compile(r"camera\w*")


@dataclass(frozen=True)
class Shot:
    """The files of one frame."""

    name: str
    """Name of the frame's folder, or of its first file without suffix."""
    files: tuple[Path | None, ...]
    """The picture of each camera, None where it has none."""
    stamps: tuple[float, ...]
    """Stamp of each camera's picture [s]."""


def find_shots(root: Path, rate: float) -> tuple[tuple[str, ...], list[Shot]]:
    """Names of the cameras, and the frames in order; LogError if there is none.

    Args:
        root: the folder.
        rate: frames per second [Hz] where names are not stamps.
    """
    here = _pictures(root)
    folders = sorted((item for item in _visible(root) if item.is_dir()), key=lambda f: natural_key(f.name))
    cameras = {folder.name: folder for folder in folders if _CAMERA.fullmatch(folder.name)}
    streams = {name: _streams_files(folder) for name, folder in cameras.items()}
    if any(streams.values()):
        return _of_streams({name: files for name, files in streams.items() if files}, rate)
    frames = [(folder.name, _camera_files(_pictures(folder))) for folder in folders]
    frames = [(name, files) for name, files in frames if files]
    # A loose picture beside folders of them is no recording, but for instance an overlay.
    if not frames and _camera_files(here):
        return _of_frames([(root.name, _camera_files(here))], rate)
    if not frames:
        raise LogError(
            f"{root}: found no pictures of cameras, expected folders like 000000 with camera60.png, "
            "or folders like camera60 with 000000.png, or a recording such as camera_data.dat"
        )
    return _of_frames(frames, rate)


def _visible(folder: Path) -> Iterator[Path]:
    return (item for item in folder.iterdir() if not item.name.startswith("."))


def _pictures(folder: Path) -> list[Path]:
    return sorted(item for item in _visible(folder) if item.suffix.lower() in SUFFIXES)


def _camera_files(pictures: list[Path]) -> dict[str, Path]:
    """The picture of each camera."""
    result: dict[str, Path] = {}
    for file in pictures:
        if _CAMERA.fullmatch(file.stem):
            if file.stem in result:
                raise LogError(
                    f"{file}: found {result[file.stem].name} too, expected one picture of a camera"
                )
            result[file.stem] = file
    return result


def _streams_files(folder: Path) -> dict[str, Path]:
    """The pictures in a camera's folder by name, in order."""
    result: dict[str, Path] = {}
    for file in sorted(_pictures(folder), key=lambda file: natural_key(file.stem)):
        if file.stem in result:
            raise LogError(f"{file}: found {result[file.stem].name} too, expected one picture of a name")
        result[file.stem] = file
    return result


def _of_frames(frames: list[tuple[str, dict[str, Path]]], rate: float) -> tuple[tuple[str, ...], list[Shot]]:
    names = tuple(sorted({name for _, files in frames for name in files}, key=natural_key))
    keys = [key for key, _ in frames]
    stamps = stamps_of_names(keys) or counted_stamps(keys, rate)
    shots = [
        Shot(key, tuple(files.get(name) for name in names), (stamp,) * len(names))
        for (key, files), stamp in zip(frames, stamps, strict=True)
    ]
    return names, shots


def _of_streams(streams: dict[str, dict[str, Path]], rate: float) -> tuple[tuple[str, ...], list[Shot]]:
    names = tuple(sorted(streams, key=natural_key))
    keys = sorted({key for files in streams.values() for key in files}, key=natural_key)
    stamps = stamps_of_names(keys)
    if stamps is None:
        counted = counted_stamps(keys, rate)
        shots = [
            Shot(key, tuple(streams[name].get(key) for name in names), (stamp,) * len(names))
            for key, stamp in zip(keys, counted, strict=True)
        ]
        return names, shots
    times = dict(zip(keys, stamps, strict=True))
    return names, list(_close_together([streams[name] for name in names], times, rate))


def _close_together(streams: list[dict[str, Path]], times: dict[str, float], rate: float) -> Iterator[Shot]:
    """Pictures whose stamps differ by less than half the cameras' period make a frame."""
    reach = 0.5 * _period(streams, times, rate)
    ordered = sorted((times[key], camera, key) for camera, files in enumerate(streams) for key in files)
    group: dict[int, tuple[float, str]] = {}
    first = -np.inf
    for time, camera, key in ordered:
        if group and (camera in group or time - first > reach):
            yield _shot(group, streams)
            group = {}
        if not group:
            first = time
        group[camera] = (time, key)
    yield _shot(group, streams)


def _period(streams: list[dict[str, Path]], times: dict[str, float], rate: float) -> float:
    steps: list[FloatArray] = [np.diff([times[key] for key in files]) for files in streams]
    found = np.concatenate(steps)
    found = found[found > 0]
    return float(np.median(found)) if found.size else 1 / rate


def _shot(group: dict[int, tuple[float, str]], streams: list[dict[str, Path]]) -> Shot:
    cameras = range(len(streams))
    return Shot(
        name=next(iter(group.values()))[1],
        files=tuple(streams[camera][group[camera][1]] if camera in group else None for camera in cameras),
        stamps=tuple(group[camera][0] if camera in group else np.nan for camera in cameras),
    )
