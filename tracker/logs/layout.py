"""Finds out which images or films in a folder belong together.

    ROOT/camera60.png, camera180.png …              one frame
    ROOT/camera60/000000.png, camera180/000000.png  a folder for each camera
    ROOT/000000/camera60.png, camera180.png …       a folder for each frame
    ROOT/camera60.mp4, camera180.mp4 …              a film for each camera
    ROOT/recording.toml                             a file that assigns the images to cameras
Films may have other names, and so may folders of cameras if their images' names are numbers. A folder with
nothing but numbered images is that of one camera. Images of one moment have the same name in all
cameras' folders, or names that are timestamps close together.

If the names do not show which camera took an image, `recording.toml` does, with `stamps.csv` beside it;
docs/recordings.md describes both.
"""

import contextlib
import dataclasses
import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tracker.checks import is_number, naming
from tracker.conventions import FloatArray
from tracker.errors import LogError, shown
from tracker.files import read_bounded, reading, visible
from tracker.files.toml import read_toml
from tracker.geometry.camera import may_be_name
from tracker.logs.frame import EPOCH
from tracker.logs.log import MAX_CAMERAS
from tracker.logs.pictures import FILM_SUFFIXES, FilmFile, FilmPicture

SUFFIXES = (".png", ".jpg", ".jpeg")
"""File name suffixes of images."""

RECORDING_FILE, STAMPS_FILE = "recording.toml", "stamps.csv"
"""Files in a folder that describe its recording."""

_MAX_STAMPS = 100_000_000  # bytes
_MAX_RATE = 1e6

_LAST = 41 * 10**8  # the year 2099 [s since the epoch]
_PER_SECOND = (1, 10**3, 10**6, 10**9)
_NAME = re.compile(r"(?:\D*?(?=\d))??(?P<whole>-?\d{1,20})(?P<fraction>\.\d{1,12})?")
CAMERA = re.compile(r"camera\w*")
"""Pattern of cameras' names by which their folders and images are found."""

_NUMBER = re.compile(r"\d{1,20}(\.\d{1,12})?")

Picture = Path | FilmPicture
"""An image file, or an image of a film."""

_Streams = dict[str, Mapping[str, Picture]]
"""Images of each camera, by name."""


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a sorting key that orders runs of digits by value and the rest as text."""
    parts = re.findall(r"\d{1,300}|\D+", name)
    return tuple((0, int(part), "") if part[0].isdecimal() else (1, 0, part) for part in parts)


def stamps_of_names(names: Sequence[str]) -> list[float] | None:
    """Return the timestamps [s] in file names without suffix, or None if the names are not all timestamps.

    A timestamp is a number with a decimal point [s], or an integer that is a time in this century in seconds,
    milliseconds, microseconds or nanoseconds since the epoch. Text before it is ignored, except for a minus
    at the start of the name, from a clock that starts below zero.
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
        if min(numbers) >= EPOCH * unit and max(numbers) <= _LAST * unit:
            return [number / unit for number in numbers]
    return None


def _numbers(names: Sequence[str]) -> list[int] | None:
    """Return the numbers in the names; None if two have the same one, or one has none."""
    matches = [_NAME.fullmatch(name) for name in names]
    numbers = [int(m["whole"]) for m in matches if m and not m["fraction"] and len(m["whole"]) < 12]
    return numbers if len(numbers) == len(names) == len(set(numbers)) else None


@dataclass(frozen=True, eq=False)
class Layout:
    """The frames of a folder, in order."""

    cameras: tuple[str, ...]
    """Names of the cameras."""
    names: list[str]
    """Name of each frame: that of its folder, or of its first file without suffix."""
    files: list[tuple[Picture | None, ...]]
    """Images of each frame, one per camera; None for a missing one."""
    stamps: FloatArray
    """(n, C) timestamps of the images [s]; NaN for a missing one."""


def find_layout(root: Path, rate: float) -> Layout:
    """Find the frames in a folder, or in one camera's film; LogError if there are none.

    rate: frame rate [Hz] where names are not timestamps.
    """
    if root.is_file():
        return _of_streams(root, {_name_of_lone_camera(root.stem): _film(root)}, rate)
    if os.path.lexists(root / RECORDING_FILE):
        return _of_stated(root, rate)
    folders = sorted((item for item in visible(root) if item.is_dir()), key=lambda f: _natural(f.name))
    streams = _of_folders(folder for folder in folders if CAMERA.fullmatch(folder.name))
    # With folders, an image beside them does not count: it may be an overlay.
    frames = {} if streams else _of_frames(folders) or _of_frames([root])
    streams = streams or frames or _films(root) or _without_names(root, folders)
    if not streams:
        raise LogError(
            f"{root}: found no images of cameras, expected folders like 000000 with camera60.png "
            "(names begin with camera), or folders like left with 000000.png, or films like camera60.mp4, "
            "or recording.toml, or a recording such as camera_data.dat"
        )
    ordered = {name: streams[name] for name in sorted(streams, key=_natural)}
    return _of_streams(root, ordered, rate, by_name=bool(frames))


def _pictures(folder: Path) -> list[tuple[str, Path]]:
    """Return the images in a folder with their names without suffix, in natural order."""
    files = (item for item in visible(folder) if item.suffix.lower() in SUFFIXES)
    ordered = sorted(files, key=lambda file: (_natural(file.stem), file.name))
    return [(file.stem, file) for file in ordered]


def _by_name(named: Iterable[tuple[str, Path]], what: str = "image of a name") -> dict[str, Path]:
    """Return the files by name; LogError if two have the same one."""
    result: dict[str, Path] = {}
    for name, file in named:
        other = result.setdefault(name, file)
        if other is not file:
            raise LogError(f"{file}: found {other.name} too, expected one {what}")
    return result


def _of_folders(folders: Iterable[Path]) -> _Streams:
    """Return the images of each folder that has any."""
    found = {folder.name: _by_name(_pictures(folder)) for folder in folders}
    return {name: files for name, files in found.items() if files}


def _of_frames(folders: Iterable[Path]) -> _Streams:
    """Return the images that are named after cameras, by the names of their frames' folders."""
    streams: dict[str, dict[str, Picture]] = {}
    for folder in folders:
        named = (one for one in _pictures(folder) if CAMERA.fullmatch(one[0]))
        for camera, file in _by_name(named, "image of a camera").items():
            streams.setdefault(camera, {})[folder.name] = file
    return {**streams}


def _films(root: Path) -> _Streams:
    """Return the films in a folder: those named after cameras if there are any, else all."""
    found = [(file.stem, file) for file in sorted(visible(root)) if file.suffix.lower() in FILM_SUFFIXES]
    named = [one for one in found if CAMERA.fullmatch(one[0])]
    return {name: _film(file) for name, file in _by_name(named or found, "film of a camera").items()}


def _film(file: Path) -> dict[str, Picture]:
    """Return the images of a film by timestamp."""
    film = FilmFile(file)
    return {f"{stamp:.9f}": FilmPicture(film, k) for k, stamp in enumerate(film.stamps)}


def _without_names(root: Path, folders: list[Path]) -> _Streams:
    """Find numbered pictures: directly in `root` for a single camera, or in folders with any names."""
    here = _pictures(root)
    if here and all(_NUMBER.fullmatch(name) for name, _ in here):
        return {_name_of_lone_camera(root.resolve().name): _by_name(here)}
    return {
        name: files
        for name, files in _of_folders(folders).items()
        if not _NUMBER.fullmatch(name) and all(map(_NUMBER.fullmatch, files))
    }


def _name_of_lone_camera(name: str) -> str:
    """Name a single camera after its file or folder, or `camera` if that name is not valid."""
    return name if may_be_name(name) else "camera"


def check_rate(value: Any, what: str) -> float:
    """Return a frame rate [Hz]; LogError, which names `what`, if it is invalid."""
    if not is_number(value) or not 0 < value <= _MAX_RATE:
        raise LogError(f"{what}: found {shown(value)}, expected a number of Hz above 0")
    return float(value)


def _stated(path: Path) -> tuple[dict[str, Any], dict[str, list[tuple[str, Path]]]]:
    """Return what a RECORDING_FILE states, and the files that fit each camera's pattern."""
    values = read_toml(path, LogError, ("cameras", "rate"))
    patterns = values.get("cameras")
    if not isinstance(patterns, dict) or not 0 < len(patterns) <= MAX_CAMERAS:
        raise LogError(f"{path}: cameras: expected a table of 1 to {MAX_CAMERAS} patterns by cameras' names")
    fitting = {name: _fitting(path, name, pattern) for name, pattern in patterns.items()}
    owners: dict[Path, str] = {}
    for name, file in ((name, file) for name, files in fitting.items() for _, file in files):
        if (owner := owners.setdefault(file, name)) != name:
            raise LogError(f"{path}: {name}: found {file.name} of {owner}, expected files of its own")
    return values, fitting


def stated_files(root: Path) -> list[Path]:
    """List the images and films that a folder's RECORDING_FILE names; none if it is invalid."""
    with contextlib.suppress(LogError):  # opening the recording raises it
        return [file for fitting in _stated(root / RECORDING_FILE)[1].values() for _, file in fitting]
    return []


def _of_stated(root: Path, rate: float) -> Layout:
    path = root / RECORDING_FILE
    values, fitting = _stated(path)
    rate = check_rate(values.get("rate", rate), f"{path}: rate")
    stamps = _stamps(root / STAMPS_FILE, len(fitting))
    streams = {name: _stream(path, name, files) for name, files in fitting.items()}
    films = {name for name in streams if isinstance(next(iter(streams[name].values())), FilmPicture)}
    texts = [key for name in streams.keys() - films for key in streams[name]]
    known = stamps_of_names(texts)
    if films and (stamps is not None or "rate" in values or (texts and not known)):
        times = np.array([*streams[min(films)]], np.float64)
        if "rate" not in values and len(times) > 1:
            rate = 1 / float(np.diff(times).mean())
        numbers = {name: _numbers([*files]) for name, files in streams.items() if name not in films}
        streams = _numbered(root, streams, films, {name: its for name, its in numbers.items() if its})
    elif films and known and min(known) >= EPOCH:  # a film counts from 0: it begins with the first image
        at = dict(zip(texts, known, strict=True))
        at |= {key: min(known) + float(key) for name in films for key in streams[name]}
        streams = {name: {f"{at[key]:.9f}": one for key, one in its.items()} for name, its in streams.items()}
    names = {name for files in streams.values() for name in files}
    layout = _of_streams(root, streams, rate, by_name=stamps is not None and len(stamps) == len(names))
    if stamps is None:
        return layout
    if len(stamps) != (count := len(layout.names)):
        found = f"found {len(stamps)} lines, expected one for each of {count} frames"
        raise LogError(f"{root}: {STAMPS_FILE}: {found}")
    return dataclasses.replace(layout, stamps=np.where(np.isnan(layout.stamps), np.nan, stamps))


def _fitting(path: Path, camera: str, pattern: Any) -> list[tuple[str, Path]]:
    """List a camera's images or films, each after the text in place of the pattern's `*`."""
    what, given = f"{path}: {camera}", f"{pattern!r:.60}"
    if not isinstance(pattern, str) or not pattern or "\0" in pattern:
        raise LogError(f"{what}: found {given}, expected a pattern such as 'left/*.png'")
    parts = Path(pattern).parts
    outside = not parts or Path(pattern).is_absolute() or ".." in parts
    if outside or "**" in pattern or pattern.count("*") > 9:  # with dozens, matching could take minutes
        raise LogError(f"{what}: found {given}, expected one inside the folder, of up to nine * but no **")
    shape = re.compile("([^/]*)".join(map(re.escape, "/".join(parts).split("*"))))
    fitting = []
    for file in sorted(_matches(path.parent, parts, {os.path.realpath(path.parent)})):
        name = file.relative_to(path.parent).as_posix()
        readable = file.suffix.lower() in (*SUFFIXES, *FILM_SUFFIXES) and file.is_file()
        if readable and "/." not in f"/{name}" and (match := shape.fullmatch(name)):
            fitting.append(("_".join(match.groups()), file))
    if not fitting:
        raise LogError(f"{what}: found no file that fits {given}, expected images or a film")
    return fitting


def _matches(folder: Path, parts: Sequence[str], above: Set[str]) -> Iterator[Path]:
    """Yield what fits a pattern below a folder; its `*` match no links back to the folders above."""
    for one in folder.glob(re.sub(r"[\[?]", r"[\g<0>]", parts[0])):  # in names these are letters
        if len(parts) == 1:
            yield one
        elif (real := os.path.realpath(one)) not in above or "*" not in parts[0]:
            yield from _matches(one, parts[1:], above | {real})


def _stream(path: Path, camera: str, fitting: list[tuple[str, Path]]) -> Mapping[str, Picture]:
    """Return a camera's images by their names, or those of its film."""
    found = _by_name(fitting, "image of a moment")
    first = next(iter(found.values()))
    if first.suffix.lower() not in FILM_SUFFIXES:
        return {key: found[key] for key in sorted(found, key=_natural)}
    if len(found) > 1:
        raise LogError(f"{path.parent}: {camera}: found {len(found)} films, expected one of each camera")
    return _film(first)


def _stamps(path: Path, cameras: int) -> FloatArray | None:
    """Read (frames, 1) or (frames, cameras) times [s]; None if there is no such file."""
    if not os.path.lexists(path):
        return None
    with reading(path):
        content = read_bounded(path, _MAX_STAMPS)
    with naming(f"{path}: found no table of numbers", LogError, ValueError):
        text = content.decode("utf-8-sig")
        lines = (line for line in io.StringIO(text, newline=None) if line.strip())
        if not text.strip():
            raise ValueError("it is empty")
        stamps = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)  # a list of cells: 75 times as much
    if stamps.shape[1] not in (1, cameras) or not np.isfinite(stamps).all():
        raise LogError(f"{path}: expected finite numbers, one or {cameras} in each line")
    return stamps


def _numbered(root: Path, streams: _Streams, films: Set[str], numbers: Mapping[str, list[int]]) -> _Streams:
    """Rename images to count from 000000: by `numbers` of some streams, by order of films and others.

    LogError if there are others, and not as many images of each stream that goes by order.
    """
    counts = {name: len(files) for name, files in streams.items() if name not in numbers}
    few, many = (pick(counts, key=counts.__getitem__) for pick in (min, max))
    if counts.keys() - films and counts[few] < counts[many]:
        found = f"found {counts[few]} images of {few} and {counts[many]} of {many}"
        why = "whose names do not show which is missing"
        raise LogError(f"{root}: {found}, {why}; expected as many of each")
    first = min((min(its) for its in numbers.values()), default=0)
    result: _Streams = {}
    for name, files in streams.items():
        counted = [number - first for number in numbers[name]] if name in numbers else range(len(files))
        result[name] = {f"{k:06d}": file for k, file in zip(counted, files.values(), strict=True)}
    return result


def _of_streams(root: Path, streams: _Streams, rate: float, *, by_name: bool = False) -> Layout:
    """Group images into frames by name or, if names are timestamps and not `by_name`, by time."""
    keys = [key for files in streams.values() for key in files]
    if not by_name and len(streams) > 1 and len(set(keys)) == len(keys) and stamps_of_names(keys) is None:
        streams = _numbered(root, streams, set(), {})
    names = sorted({name for files in streams.values() for name in files}, key=_natural)
    numbers: dict[int, str] = {}
    for name in filter(str.isdecimal, names):
        if (other := numbers.setdefault(int(name), name)) != name:
            both = " and ".join(sorted((other, name)))
            raise LogError(f"{root}: found images called {both}, expected one name of each moment")
    stamps = stamps_of_names(names)
    counted = (number / rate for number in _numbers(names) or range(len(names)))
    times = dict(zip(names, stamps or counted, strict=True))
    names.sort(key=times.__getitem__)  # -0.2 comes before -0.1, 0.15 before 0.2, and b1 before a2
    if stamps and not by_name:
        frames = _close_together(streams, times, rate)
    else:
        frames = [{camera: name for camera in streams if name in streams[camera]} for name in names]
    return Layout(
        cameras=tuple(streams),
        names=[next(iter(frame.values())) for frame in frames],
        files=[tuple(streams[c][frame[c]] if c in frame else None for c in streams) for frame in frames],
        stamps=np.array([[times[frame[c]] if c in frame else np.nan for c in streams] for frame in frames]),
    )


def _close_together(streams: _Streams, times: dict[str, float], rate: float) -> list[dict[str, str]]:
    """Group images whose timestamps lie within half the cameras' period; return names by camera."""
    steps = np.concatenate([np.diff(sorted(times[name] for name in files)) for files in streams.values()])
    period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1 / rate
    cameras = enumerate(streams.items())
    ordered = sorted((times[name], k, camera, name) for k, (camera, files) in cameras for name in files)
    frames: list[dict[str, str]] = []
    first = -np.inf
    for time, _, camera, name in ordered:
        if not frames or camera in frames[-1] or time - first > 0.5 * period:
            frames.append({})
            first = time
        frames[-1][camera] = name
    return frames
