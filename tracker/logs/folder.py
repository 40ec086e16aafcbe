"""Folders of PNG or JPEG pictures, or of films; which of them belong together.

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

import dataclasses
import itertools
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import naming
from tracker.conventions import FloatArray, Image
from tracker.errors import LogError
from tracker.files import read_bounded, told_of
from tracker.geometry.camera import may_be_name
from tracker.logs import films
from tracker.logs.films import FilmFile, FilmPicture
from tracker.logs.frame import LogFrame, checked_stamp
from tracker.logs.log import MAX_SIDE, Source, check_same_size, check_sides, rig_beside
from tracker.logs.pictures import decode, head_of
from tracker.logs.recording_file import RecordingFile, read_recording_file

SUFFIXES = (".png", ".jpg", ".jpeg")
"""Of pictures."""

TRUTH_FILE = "ground_truth.json"
"""What `python -m synthetic dataset` writes beside the pictures; stamps are taken from it."""

_PAUSE = 8  # frames; dropped pictures of a sequence are single ones, between motions there are 10 or more

_MAX_FILE = 4 * MAX_SIDE * MAX_SIDE  # more bytes than the largest picture, uncompressed
_MAX_TRUTH = 1 << 28  # bytes; a frame has about 1000

_FIRST, _LAST = 10**9, 41 * 10**8  # the years 2001 to 2099 [s since the epoch]
_PER_SECOND = (1, 10**3, 10**6, 10**9)
_NAME = re.compile(r"(?:(?P<minus>-)|\D*?)(?P<whole>\d{1,20})(?P<fraction>\.\d{1,12})?")
_CAMERA = re.compile(r"camera\w*")
_NUMBER = re.compile(r"\d{1,20}(\.\d{1,12})?")

Picture = Path | FilmPicture
"""A file, or a picture of a film."""

_Streams = dict[str, dict[str, Picture]]
"""Of each camera its pictures by name."""


class FolderSource(Source):
    """A folder of pictures, or of films."""

    gaps = True  # pictures may have been taken at any time

    def __init__(self, path: Path, *, rate: float) -> None:
        super().__init__(path)
        self._layout = layout = find_layout(path, rate)
        self.camera_names, self.count = layout.cameras, len(layout.names)
        pictures = itertools.chain.from_iterable(layout.files)
        self._films = {file.film for file in pictures if isinstance(file, FilmPicture)}
        self.format = "films" if self._films else "folder of images"
        self._stamps = layout.stamps
        if (path / TRUTH_FILE).is_file():
            self._read_truth(path / TRUTH_FILE)
        self.image_sizes = tuple(map(_first_size, zip(*layout.files, strict=True)))

    def read(self, index: int) -> LogFrame:
        """See Source."""
        files = zip(self._layout.files[index], self.image_sizes, strict=True)
        images = tuple(None if file is None else _picture(file, size) for file, size in files)
        stamps = self._stamps[index].copy()
        if np.isnan(stamps).all():
            name = self._layout.names[index]
            raise LogError(
                f"{self.where(index)}: {name} is missing in {TRUTH_FILE}, expected its stamp there"
            )
        stamp = checked_stamp(float(np.nanmean(stamps)), what=self.where(index))
        return LogFrame(index, stamp, stamps, images, None, None)

    def rig(self) -> CameraRig | None:
        """See Source."""
        return rig_beside(self.path, self.camera_names) or super().rig()

    def where(self, index: int) -> str:
        """See Source."""
        return f"{self.path}: frame {index} ({self._layout.names[index]})"

    def close(self) -> None:
        """See Source."""
        for film in self._films:
            film.close()

    def _read_truth(self, file: Path) -> None:
        """Take the stamps from there, NaN where a frame has none."""
        text = _content(file, _MAX_TRUTH)
        try:
            content = json.loads(text.decode("utf-8"))
            truth = {str(item["frame"]): float(item["timestamp"]) for item in content["frames"]}
            settings = {"rate": 10.0, "sequence": True, **content.get("settings", {})}
            rate = max(1e-3, float(settings["rate"]))
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            raise LogError(f"{file}: found no stamps of frames: {' '.join(str(error).split())}") from error
        self.format += ", synthetic"
        stamps = np.array([truth.get(name, np.nan) for name in self._layout.names])
        self._stamps = np.where(np.isnan(self._stamps), np.nan, stamps[:, None])
        # The synthetic robot starts again with each single scene, and after a pause in a sequence.
        pause = _PAUSE / rate if settings["sequence"] else 0.0
        self.episode_starts = (0, *(int(k) for k in np.flatnonzero(np.diff(stamps) > pause) + 1))


def _picture(file: Picture, size: tuple[int, int]) -> Image:
    """A picture, of the same size as the camera's first."""
    if isinstance(file, FilmPicture):
        return file.film.picture(file.number)
    with naming(file, LogError):
        image = decode(_content(file))
        check_same_size(image.shape[1::-1], size)
        return image


def _first_size(files: Iterable[Picture | None]) -> tuple[int, int]:
    """(width, height) [px] of the first of a camera's pictures that states it; zeros if none does."""
    for file in files:
        if isinstance(file, FilmPicture):
            return file.film.size
        if file is not None:
            with suppress(LogError):
                size = head_of(_content(file)).size
                check_sides(*size)
                return size
    return 0, 0


def _content(file: Path, largest: int = _MAX_FILE) -> bytes:
    with told_of(file):
        return read_bounded(file, largest)


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
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


def _counted_stamps(names: Sequence[str], rate: float) -> list[float]:
    """Stamps [s] at `rate` [Hz]: by the numbers in the names, so that missing ones are gaps, or in order."""
    matches = [_NAME.fullmatch(name) for name in names]
    numbers = [int(m["whole"]) for m in matches if m and not m["fraction"] and len(m["whole"]) < 12]
    counted = len(numbers) == len(names) and len(set(numbers)) == len(names)
    return [number / rate for number in (numbers if counted else range(len(names)))]


@dataclass(frozen=True, eq=False)
class Layout:
    """The frames of a folder, in order."""

    cameras: tuple[str, ...]
    """Names of the cameras."""
    names: list[str]
    """Of each frame the name of its folder, or of its first file without suffix."""
    files: list[tuple[Picture | None, ...]]
    """Of each frame the picture of each camera, None where it has none."""
    stamps: FloatArray
    """(n, C) stamp of each picture [s], NaN where there is none."""


def find_layout(root: Path, rate: float) -> Layout:
    """What belongs together in a folder, or in one camera's film; LogError if there is no frame.

    rate: frames per second [Hz] where names are not stamps.
    """
    if root.is_file():
        return _of_streams({_name_of_lone_camera(root.stem): _film(root)}, rate)
    stated = read_recording_file(root)
    if stated is not None:
        return _of_stated(root, stated, rate)
    folders = sorted((item for item in _visible(root) if item.is_dir()), key=lambda f: _natural(f.name))
    streams = _of_folders(folder for folder in folders if _CAMERA.fullmatch(folder.name))
    if streams:
        return _of_streams(streams, rate)
    frames = {folder.name: _of_cameras(folder) for folder in folders}
    if not any(frames.values()):  # a loose picture beside folders of them is for instance an overlay
        frames = {root.name: _of_cameras(root)}
    if any(frames.values()):
        cameras = sorted({name for files in frames.values() for name in files}, key=_natural)
        streams = {
            name: {frame: files[name] for frame, files in frames.items() if name in files} for name in cameras
        }
        return _of_streams(streams, rate, by_name=True)
    streams = _films(root) or _without_names(root, folders)
    if streams:
        return _of_streams({name: streams[name] for name in sorted(streams, key=_natural)}, rate)
    raise LogError(
        f"{root}: found no pictures of cameras, expected folders like 000000 with camera60.png, "
        "or folders like camera60 with 000000.png, or films like camera60.mp4, or recording.toml, "
        "or a recording such as camera_data.dat"
    )


def _visible(folder: Path) -> Iterator[Path]:
    return (item for item in folder.iterdir() if not item.name.startswith("."))


def _pictures(folder: Path) -> list[Path]:
    files = (item for item in _visible(folder) if item.suffix.lower() in SUFFIXES)
    return sorted(files, key=lambda file: (_natural(file.stem), file.name))


def _by_name(files: Iterable[Path], what: str = "name") -> dict[str, Picture]:
    """Files by their names without suffix, of which there is one each."""
    result: dict[str, Path] = {}
    for file in files:
        other = result.setdefault(file.stem, file)
        if other is not file:
            raise LogError(f"{file}: found {other.name} too, expected one picture of a {what}")
    return dict(result)


def _of_folders(folders: Iterable[Path]) -> _Streams:
    """The pictures in each folder that has some."""
    found = {folder.name: _by_name(_pictures(folder)) for folder in folders}
    return {name: files for name, files in found.items() if files}


def _of_cameras(folder: Path) -> dict[str, Picture]:
    """The pictures in a frame's folder that are named after cameras."""
    return _by_name((file for file in _pictures(folder) if _CAMERA.fullmatch(file.stem)), "camera")


def _films(root: Path) -> _Streams:
    """The films in a folder; those that are named after cameras, if there are any."""
    found = {file.stem: file for file in sorted(_visible(root)) if file.suffix.lower() in films.SUFFIXES}
    named = {name: file for name, file in found.items() if _CAMERA.fullmatch(name)}
    return {name: _film(file) for name, file in (named or found).items()}


def _film(file: Path, *, counted: bool = False) -> dict[str, Picture]:
    """Pictures of a film by their stamps, or by their numbers."""
    film = FilmFile(file)
    names = [f"{k:06d}" if counted else f"{stamp:.9f}" for k, stamp in enumerate(film.stamps)]
    return {name: FilmPicture(film, k) for k, name in enumerate(names)}


def _without_names(root: Path, folders: list[Path]) -> _Streams:
    """Folders of cameras with other names, or one camera's folder: nothing but numbers are its pictures."""
    here = _pictures(root)
    if here and all(_NUMBER.fullmatch(file.stem) for file in here):
        return {_name_of_lone_camera(root.resolve().name): _by_name(here)}
    return {
        name: files
        for name, files in _of_folders(folders).items()
        if not _NUMBER.fullmatch(name) and all(map(_NUMBER.fullmatch, files))
    }


def _name_of_lone_camera(name: str) -> str:
    """What the only camera is called: as its file or folder, which may be called anything."""
    return name if may_be_name(name) else "camera"


def _of_stated(root: Path, stated: RecordingFile, rate: float) -> Layout:
    """The frames of a folder that says which files are whose."""
    counted = stated.stamps is not None or stated.rate is not None
    streams: _Streams = {}
    for name, files in stated.cameras.items():
        some = list(files.values())
        if some[0].suffix.lower() not in films.SUFFIXES:
            streams[name] = {key: files[key] for key in sorted(files, key=_natural)}
        elif len(some) == 1:
            streams[name] = _film(some[0], counted=counted)
        else:
            raise LogError(f"{root}: {name}: found {len(some)} films, expected one of each camera")
    if counted:
        streams |= _numbered_as_films(streams)
    keys = [key for files in streams.values() for key in files]
    if len(streams) > 1 and len(set(keys)) == len(keys) and stamps_of_names(keys) is None:
        streams = {
            name: {f"{k:06d}": picture for k, picture in enumerate(files.values())}
            for name, files in streams.items()
        }
    layout, stamps = _of_streams(streams, stated.rate or rate), stated.stamps
    if stamps is None:
        return layout
    if len(stamps) != len(layout.names):
        raise LogError(
            f"{root}: stamps.csv: found {len(stamps)} lines, expected one for each of "
            f"{len(layout.names)} frames"
        )
    return dataclasses.replace(layout, stamps=np.where(np.isnan(layout.stamps), np.nan, stamps))


def _numbered_as_films(streams: _Streams) -> _Streams:
    """Pictures beside films, whose names are numbers, called as those of films are, from 000000 on."""
    named = {name: files for name, files in streams.items() if isinstance(next(iter(files.values())), Path)}
    keys = [key for files in named.values() for key in files]
    if len(named) == len(streams) or not all(key.isdecimal() for key in keys) or stamps_of_names(keys):
        return {}
    first = min(map(int, keys), default=0)
    renamed = {
        name: {f"{int(key) - first:06d}": file for key, file in files.items()}
        for name, files in named.items()
    }
    unique = all(len(renamed[name]) == len(files) for name, files in named.items())  # no 1.png beside 01.png
    return renamed if unique else {}


def _of_streams(streams: _Streams, rate: float, *, by_name: bool = False) -> Layout:
    """Frames of pictures of the same name or, where names are stamps and not `by_name`, close together."""
    names = sorted({name for files in streams.values() for name in files}, key=_natural)
    stamps = stamps_of_names(names)
    times = dict(zip(names, stamps or _counted_stamps(names, rate), strict=True))
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
    """Of each frame its pictures by camera: their stamps differ by less than half the cameras' period."""
    steps = np.concatenate([np.diff([times[name] for name in files]) for files in streams.values()])
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
