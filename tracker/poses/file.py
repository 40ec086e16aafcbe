"""Collects poses frame by frame, and stores them in HDF5 files with the names of the platform's logs.

    /frame  /timestamps  /status  /cameras  /camera_names  /camera_info/CAMERA/…
    /object_pose  /filtered_object_pose  /recorded_object_pose: one dataset per column

docs/poses.md describes every dataset. The same poses give the same bytes.
"""

import io
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tracker.calibration.camera_info import CAMERA_DATASETS, read_arena, read_camera, write_arena
from tracker.calibration.rig import CameraRig
from tracker.checks import described, float_array, naming, of_kind, one_stamp, path_of
from tracker.conventions import Array
from tracker.errors import LogError
from tracker.files import HDF5_MAGIC, hdf5, reading, write_whole, writing
from tracker.pose.result import CameraUse, Observation, Status
from tracker.poses.poses import KINDS, About, Kind, Poses


class PosesBuilder:
    """Collects poses frame by frame; `build` returns all so far, and may be called repeatedly."""

    def __init__(self, about: About) -> None:
        self._about = about
        self._frames: list[tuple[int, float, str, list[str], dict[Kind, dict[str, Any]]]] = []

    def append(self, index: int, timestamp: float, answer: Observation, recorded: Any = None) -> None:
        """Add a frame: its number and time [s], the tracker's result, and the recording's own pose or None.

        LogError: the time is not in seconds, a pose lacks a column or has one of the wrong shape, or the
        result has a different number of cameras than the rig.
        """
        stamp = one_stamp(timestamp, f"frame {index}: timestamp", LogError)
        rig, uses = self._about.rig, [_text(use) for use in answer.cameras]
        if uses and len(uses) != len(rig):
            raise LogError(f"cameras: found {len(uses)}, expected {len(rig)}: {', '.join(rig.names)}")
        poses = answer.object_pose, answer.filtered_object_pose, recorded
        rows = {kind: _row(kind, pose) for kind, pose in zip(KINDS, poses, strict=True)}
        self._frames.append((int(index), stamp, _text(answer.status), uses or [""] * len(rig), rows))

    def build(self) -> Poses:
        """Return all frames so far; LogError if a pose or the order of the frames is invalid."""
        frames: Any = zip(*self._frames, strict=True) if self._frames else ((),) * 5
        index, timestamp, status, cameras, rows = frames
        poses: dict[Kind, Any] = {}
        for kind, columns in KINDS.items():
            arrays = {name: array.copy() for name, array in columns.nothing(len(rows)).arrays().items()}
            for number, row in enumerate(rows):
                for name, value in row[kind].items():
                    arrays[name][number] = value
            poses[kind] = columns(**arrays)
        if not any(poses["recorded"].has_pose):
            poses["recorded"] = None
        known = np.array(cameras) if any(any(uses) for uses in cameras) else None
        return Poses(index, timestamp, status, **poses, about=self._about, cameras=known)


def _text(word: Any) -> str:
    return str(getattr(word, "value", word))


def _row(kind: Kind, pose: Any) -> dict[str, Any]:
    """Return copies of a pose's values by column; an empty row without a pose."""
    if pose is None:
        return {}
    row: dict[str, Any] = {"has_pose": True}
    columns = KINDS[kind]
    for name, shape in columns.ROW_SHAPES.items():
        value = getattr(pose, name, None)
        if value is None and name in columns.MAY_BE_UNKNOWN:
            continue
        if value is None:  # NumPy would convert it to NaN
            raise LogError(f"{kind} pose: {name}: found none, expected numbers of shape {shape}")
        row[name] = float_array(value, shape, f"{kind} pose: {name}", LogError, finite=False)
    return row


FORMAT = "trifinger-object-tracker poses"
"""Root attribute `format` of every file of poses."""

VERSION = 1
"""Root attribute `format_version`; it stays the same when datasets are added."""

GROUPS: dict[Kind, str] = {
    "measured": "object_pose",
    "filtered": "filtered_object_pose",
    "recorded": "recorded_object_pose",
}
"""HDF5 group of each kind of poses."""

MAX_FRAMES = 2_000_000
"""Largest number of frames in a file, two days at 10 Hz: a damaged length must not exhaust memory."""

_ABOUT = {"object": "object_name", "source": "source", "tracker_version": "tracker_version"}
"""Field of About for each root attribute."""

_MAY_BE_MISSING = ("fingerprint", "fault")
"""Root attributes, also fields of About, that are written only if they are not empty."""

_DATASETS = {"index": "frame", "timestamp": "timestamps"}
"""Dataset names of the fields of Poses that have another name in the file."""

_UNITS = {
    "timestamps": "s",
    "position": "m",
    "orientation": "x, y, z, w",
    "covariance": "m, rad",
    "velocity": "m/s, rad/s",
    "velocity_covariance": "m/s, rad/s",
    "camera_matrix": "px",
    "tf_world_to_camera": "m",
    "tf_world_to_camera_std": "m",
}
_OLD_SPELLINGS = {
    "no object colours": Status.NO_OBJECT_COLORS.value,
    **{word.value.replace("_", " "): word.value for word in (*Status, *CameraUse)},
}
"""Current values of statuses and camera uses, by their spelling in files up to version 0.1.0."""

_MAX_NAMES = 256
_MAX_CAMERAS = 1000


def write_poses(path: str | os.PathLike[str], poses: Poses) -> None:
    """Write a file, whole or not at all, LogError if that fails; `read_poses` returns the same bits."""
    of_kind(poses, Poses, "poses", LogError, "tracker.track(...).poses")
    with naming(path, LogError, LogError, UnicodeEncodeError):
        content = _content(poses)
    with writing(LogError, path):
        write_whole(path, content)


def read_poses(path: str | os.PathLike[str]) -> Poses:
    """Read a file that `write_poses` wrote.

    Raises:
        LogError: the file is missing or damaged, has another format or version, or contains impossible
            values. The message names the dataset, what was found and what would be valid.
    """
    path = path_of(path, "path of poses", LogError)
    with reading(path):  # a name may be too long
        if not path.is_file():
            there = "a folder" if path.is_dir() else "a pipe or a device"
            found = there if path.exists() else "no such file"
            raise LogError(f"{path}: found {found}, expected a file of poses, as tracker track makes it")
    with hdf5.faults_as_log_errors(str(path)), hdf5.open_file(path) as file:
        return _poses(file)


def is_poses_file(path: str | os.PathLike[str]) -> bool:
    """Whether a file states that it is a file of poses; it may be damaged."""
    return hdf5.text_of(path, "format") == FORMAT


def refuse_other_file(path: Path, what: str) -> None:
    """Raise LogError, naming `what`, unless the path is free or its file has poses, is empty or damaged."""
    if path.exists() and not path.is_file():
        found = "a folder" if path.is_dir() else "a pipe or a device"
        raise LogError(f"{what}: found {found}, expected a file")
    if not path.is_file() or path.stat().st_size == 0 or is_poses_file(path):
        return
    with path.open("rb") as file:
        damaged = file.read(len(HDF5_MAGIC)) == HDF5_MAGIC
    with suppress(OSError, RuntimeError), hdf5.open_file(path):
        damaged = False
    if not damaged:
        raise LogError(f"{what}: found a file that holds no poses, expected another name")


def refuse_other_object(path: Path, what: str, object_name: str) -> None:
    """Raise LogError, naming `what`, if a file has poses of another object; a damaged one may be replaced."""
    try:
        found = read_poses(path).about.object_name
    except LogError:
        return
    if found != object_name:
        expected = f"those of {object_name}, another name, or `tracker track --overwrite`"
        raise LogError(f"{what}: found poses of {found}, expected {expected}")


def _content(poses: Poses) -> bytes:
    """Make the file in memory and return its bytes: an hour at 10 Hz takes 40 MB before compression."""
    # Write to a file object: before HDF5 2.0, the image of an open file has wrong checksums.
    content = io.BytesIO()
    # The format of HDF5 1.10 (2016) has checksums; short files are a fifth as large as in the older one.
    with h5py.File(content, "w", libver=("v110", "v110")) as file:
        file.attrs["format"] = hdf5.encoded(FORMAT)
        file.attrs["format_version"] = VERSION
        for key, attribute in _ABOUT.items():
            file.attrs[key] = hdf5.encoded(getattr(poses.about, attribute))
        for key in _MAY_BE_MISSING:
            if value := getattr(poses.about, key):
                file.attrs[key] = hdf5.encoded(value)
        _put(file, "frame", poses.index)
        _put(file, "timestamps", poses.timestamp)
        _put_texts(file, "status", poses.status)
        if poses.cameras is not None:
            _put_texts(file, "cameras", poses.cameras)
        for kind, name in GROUPS.items():
            columns = getattr(poses, kind)
            if columns is not None:
                group = file.create_group(name)
                for column, array in columns.arrays().items():
                    _put(group, column, array)
        write_arena(file, poses.about.rig.arena)
        _put(file, "camera_names", hdf5.encoded(list(poses.about.rig.names)))
        for camera in poses.about.rig:
            group = file.create_group(f"camera_info/{camera.name}")
            group.attrs["image_width"], group.attrs["image_height"] = camera.width, camera.height
            for name, (attribute, shape) in CAMERA_DATASETS.items():
                value = getattr(camera, attribute)
                if value is not None:
                    _put(group, name, value.reshape(shape))
    return content.getvalue()


def _put(group: Any, name: str, array: Array) -> None:
    # Checksums reveal damage; they and compression need chunks, which empty arrays cannot have.
    filters = {"compression": "gzip", "shuffle": True, "fletcher32": True} if array.size else {}
    dataset = group.create_dataset(name, data=array, track_times=False, **filters)
    if name in _UNITS:
        dataset.attrs["unit"] = hdf5.encoded(_UNITS[name])
    # Flush to fix its place in the file: otherwise garbage collection does, which threads may delay.
    dataset.id.flush()


def _put_texts(file: Any, name: str, texts: Array) -> None:
    names, codes = np.unique(texts, return_inverse=True)
    if len(names) > _MAX_NAMES:
        raise LogError(f"{name}: found {len(names)} different ones, expected at most {_MAX_NAMES}")
    _put(file, name, codes.reshape(texts.shape).astype(np.uint8))
    file[name].attrs["names"] = hdf5.encoded(names.tolist())


def _poses(file: Any) -> Poses:
    _check_format(file)
    frame = hdf5.dataset(file, "frame")
    if frame.ndim != 1 or frame.shape[0] > MAX_FRAMES:
        raise LogError(f"/frame: found shape {frame.shape}, expected (n,) with n up to {MAX_FRAMES}")
    count = frame.shape[0]
    index = hdf5.array(file, "frame", (count,), "iu")
    timestamp = hdf5.array(file, "timestamps", (count,), "f")
    status = _texts(file, "status", (count,))
    columns: dict[Kind, Any] = {}
    for kind, group in GROUPS.items():
        if kind == "recorded" and not hdf5.has_group(file, group):
            columns[kind] = None
            continue
        has_pose = hdf5.array(file, f"{group}/has_pose", (count,), "b")
        rows = {
            name: hdf5.array(file, f"{group}/{name}", (count, *shape), "f")
            for name, shape in KINDS[kind].ROW_SHAPES.items()
        }
        with naming(f"/{group}", LogError, sep="/"):
            columns[kind] = KINDS[kind](has_pose=has_pose, **rows)
    texts = {attribute: hdf5.text(file, key) for key, attribute in _ABOUT.items()}
    texts |= {key: hdf5.text(file, key) for key in _MAY_BE_MISSING if key in file.attrs}
    about, cameras = About(rig=_rig(file), **texts), None
    if hdf5.find(file, "cameras") is not None:  # older files have none
        cameras = _texts(file, "cameras", (count, len(about.rig)))
    try:
        return Poses(index, timestamp, status, **columns, about=about, cameras=cameras)
    except LogError as error:
        field, _, rest = str(error).partition(": ")
        raise LogError(f"/{_DATASETS.get(field, field)}: {rest}") from error


def _check_format(file: Any) -> None:
    if "magic" in file.attrs and "format" not in file.attrs:
        raise LogError(f"found a log of the platform, expected a file of poses (format {FORMAT!r})")
    found = hdf5.text(file, "format")
    if found != FORMAT:
        raise LogError(f"format: found {found!r:.80}, expected {FORMAT!r}")
    version = hdf5.attribute(file, "format_version", "iu")
    if version != VERSION:
        raise LogError(f"format_version: found {version}, expected {VERSION}")


def _texts(file: Any, name: str, shape: tuple[int, ...]) -> Array:
    codes = hdf5.array(file, name, shape, "u")
    with naming(f"/{name}", LogError):
        written = hdf5.decoded(hdf5.attribute(file[name], "names", "S", single=False))
    names = [_OLD_SPELLINGS.get(text, text) for text in written]
    if codes.size and int(codes.max()) >= len(names):
        raise LogError(f"/{name}: found code {codes.max()}, expected codes below {len(names)}, one a name")
    return np.array(names, dtype=np.str_)[codes] if codes.size else np.zeros(shape, dtype=np.str_)


def _rig(file: Any) -> CameraRig:
    dataset = hdf5.dataset(file, "camera_names")
    if dataset.ndim != 1 or dataset.shape[0] > _MAX_CAMERAS:
        found = described(dataset)
        raise LogError(f"/camera_names: found {found}, expected up to {_MAX_CAMERAS} {hdf5.TYPES['S']}")
    cameras = []
    for name in hdf5.decoded(hdf5.array(file, "camera_names", dataset.shape, "S")):
        path = f"camera_info/{name}"
        if not hdf5.has_group(file, path):
            raise LogError(f"/{path}: found none, expected a group for each of /camera_names")
        with naming(f"/{path}", LogError):
            size = [int(hdf5.attribute(file[path], f"image_{key}", "iu")) for key in ("width", "height")]
        cameras.append(read_camera(file, name, (size[0], size[1])))
    return CameraRig(tuple(cameras), read_arena(file))
