"""What a caller gives, checked where it comes in: names and paths, images and stamps of each camera."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import check_sequence, described, in_range, one_stamp, seconds
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import ImageError, TrackerError, shown
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
    _check_name("model", model, "a CuboidModel (tracker.load_object gives one), or its name or TOML file")
    return load_object(model)


def rig_of(rig: CameraRig | PathLike | Iterable[PathLike]) -> CameraRig:
    """A rig, or that of a folder of calibration files, or of files; TrackerError where it is neither."""
    if isinstance(rig, CameraRig):
        return rig
    if not isinstance(rig, list | tuple):
        valid = "a CameraRig (tracker.CameraRig.load gives one), or the folder of its calibration files"
        _check_name("rig", rig, valid)
    return CameraRig.load(rig)


def colors_of(colors: ColorModel | PathLike | None, model: CuboidModel) -> ColorModel:
    """A colour model, or that of a name or file; None: the object's. TrackerError where it is neither."""
    if isinstance(colors, ColorModel):
        return colors
    if colors is None:
        return load_colors(model.colors)
    _check_name("colors", colors, "a ColorModel (tracker.load_colors gives one), or its name or file")
    return load_colors(os.fspath(colors))


def _check_name(what: str, given: object, valid: str) -> None:
    if not isinstance(given, str) and not isinstance(given, os.PathLike):
        raise TrackerError(f"{what}: {type(given).__name__} given; {valid} is needed")


def check_images(images: Images, rig: CameraRig, least: int = 1) -> list[Image | None]:
    """The images in the rig's order, contiguous and writeable, at least `least` of them.

    Raises:
        ImageError: the wrong count, names, type, shape or size.
    """
    names = ", ".join(rig.names)
    given: Any = images
    if isinstance(images, Mapping):
        given = _by_camera("images", images, rig.names, ImageError)
    if isinstance(given, str | bytes) or not isinstance(given, Sequence | np.ndarray):
        raise ImageError(
            f"images: {type(given).__name__} given; a sequence of images is needed, or a dict by camera: "
            f"{names}"
        )
    if isinstance(given, np.ndarray) and given.ndim != 4:
        raise ImageError(f"images: one array of shape {given.shape} given; a sequence of images is needed")
    if len(given) != len(rig):
        raise ImageError(
            f"images: {len(given)} given; {len(rig)} are needed, one for each of {names} "
            "(None where a camera gave none)"
        )
    checked = [
        None if image is None else _checked(image, camera.name, (camera.width, camera.height))
        for image, camera in zip(given, rig, strict=True)
    ]
    if least and all(image is None for image in checked):
        raise ImageError(
            f"images: all are None; at least one of {names} is needed "
            "(cv2.imread gives None for a file that it cannot read)"
        )
    return checked


def _checked(image: object, name: str, size: tuple[int, int]) -> Image:
    checked = check_image(image, f"image of {name}")
    height, width = checked.shape[:2]
    if (width, height) != size:
        raise ImageError(
            f"image of {name}: {width}×{height} px, but its calibration is for {size[0]}×{size[1]}; "
            "CameraRig.resized makes one for another size"
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
    valid = f"a mask (H, W) of bool or None for each camera: {', '.join(rig.names)}"
    given: Any = hidden
    if isinstance(hidden, Mapping):
        given = _by_camera("hidden", hidden, rig.names, ImageError)
    check_sequence(given, "hidden", ImageError, valid)
    if len(given) != len(rig):
        raise ImageError(f"hidden: found {len(given)}, expected {valid}")
    masks: list[Array | None] = []
    for mask, camera in zip(given, rig, strict=True):
        size, is_array = (camera.height, camera.width), isinstance(mask, np.ndarray)
        if mask is not None and (not is_array or (mask.dtype, mask.shape) != (bool, size)):
            found = described(mask) if is_array else shown(mask)
            raise ImageError(f"hidden of {camera.name}: found {found}, expected bool of shape {size}")
        masks.append(np.ascontiguousarray(mask) if mask is not None and mask.any() else None)
    return masks if any(mask is not None for mask in masks) else None


def _by_camera(
    what: str, values: Mapping[str, Any], names: Sequence[str], error: type[TrackerError] = TrackerError
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


class Stamps(NamedTuple):
    """The moment for which a pose is asked, and how much older the images are."""

    latest: float
    """[s]"""
    delays: FloatArray
    """(C,) [s], zero for cameras without an image."""


def check_stamp(timestamp: object) -> float:
    """One stamp [s]; TrackerError where it is none."""
    return one_stamp(timestamp, "timestamp")


def check_stamps(timestamp: Stamp, given: Sequence[bool], names: Sequence[str]) -> Stamps:
    """The stamps of the cameras' images, from one [s] for all or one for each.

    given: who gave an image; names: of the cameras.

    Raises:
        TrackerError: they are not numbers, not one for each camera, or not finite where there is an image.
    """
    if isinstance(timestamp, Mapping):
        timestamp = _by_camera("timestamp", timestamp, names)
    stamps = seconds(timestamp, "timestamp")
    if stamps.ndim == 0:
        return Stamps(float(in_range(stamps, "timestamp")), np.zeros(len(given)))
    if stamps.shape != (len(given),):
        found = f"{len(stamps)} stamps" if stamps.ndim == 1 else f"an array of shape {stamps.shape}"
        raise TrackerError(f"timestamp: found {found}, expected one, or one for each of {len(given)} cameras")
    seen = np.array(given)
    latest = float(in_range(stamps[seen] if seen.any() else stamps, "timestamp").max())
    return Stamps(latest, np.where(seen, latest - np.where(seen, stamps, latest), 0.0))
