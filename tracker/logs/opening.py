"""Opens recordings of any format, lists their files, and finds their calibration."""

import dataclasses
import functools
import os
from collections.abc import Iterable
from pathlib import Path

from tracker.calibration.rig import CameraRig
from tracker.checks import path_of
from tracker.errors import CalibrationError, LogError
from tracker.files import HDF5_MAGIC, on_error, open_regular, reading
from tracker.geometry.camera import Camera
from tracker.logs.datasets import STORE_FILE, DatasetSource, is_store
from tracker.logs.folder import TRUTH_FILE, FolderSource
from tracker.logs.layout import RECORDING_FILE, STAMPS_FILE, check_rate, stated_files
from tracker.logs.layout import SUFFIXES as PICTURE_SUFFIXES
from tracker.logs.log import Log, Source
from tracker.logs.native import NativeSource
from tracker.logs.pictures import FILM_SUFFIXES

DEFAULT_RATE = 10.0
"""Frame rate of the platform's cameras [Hz]."""

JOB_LOGS = ("camera_data.dat", "camera_data.dat.gz", "camera_data.h5", "camera_data.hdf5")
"""Possible file names of the recording in a job's folder."""


def open_log(path: str | os.PathLike[str], *, recover: bool = False, rate: float = DEFAULT_RATE) -> Log:
    """Open a recording of the platform's cameras.

    Formats: native logs (`camera_data.dat`, gzipped or not), HDF5 logs, a job's folder with one of these,
    folders of images or of films, films, and image stores of trifinger_rl_datasets (`NAME.zarr`). The format
    is recognised by its content, not by name, except for films. Frames are read on access.

    Args:
        path: the file or folder.
        recover: skip damaged frames and describe them in `Log.fault`, instead of raising.
        rate: frame rate [Hz] of folders of images whose names are not timestamps.

    Raises:
        LogError: the path is missing, its format is unknown, or damage shows on opening.
    """
    check_rate(rate, "rate")
    root = path_of(path, "path of a recording", LogError)
    with reading(root):
        source = _source(root, rate)
        with on_error(source.close):
            return Log(source, recover=recover)


def recording_files(path: Path) -> list[Path]:
    """List all files that `open_log` may read frames from, in a fixed order."""
    if not path.is_dir():
        return [path]
    found = _existing(path, (*JOB_LOGS, STORE_FILE))
    if found:
        return found
    suffixes = (*PICTURE_SUFFIXES, *FILM_SUFFIXES)
    descriptions = (TRUTH_FILE, RECORDING_FILE, STAMPS_FILE)
    for folder, folders, names in os.walk(path, onerror=_refuse, followlinks=True):
        here = Path(folder) == path or not os.path.islink(folder)  # a link may lead back, or far away
        folders[:] = sorted(name for name in folders if here and not name.startswith("."))
        files = (Path(folder, name) for name in sorted(names) if not name.startswith("."))
        found += [file for file in files if file.suffix.lower() in suffixes or file.name in descriptions]
    if (path / RECORDING_FILE).is_file():  # its patterns lead through links, too
        found += stated_files(path)
    return list(dict.fromkeys(found))


def calibration_files(path: Path) -> list[Path]:
    """List the files beside the recording or in its folder that may hold its calibration."""
    path = Path(os.path.abspath(path))  # the parent of `..` is not `.`
    if path.name == STORE_FILE:
        path = path.parent
    folders = [path.parent]
    if path.is_dir():
        folders = [path] if _existing(path, JOB_LOGS) else [path, path.parent]
        if (path / TRUTH_FILE).is_file():  # a synthetic film may state its calibration in its first frame
            folders += sorted(filter(Path.is_dir, path.glob("[0-9]*")))[:1]
    return [file for folder in folders for file in _calibration_in(folder, folder.stat().st_mtime_ns)]


def _existing(folder: Path, names: Iterable[str]) -> list[Path]:
    return [folder / name for name in names if (folder / name).is_file()]


def _refuse(error: OSError) -> None:
    raise error


@functools.lru_cache(maxsize=64)
def _calibration_in(folder: Path, _: int) -> list[Path]:
    """Return the calibration files in a folder, cached by its modification time: recordings share it."""
    names = sorted(os.listdir(folder))
    return [folder / name for name in names if name == "arena.toml" or name.endswith((".yml", ".yaml"))]


def _source(path: Path, rate: float) -> Source:
    if is_store(path):
        return DatasetSource(path)
    if path.is_dir():
        logs = _existing(path, JOB_LOGS)
        if len(logs) > 1:
            found = " and ".join(log.name for log in logs)
            raise LogError(f"{path}: found {found}, expected one: name the file")
        return _source(logs[0], rate) if logs else FolderSource(path, rate=rate)
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    with open_regular(path) as file:
        is_hdf5 = file.read(len(HDF5_MAGIC)) == HDF5_MAGIC
    if path.suffix.lower() in FILM_SUFFIXES:
        return FolderSource(path, rate=rate)
    if is_hdf5:
        from tracker.logs.hdf5_reader import Hdf5Source

        return Hdf5Source(path)
    return NativeSource(path)


def fitted_to(
    path: str | os.PathLike[str],
    log: Log,
    rig: CameraRig | None = None,
    *,
    correct_halved_principal_point: bool = False,
    resize: bool = False,
) -> CameraRig:
    """Return the rig with its cameras in the order of a recording's images.

    Cameras are matched by name, or by order if none of the names is known.

    Args:
        path: name of the recording in errors.
        log: the recording.
        rig: the cameras; None: the calibration in or beside the recording.
        correct_halved_principal_point: whether that calibration was halved without the quarter pixel.
        resize: scale the calibration to images of another size but the same aspect ratio.

    Raises:
        CalibrationError: there is no calibration, or its cameras or image sizes differ.
    """
    where, names = os.fspath(path), log.camera_names
    if rig is None:
        rig = log.rig
        if rig is None:
            expected = f"--calibration, the folder with a file of each camera, like {names[0]}.yml"
            if len(log.episode_starts) > 1:
                expected += "; or one scene's folder alone, if each has its own"
            found = f"no calibration of {', '.join(names)} in or beside it"
            raise CalibrationError(f"{where}: found {found}, expected {expected}")
        if correct_halved_principal_point:
            cameras = tuple(camera.with_halved_principal_point_corrected() for camera in rig)
            rig = dataclasses.replace(rig, cameras=cameras)
    known = set(rig.names) & set(names)
    if len(rig) != len(names) or (known and set(rig.names) != set(names)):
        lacking = [name for name in names if name not in rig.names] if known else []
        valid = f"that of {', '.join(lacking)}, too" if lacking else "the same cameras"
        found = f"images of {', '.join(names)}, but a calibration of {', '.join(rig.names)}"
        raise CalibrationError(f"{where}: found {found}; expected {valid}")
    ordered = [rig[rig.names.index(name)] for name in names] if known else list(rig)
    for number, size in enumerate(log.image_sizes):
        if any(size):  # otherwise no image of the camera is readable, and reading them reports why
            ordered[number] = sized_for(size, ordered[number], where, resize=resize)
    return dataclasses.replace(rig, cameras=tuple(ordered))


def sized_for(size: tuple[int, int], camera: Camera, where: str, *, resize: bool) -> Camera:
    """Return the camera for images of a size (width, height) [px], scaled to it with `resize`.

    CalibrationError: the size differs or, with `resize`, the aspect ratio: images were cropped.
    """
    width, height = size
    if (camera.width, camera.height) == size:
        return camera
    remedy = "; if they show the same, scaled, use --resize-calibration (in Python CameraRig.resized)"
    if abs(width * camera.height / camera.width - height) >= 1:
        remedy = ", which is of another shape: expected whole images, or a calibration of what they show"
    elif resize:
        return camera.resized(width, height)
    known = f"of {camera.name}, but its calibration is for {camera.width}×{camera.height}"
    raise CalibrationError(f"{where}: found images of {width}×{height} px {known}{remedy}")
