"""What a caller gives, checked where it comes in: names and paths, images and stamps of each camera."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import check_sequence, described, in_range, path_of, seconds
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import ImageError, TrackerError, shown
from tracker.geometry.camera import Camera
from tracker.objects.model import CuboidModel, load_object
from tracker.segmentation.color_model import ColorModel, load_colors
from tracker.segmentation.labels import check_image

PathLike: TypeAlias = str | os.PathLike[str]

Images: TypeAlias = Sequence[Array | None] | Mapping[str, Array | None]
"""One (H, W, 3) uint8 BGR image for each camera, in the rig's order or by the cameras' names; None where
there is none."""

Stamp: TypeAlias = float | Sequence[float] | Mapping[str, float] | FloatArray
"""One stamp [s] for all cameras; or one for each, in the rig's order or by the cameras' names."""


def object_of(model: CuboidModel | PathLike) -> CuboidModel:
    """An object, or that of a name or TOML file; TrackerError where it is neither."""
    if isinstance(model, CuboidModel):
        return model
    valid = "a CuboidModel (tracker.load_object gives one), or its name or TOML file"
    return load_object(path_of(model, "model", TrackerError, valid))


def rig_of(rig: CameraRig | PathLike | Iterable[PathLike]) -> CameraRig:
    """A rig, or that of a folder of calibration files, or of files; TrackerError where it is neither."""
    if isinstance(rig, CameraRig):
        return rig
    valid = "a CameraRig (tracker.CameraRig.load gives one), or the folder of its calibration files"
    return CameraRig.load(rig if isinstance(rig, list | tuple) else path_of(rig, "rig", TrackerError, valid))


def colors_of(colors: ColorModel | PathLike | None, model: CuboidModel) -> ColorModel:
    """A colour model, or that of a name or file; None: the object's. TrackerError where it is neither."""
    if isinstance(colors, ColorModel):
        return colors
    if colors is None:
        return load_colors(model.colors)
    valid = "a ColorModel (tracker.load_colors gives one), or its name or file"
    return load_colors(path_of(colors, "colors", TrackerError, valid))


def check_images(images: Images, rig: CameraRig, least: int = 1) -> list[Image | None]:
    """The images in the rig's order, contiguous and writeable, at least `least` of them.

    Raises:
        ImageError: the wrong count, names, type, shape or size.
    """
    given = _of_each_camera("images", images, rig.names, "an image (H, W, 3) or None")
    checked = [
        None if image is None else _checked(image, camera) for image, camera in zip(given, rig, strict=True)
    ]
    if least and all(image is None for image in checked):
        raise ImageError(
            f"images: all are None; at least one of {', '.join(rig.names)} is needed "
            "(cv2.imread gives None for a file that it cannot read)"
        )
    return checked


def _checked(image: object, camera: Camera) -> Image:
    checked = check_image(image, f"image of {camera.name}")
    height, width = checked.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise ImageError(
            f"image of {camera.name}: {width}×{height} px, but its calibration is for "
            f"{camera.width}×{camera.height}; CameraRig.resized makes one for another size"
        )
    checked = np.ascontiguousarray(checked)
    # Compiled code for arrays that cannot be written would be compiled once more.
    return checked if checked.flags.writeable else checked.copy()


def check_hidden(hidden: Images | None, rig: CameraRig) -> list[Array | None] | None:
    """Masks of hidden pixels in the rig's order, contiguous; None where there is none.

    Raises:
        ImageError: the wrong count, names, type, shape or size.
    """
    if hidden is None:
        return None
    given = _of_each_camera("hidden", hidden, rig.names, "a mask (H, W) of bool or None")
    masks: list[Array | None] = []
    for mask, camera in zip(given, rig, strict=True):
        size, is_array = (camera.height, camera.width), isinstance(mask, np.ndarray)
        if mask is not None and (not is_array or (mask.dtype, mask.shape) != (bool, size)):
            found = described(mask) if is_array else shown(mask)
            raise ImageError(f"hidden of {camera.name}: found {found}, expected bool of shape {size}")
        masks.append(np.ascontiguousarray(mask) if mask is not None and mask.any() else None)
    return masks if any(mask is not None for mask in masks) else None


def _of_each_camera(what: str, given: Any, names: Sequence[str], one: str) -> list[Any]:
    """What is given in the rig's order; ImageError where it is not `one` for each camera."""
    by_name, valid = isinstance(given, Mapping), f"{one} for each camera: {', '.join(names)}"
    ones: Sequence[Any] = _by_camera(what, given, names, ImageError) if by_name else given
    check_sequence(ones, what, ImageError, valid)
    if len(ones) != len(names):
        found = described(given) if isinstance(given, np.ndarray) else len(ones)
        raise ImageError(f"{what}: found {found}, expected {valid}")
    return list(ones)


def _by_camera(
    what: str, values: Mapping[str, Any], names: Sequence[str], error: type[TrackerError]
) -> list[Any]:
    """The values in the rig's order; an error names the cameras that are unknown or missing."""
    unknown = ", ".join(repr(name) for name in values if name not in names)
    missing = ", ".join(name for name in names if name not in values)
    found = [f"unknown {unknown}"] if unknown else []
    found += [f"missing {missing}"] if missing else []
    if found:
        raise error(
            f"{what} by camera: {'; '.join(found)}; one for each of {', '.join(names)} is needed "
            "(None where a camera gave none)"
        )
    return [values[name] for name in names]


def check_stamps(timestamp: Stamp, given: Sequence[bool], names: Sequence[str]) -> tuple[float, FloatArray]:
    """The stamp of the latest image [s], and how much older those of each camera are (C,) [s].

    timestamp: one for all or one for each; given: who gave an image, the others' delay is zero; names: of
    the cameras.

    Raises:
        TrackerError: they are not numbers, not one for each camera, or not finite where there is an image.
    """
    if isinstance(timestamp, Mapping):
        timestamp = _by_camera("timestamp", timestamp, names, TrackerError)
    stamps = seconds(timestamp, "timestamp")
    if stamps.ndim == 0:
        return float(in_range(stamps, "timestamp")), np.zeros(len(given))
    if stamps.shape != (len(given),):
        found = f"{len(stamps)} stamps" if stamps.ndim == 1 else f"an array of shape {stamps.shape}"
        raise TrackerError(f"timestamp: found {found}, expected one, or one for each of {len(given)} cameras")
    seen = np.array(given)
    latest = float(in_range(stamps[seen] if seen.any() else stamps, "timestamp").max())
    return latest, np.where(seen, latest - np.where(seen, stamps, latest), 0.0)
