"""Checks of the caller's input: object, rig and colours, and the images and timestamps of each camera."""

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import LATEST, UNSTAMPED, check_sequence, in_range, path_of, seconds
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import ImageError, TrackerError, shown
from tracker.objects.model import CuboidModel, load_object
from tracker.segmentation.color_model import ColorModel, load_colors
from tracker.segmentation.labels import check_image

PathLike: TypeAlias = str | os.PathLike[str]

Images: TypeAlias = Sequence[Array | None] | Mapping[str, Array | None]
"""One (H, W, 3) uint8 BGR image per camera, in the rig's order or by camera name; None for a missing one."""

Stamp: TypeAlias = float | Sequence[float | None] | Mapping[str, float] | FloatArray
"""One timestamp [s] for all cameras, or one per camera, in the rig's order or by camera name; None without an
image."""


NO_IMAGE = "none"
"""Stands for a missing image among files."""


def object_of(model: CuboidModel | PathLike) -> CuboidModel:
    """Return an object, given itself, its name or its TOML file; TrackerError for anything else."""
    if isinstance(model, CuboidModel):
        return model
    valid = "a CuboidModel (tracker.load_object gives one), or its name or TOML file"
    return load_object(path_of(model, "model", TrackerError, valid))


def rig_of(rig: CameraRig | PathLike | Iterable[PathLike]) -> CameraRig:
    """Return a rig, given itself, its calibration files or their folder; TrackerError for anything else."""
    if isinstance(rig, CameraRig):
        return rig
    valid = "a CameraRig (tracker.CameraRig.load gives one), or the folder of its calibration files"
    several = isinstance(rig, Iterable) and not isinstance(rig, str | bytes | np.ndarray)
    return CameraRig.load(rig if several else path_of(rig, "rig", TrackerError, valid))


def colors_of(colors: ColorModel | PathLike | None, model: CuboidModel) -> ColorModel:
    """Return a colour model, given itself, its name or file, or None for the object's; else TrackerError."""
    if isinstance(colors, ColorModel):
        return colors
    if colors is None:
        return load_colors(model.colors)
    valid = "a ColorModel (tracker.load_colors gives one), or its name or file"
    return load_colors(path_of(colors, "colors", TrackerError, valid))


def of_cameras(paths: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return one set of files in the order of the cameras that they or their folders are named after.

    Without such names, in the given order. NO_IMAGE stands for a missing image. ImageError if there are too
    few or too many, or if names contradict the cameras.
    """
    each = f"one for each of {', '.join(names)} ('{NO_IMAGE}' for a missing image)"
    if len(paths) != len(names):
        raise ImageError(f"images: found {len(paths)}, expected {len(names)}, {each}")
    given = [Path(path) for path in paths if path != NO_IMAGE]
    if not given:
        raise ImageError(f"images: found only '{NO_IMAGE}', expected at least one file")
    shared = len(given) > 1 and len({path.parent for path in given}) == 1  # a common folder names none
    called = [
        camera_in(path.stem, names) or (None if shared else camera_in(path.parent.name, names))
        for path in given
    ]
    if not any(called):
        return list(paths)
    found: dict[str, Path] = {}
    for path, camera in zip(given, called, strict=True):
        if camera is None or camera not in names:
            whose = f"named after {camera}" if camera else "named after no camera, but others are"
            raise ImageError(f"{path}: {whose}; expected {each}")
        if camera in found:
            raise ImageError(f"{path}: named after {camera}, as {found[camera]} is; expected {each}")
        found[camera] = path
    return [str(found.get(name, NO_IMAGE)) for name in names]


def camera_in(text: str, names: Sequence[str]) -> str | None:
    """Return the camera that a file's or folder's name contains, but not within a longer word or number.

    A name that differs from one of `names` only in its number is another camera. Several are joined by "and".
    """
    words = {name.rstrip("0123456789") for name in names if name[-1].isdigit()} - {""}
    patterns = [*map(re.escape, names), *(rf"{re.escape(word)}\d+" for word in words)]
    found = set()
    for pattern in patterns:
        for match in re.finditer(rf"(?<![0-9A-Za-z])(?:{pattern})", text):
            after = text[match.end() :][:1]
            if not (after.isdigit() if match[0][-1].isdigit() else after.isalpha()):
                found.add(match[0])
    whole = sorted(one for one in found if not any(one in other for other in found - {one}))
    return " and ".join(whole) or None


def check_images(images: Images, rig: CameraRig, least: int = 1) -> list[Image | None]:
    """Return the images in the rig's order, contiguous and writeable; None where one is missing.

    ImageError if number, names, type, shape or size are wrong; or, unless `least` is 0, if all are None.
    """
    given = _of_each_camera("images", images, rig.names, "an image (H, W, 3) or None")
    checked: list[Image | None] = []
    for image, camera in zip(given, rig, strict=True):
        checked.append(None if image is None else check_image(image, f"image of {camera.name}"))
        if image is not None and image.shape[1::-1] != (camera.width, camera.height):
            height, width = image.shape[:2]
            raise ImageError(
                f"image of {camera.name}: {width}×{height} px, but its calibration is for "
                f"{camera.width}×{camera.height}; CameraRig.resized makes one for another size"
            )
    if least and all(image is None for image in checked):
        raise ImageError(
            f"images: found None for all, expected at least one of {', '.join(rig.names)} "
            "(cv2.imread gives None for a file that it cannot read)"
        )
    return checked


def check_hidden(hidden: Images | None, rig: CameraRig) -> list[Array | None] | None:
    """Return the masks of hidden pixels in the rig's order, contiguous; None for a missing or empty mask.

    ImageError if number, names, type, shape or size are wrong.
    """
    if hidden is None:
        return None
    given = _of_each_camera("hidden", hidden, rig.names, "a mask (H, W) of bool or None")
    masks: list[Array | None] = []
    for mask, camera in zip(given, rig, strict=True):
        size = camera.height, camera.width
        fits = isinstance(mask, np.ndarray) and (mask.dtype, mask.shape) == (bool, size)
        if mask is not None and not fits:
            found = shown(mask)
            raise ImageError(f"hidden of {camera.name}: found {found}, expected bool of shape {size}")
        masks.append(np.ascontiguousarray(mask) if mask is not None and mask.any() else None)
    return masks if any(mask is not None for mask in masks) else None


def _of_each_camera(what: str, given: Any, names: Sequence[str], one: str) -> list[Any]:
    """Return the given values in the rig's order; ImageError unless there is one (`one`) per camera."""
    by_name, valid = isinstance(given, Mapping), f"{one} for each camera: {', '.join(names)}"
    ones: Sequence[Any] = _by_camera(what, given, names, ImageError, "None") if by_name else given
    check_sequence(ones, what, ImageError, valid)
    if len(ones) != len(names):
        found = shown(given) if isinstance(given, np.ndarray) else len(ones)
        raise ImageError(f"{what}: found {found}, expected {valid}")
    return list(ones)


def _by_camera(
    what: str, values: Mapping[str, Any], names: Sequence[str], error: type[TrackerError], nothing: str
) -> list[Any]:
    """Return the values in the rig's order; the error lists cameras that are unknown or missing.

    nothing: what stands for the value of a camera that gave no image.
    """
    unknown = ", ".join(repr(name) for name in values if name not in names)
    missing = ", ".join(name for name in names if name not in values)
    found = [f"unknown {unknown}"] if unknown else []
    found += [f"missing {missing}"] if missing else []
    if found:
        raise error(
            f"{what} by camera: {'; '.join(found)}; expected one for each of {', '.join(names)} "
            f"({nothing} for a missing image)"
        )
    return [values[name] for name in names]


def check_stamps(timestamp: Stamp, given: Sequence[bool], names: Sequence[str]) -> tuple[float, list[float]]:
    """Return the timestamp of the latest image [s], and by how much each camera's image is older [s].

    timestamp: one for all cameras or one per camera; given: whether each camera gave an image (if not, its
    delay is zero); names: the cameras' names. TrackerError if they are not numbers, not one per
    camera, or not finite for a camera that gave an image.
    """
    same = [0.0] * len(given)
    if type(timestamp) is float and abs(timestamp) <= LATEST:
        return timestamp, same
    if isinstance(timestamp, Mapping):
        timestamp = _by_camera("timestamp", timestamp, names, TrackerError, "nan")
    if isinstance(timestamp, (list, tuple)) and any(one is None for one in timestamp):
        timestamp = [math.nan if one is None else one for one in timestamp]
    stamps = seconds(timestamp, "timestamp")
    if stamps.ndim == 0:
        return float(in_range(stamps, "timestamp")), same
    if stamps.shape != (len(given),):
        found = f"{len(stamps)} stamps" if stamps.ndim == 1 else f"an array of shape {stamps.shape}"
        raise TrackerError(f"timestamp: found {found}, expected one, or one for each of {len(given)} cameras")
    values, some = stamps.tolist(), any(given)
    counting = [
        one for one, seen in zip(values, given, strict=True) if (seen if some else math.isfinite(one))
    ]
    if not counting:
        raise TrackerError(f"timestamp: {UNSTAMPED}")
    if not all(abs(one) <= LATEST for one in counting):
        in_range(np.array(counting), "timestamp")
    latest = max(counting)
    return latest, [latest - one if seen else 0.0 for one, seen in zip(values, given, strict=True)]
