"""Which images of a folder belong together.

    ROOT/camera60.png, camera180.png …              one frame
    ROOT/camera60/000000.png, camera180/000000.png  a folder for each camera
    ROOT/000000/camera60.png, camera180.png …       a folder for each frame
    ROOT/camera60.mp4, camera180.mp4 …              a film of each camera
    ROOT/recording.toml                             which says so, see `recording_file`
Folders of cameras and films may have other names, where the pictures' are numbers; a folder of nothing but
numbers is one camera. Pictures of one moment have the same name in the cameras' folders, or names that are
stamps close together.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import LogError
from tracker.geometry.camera import may_be_name
from tracker.logs import films
from tracker.logs.films import FilmFile, FilmPicture
from tracker.logs.recording_file import RecordingFile, read_recording_file

_FIRST, _LAST = 10**9, 41 * 10**8  # the years 2001 to 2099 [s since the epoch]
_PER_SECOND = (1, 10**3, 10**6, 10**9)
_NAME = re.compile(r"(?:(?P<minus>-)|\D*?)(?P<whole>\d{1,20})(?P<fraction>\.\d{1,12})?")


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorting key: runs of digits by their value, the rest as text."""
    parts = re.findall(r"\d{1,300}|\D+", name)
    return tuple((0, int(part), "") if part[0].isdecimal() else (1, 0, part) for part in parts)


def stamps_of_names(names: Sequence[str]) -> list[float] | None:
    """Stamps [s] that the names (without suffix) are; None where they are none.

    A stamp is a number with a decimal point [s], or a whole number that is a time in this century in
    seconds, milliseconds, microseconds or nanoseconds since the epoch. Text before it is passed over, but for
    a minus that begins the name, as of clocks that begin before their zero.
    """
    matches = [_NAME.fullmatch(name) for name in names]
    if not names or not all(matches):
        return None
    parts = [match.groupdict("") for match in matches if match]
    if all(part["fraction"] for part in parts):
        return [float("".join(part.values())) for part in parts]
    if any(part["fraction"] for part in parts):
        return None
    numbers = [int(part["whole"]) for part in parts]
    for unit in _PER_SECOND:
        if min(numbers) >= _FIRST * unit and max(numbers) <= _LAST * unit:
            return [number / unit for number in numbers]
    return None


def counted_stamps(names: Sequence[str], rate: float) -> list[float]:
    """Stamps [s] at `rate` [Hz]: by the numbers in the names, so that missing ones are gaps, or in order."""
    matches = [_NAME.fullmatch(name) for name in names]
    numbers = [int(m["whole"]) for m in matches if m and not m["fraction"] and len(m["whole"]) < 12]
    counted = len(numbers) == len(names) and len(set(numbers)) == len(names)
    return [number / rate for number in (numbers if counted else range(len(names)))]


SUFFIXES = (".png", ".jpg", ".jpeg")
"""Of pictures."""

_CAMERA = re.compile(r"camera\w*")
_NUMBER = re.compile(r"\d{1,20}(\.\d{1,12})?")

Picture = Path | FilmPicture
"""A file, or a picture of a film."""
_Streams = dict[str, dict[str, Picture]]
"""Of each camera its pictures by name."""


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame."""

    name: str
    """Name of the frame's folder, or of its first file without suffix."""
    files: tuple[Picture | None, ...]
    """The picture of each camera, None where it has none."""
    stamps: tuple[float, ...]
    """Stamp of each camera's picture [s]."""


def find_shots(root: Path, rate: float) -> tuple[tuple[str, ...], list[FrameFiles]]:
    """Names of the cameras, and the frames in order; LogError if there is none.

    Args:
        root: the folder, or a film of a single camera.
        rate: frames per second [Hz] where names are not stamps.
    """
    if root.is_file():
        return _of_streams({_name_of_lone_camera(root.stem): _film(root)}, rate)
    stated = read_recording_file(root)
    if stated is not None:
        return _of_stated(root, stated, rate)
    here = _pictures(root)
    folders = sorted((item for item in _visible(root) if item.is_dir()), key=lambda f: natural_key(f.name))
    cameras = {folder.name: folder for folder in folders if _CAMERA.fullmatch(folder.name)}
    streams: _Streams = {name: _streams_files(folder) for name, folder in cameras.items()}
    if any(streams.values()):
        return _of_streams({name: files for name, files in streams.items() if files}, rate)
    frames = [(folder.name, _camera_files(_pictures(folder))) for folder in folders]
    frames = [(name, files) for name, files in frames if files]
    # A loose picture beside folders of them is no recording, but for instance an overlay.
    if not frames and _camera_files(here):
        return _of_frames([(root.name, _camera_files(here))], rate)
    if not frames:
        streams = _of_films(root) or _without_names(root, folders, here)
        if streams:
            return _of_streams(streams, rate)
        raise LogError(
            f"{root}: found no pictures of cameras, expected folders like 000000 with camera60.png, "
            "or folders like camera60 with 000000.png, or films like camera60.mp4, or recording.toml, "
            "or a recording such as camera_data.dat"
        )
    return _of_frames(frames, rate)


def _visible(folder: Path) -> Iterator[Path]:
    return (item for item in folder.iterdir() if not item.name.startswith("."))


def _pictures(folder: Path) -> list[Path]:
    return sorted(item for item in _visible(folder) if item.suffix.lower() in SUFFIXES)


def _by_name(files: Iterable[Path], what: str) -> dict[str, Picture]:
    """Files by their names without suffix, of which there is one each."""
    result: dict[str, Path] = {}
    for file in files:
        other = result.setdefault(file.stem, file)
        if other is not file:
            raise LogError(f"{file}: found {other.name} too, expected one picture of a {what}")
    return dict(result)


def _camera_files(pictures: list[Path]) -> dict[str, Picture]:
    return _by_name((file for file in pictures if _CAMERA.fullmatch(file.stem)), "camera")


def _streams_files(folder: Path) -> dict[str, Picture]:
    """The pictures in a camera's folder by name, in order."""
    return _by_name(sorted(_pictures(folder), key=lambda file: natural_key(file.stem)), "name")


def _of_films(root: Path) -> _Streams:
    """The films in a folder; those that are named after cameras, if there are any."""
    found = {file.stem: file for file in sorted(_visible(root)) if file.suffix.lower() in films.SUFFIXES}
    named = {name: file for name, file in found.items() if _CAMERA.fullmatch(name)}
    return {name: _film(file) for name, file in (named or found).items()}


def _film(file: Path, *, counted: bool = False) -> dict[str, Picture]:
    """Pictures of a film by their stamps, or by their numbers."""
    film = FilmFile(file)
    names = [f"{k:06d}" if counted else f"{stamp:.9f}" for k, stamp in enumerate(film.stamps)]
    return {name: FilmPicture(film, k) for k, name in enumerate(names)}


def _without_names(root: Path, folders: list[Path], here: list[Path]) -> _Streams:
    """Folders of cameras with other names, or one camera's folder: nothing but numbers are its pictures."""
    if here and all(_NUMBER.fullmatch(file.stem) for file in here):
        return {_name_of_lone_camera(root.resolve().name): _streams_files(root)}
    found: _Streams = {}
    for folder in folders:
        files = _streams_files(folder)
        if files and not _NUMBER.fullmatch(folder.name) and all(map(_NUMBER.fullmatch, files)):
            found[folder.name] = files
    return found


def _name_of_lone_camera(name: str) -> str:
    """What the only camera is called: as its file or folder, which may be called anything."""
    return name if may_be_name(name) else "camera"


def _of_stated(root: Path, stated: RecordingFile, rate: float) -> tuple[tuple[str, ...], list[FrameFiles]]:
    """The frames of a folder that says which files are whose."""
    counted = stated.stamps is not None or stated.rate is not None
    streams: _Streams = {}
    for name, files in stated.cameras.items():
        some = list(files.values())
        if some[0].suffix.lower() not in films.SUFFIXES:
            streams[name] = {key: files[key] for key in sorted(files, key=natural_key)}
        elif len(some) == 1:
            streams[name] = _film(some[0], counted=counted)
        else:
            raise LogError(f"{root}: {name}: found {len(some)} films, expected one of each camera")
    if counted and any(_is_film(files) for files in streams.values()):
        streams = _numbered_as_films(streams)
    keys = [key for files in streams.values() for key in files]
    if len(streams) > 1 and len(set(keys)) == len(keys) and stamps_of_names(keys) is None:
        streams = {
            name: {f"{k:06d}": picture for k, picture in enumerate(files.values())}
            for name, files in streams.items()
        }
    names, shots = _of_streams(streams, stated.rate or rate)
    order = [names.index(name) for name in streams]
    shots = [
        FrameFiles(shot.name, tuple(shot.files[c] for c in order), tuple(shot.stamps[c] for c in order))
        for shot in shots
    ]
    return tuple(streams), shots if stated.stamps is None else _stamped(root, shots, stated.stamps)


def _is_film(files: dict[str, Picture]) -> bool:
    return isinstance(next(iter(files.values())), FilmPicture)


def _numbered_as_films(streams: _Streams) -> _Streams:
    """The same with pictures whose names are numbers called as those of films are, from 000000 on."""
    named = {name: files for name, files in streams.items() if not _is_film(files)}
    keys = [key for files in named.values() for key in files]
    if not keys or not all(key.isdecimal() for key in keys) or stamps_of_names(keys) is not None:
        return streams
    first = min(map(int, keys))
    renamed = {
        name: {f"{int(key) - first:06d}": file for key, file in files.items()}
        for name, files in named.items()
    }
    if any(len(renamed[name]) < len(named[name]) for name in named):  # 1.png beside 01.png
        return streams
    return streams | renamed


def _stamped(root: Path, shots: list[FrameFiles], stamps: FloatArray) -> list[FrameFiles]:
    if len(shots) != len(stamps):
        raise LogError(
            f"{root}: stamps.csv: found {len(stamps)} lines, expected one for each of {len(shots)} frames"
        )
    rows = np.broadcast_to(stamps, (len(shots), len(shots[0].files)))
    return [
        FrameFiles(shot.name, shot.files, tuple(row.tolist())) for shot, row in zip(shots, rows, strict=True)
    ]


def _of_frames(
    frames: list[tuple[str, dict[str, Picture]]], rate: float
) -> tuple[tuple[str, ...], list[FrameFiles]]:
    names = tuple(sorted({name for _, files in frames for name in files}, key=natural_key))
    keys = [key for key, _ in frames]
    pictures = [tuple(files.get(name) for name in names) for _, files in frames]
    return names, _at_once(keys, pictures, stamps_of_names(keys) or counted_stamps(keys, rate))


def _at_once(
    keys: list[str], pictures: list[tuple[Picture | None, ...]], stamps: list[float]
) -> list[FrameFiles]:
    """Frames whose pictures have one stamp."""
    return [
        FrameFiles(key, files, (stamp,) * len(files))
        for key, files, stamp in zip(keys, pictures, stamps, strict=True)
    ]


def _of_streams(streams: _Streams, rate: float) -> tuple[tuple[str, ...], list[FrameFiles]]:
    names = tuple(sorted(streams, key=natural_key))
    keys = sorted({key for files in streams.values() for key in files}, key=natural_key)
    stamps = stamps_of_names(keys)
    if stamps is None:
        pictures = [tuple(streams[name].get(key) for name in names) for key in keys]
        return names, _at_once(keys, pictures, counted_stamps(keys, rate))
    times = dict(zip(keys, stamps, strict=True))
    return names, list(_close_together([streams[name] for name in names], times, rate))


def _close_together(
    streams: list[dict[str, Picture]], times: dict[str, float], rate: float
) -> Iterator[FrameFiles]:
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


def _period(streams: list[dict[str, Picture]], times: dict[str, float], rate: float) -> float:
    steps: list[FloatArray] = [np.diff([times[key] for key in files]) for files in streams]
    found = np.concatenate(steps)
    found = found[found > 0]
    return float(np.median(found)) if found.size else 1 / rate


def _shot(group: dict[int, tuple[float, str]], streams: list[dict[str, Picture]]) -> FrameFiles:
    cameras = range(len(streams))
    return FrameFiles(
        name=next(iter(group.values()))[1],
        files=tuple(streams[camera][group[camera][1]] if camera in group else None for camera in cameras),
        stamps=tuple(group[camera][0] if camera in group else np.nan for camera in cameras),
    )
