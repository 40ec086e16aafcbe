"""Images prepared for compiled loops: their light, their labels, their mosaic."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np
from llvmlite import ir
from numba import carray, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from tracker.calibration.rig import CameraRig
from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.lens import stack_lenses
from tracker.objects.labels import UNKNOWN
from tracker.objects.model import Box
from tracker.pose.scale import label_camera, label_factors, window
from tracker.segmentation.color_model import ColorModel, fill_channels
from tracker.segmentation.labels import label_of
from tracker.segmentation.light import evened_level, fill_light, unveiled
from tracker.segmentation.sensor import LOUD, find_mosaic, noise_level

PICTURE = np.dtype(
    [
        ("used", np.bool_),  # whether there is an image that counts
        ("address", np.uint64),  # of its first pixel
        ("hidden", np.uint64),  # of the first pixel of its mask of hidden ones; 0: there is none
        ("height", np.int64),  # [px]
        ("width", np.int64),  # [px]
        ("loud", np.bool_),  # whether it is so noisy that labels are read from filtered pixels
        ("mosaic", np.int64),  # which pixels measured red, or NO_MOSAIC (`segmentation.sensor`)
        ("gains", np.float64, (3,)),  # that neutralise its greys
        ("tilt", np.float64, (2, 2)),  # gradient of the light's colour (`segmentation.light`)
        ("channels", np.int32, (3, 256)),  # offsets into the label table, by level
        ("colored", np.int64),  # face-coloured pixels of its label map
    ]
)
"""One camera's image as a whole."""

TILE = 4
"""Label-map pixels per side of a tile, which is read if its first pixel or that of a neighbouring tile shows
a face colour; all else is background."""


Hidden: TypeAlias = Sequence[Array | None] | None
"""For each camera a mask (H, W) bool of pixels whose labels and edges count neither for nor against a pose,
or None."""


class Sight(NamedTuple):
    """One set of images."""

    labels: Array
    """(C, h, w) label maps, of reduced images."""
    pictures: Array
    """(C,) of PICTURE."""
    images: Sequence[Image | None]
    """(H, W, 3) BGR from the cameras, unchanged; `pictures` points to their memory."""
    hidden: Hidden = None
    """(H, W) masks of pixels whose labels and edges are ignored."""
    shaded: bool = False
    """Whether colours are read as those of faces in shade (`ColorModel.shade_table`)."""

    @property
    def used(self) -> list[int]:
        """Cameras with an image that counts."""
        return [c for c, used in enumerate(self.pictures["used"].tolist()) if used]

    def without(self, *cameras: int) -> Sight:
        """Return the same with some cameras left out."""
        if not cameras:
            return self
        pictures = self.pictures.copy()
        pictures["used"][list(cameras)] = False
        return self._replace(pictures=pictures)


@intrinsic
def _pointer(_: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.CPointer(types.uint8)(address), generate  # type: ignore[no-untyped-call]


@compiled(inline="always")
def pixels_of(picture):  # type: ignore[no-untyped-def]
    """(H, W, 3) the image itself, so that one compiled loop reads images of any size."""
    return carray(_pointer(picture.address), (picture.height, picture.width, 3))  # type: ignore[call-arg]


@compiled(inline="always")
def mask_of(picture):  # type: ignore[no-untyped-def]
    """(H, W) mask of hidden pixels; must not be read if the image has none."""
    return carray(_pointer(picture.hidden), (picture.height, picture.width))  # type: ignore[call-arg]


@compiled
def look_at(image, normalise, fresh, pictures, c):  # type: ignore[no-untyped-def]
    """Fill in where camera c's image (H, W, 3) is, and its light and noise if they are to be measured afresh.

    normalise: of ColorModel.
    """
    picture = pictures[c]
    picture.used, picture.address = True, image.ctypes.data
    picture.height, picture.width = image.shape[0], image.shape[1]
    if not fresh:
        return
    picture.gains[:], picture.tilt[:, :] = 1.0, 0.0
    if normalise:
        fill_light(image, picture.gains, picture.tilt)
    picture.loud = noise_level(image) * min(picture.gains[0], picture.gains[1], picture.gains[2]) >= LOUD
    fill_channels(picture.gains, picture.channels)


@compiled
def _light_slopes(picture, width, height):  # type: ignore[no-untyped-def]
    """Factors of blue and red for a label map's columns (2, w) and rows (2, h); empty in even light."""
    tilt = picture.tilt
    if tilt[0, 0] == 0.0 and tilt[0, 1] == 0.0 and tilt[1, 0] == 0.0 and tilt[1, 1] == 0.0:
        return np.empty((2, 0)), np.empty((2, 0))
    across, down = np.empty((2, width)), np.empty((2, height))
    for k in range(2):
        for i in range(width):
            across[k, i] = math.exp(-tilt[k, 0] * (2.0 * i / width - 1.0))
        for j in range(height):
            down[k, j] = math.exp(-tilt[k, 1] * (2.0 * j / height - 1.0))
    return across, down


@compiled
def _evened_label(b, g, r, at, picture, table, slopes):  # type: ignore[no-untyped-def]
    """Label of a colour at a place (column, row) of the label map, in even light."""
    (i, j), (across, down) = at, slopes
    if across.shape[1] > 0:
        b = evened_level(b, across[0, i] * down[0, j])
        r = evened_level(r, across[1, i] * down[1, j])
    return label_of(b, g, r, picture.channels, table, picture.gains)


@compiled
def _near_color(image, picture, by, table, window, slopes):  # type: ignore[no-untyped-def]
    """Return which tiles (h, w) of a label map show a face colour in a window, or border on one that does."""
    left, top, right, bottom = window
    near = np.zeros((image.shape[0] // by // TILE + 3, image.shape[1] // by // TILE + 3), np.bool_)
    for m in range(top // TILE, (bottom - 1) // TILE + 1):
        for n in range(left // TILE, (right - 1) // TILE + 1):
            j, i = m * TILE, n * TILE
            b, g, r = image[by * j, by * i, 0], image[by * j, by * i, 1], image[by * j, by * i, 2]
            if _evened_label(b, g, r, (i, j), picture, table, slopes) > 0:
                for beside in range(9):
                    near[m + beside // 3, n + beside % 3] = True
    return near[1:-1, 1:-1]


@compiled(counted=True)  # frees what the functions that it calls return
def fill_labels(image, calm, by, table, lenses, around, pictures, c, labels):  # type: ignore[no-untyped-def]
    """Fill labels (C, h, w) of camera c's image around a place, each from by × by pixels; count face colours.

    See equation (2) of docs/how-it-works.md.
    image (H, W, 3); calm: the same, filtered if it is noisy; table (64³,): labels of colours; lenses
    (C,): of the label maps; around: position (3,) and radius [m]; elsewhere labels stay as they are.
    """
    picture, bounds = pictures[c], window(lenses, c, around[0], around[1])
    left, top, right, bottom = bounds
    picture.mosaic = find_mosaic(image)
    slopes = _light_slopes(picture, image.shape[1] // by, image.shape[0] // by)
    near = _near_color(calm, picture, by, table, bounds, slopes)
    # A little more than 1 / area, so that whole numbers are not rounded down.
    area, share, count = by * by, (1.0 + 1e-9) / (by * by), 0
    for j in range(top, bottom):
        for tile in range(left // TILE, (right - 1) // TILE + 1):
            if not near[j // TILE, tile]:
                continue
            for i in range(max(left, tile * TILE), min(right, (tile + 1) * TILE)):
                b, g, r = area // 2, area // 2, area // 2
                for y in range(np.uint64(by * j), np.uint64(by * (j + 1))):
                    for x in range(np.uint64(by * i), np.uint64(by * (i + 1))):
                        b += calm[y, x, 0]
                        g += calm[y, x, 1]
                        r += calm[y, x, 2]
                b, g, r = int(b * share), int(g * share), int(r * share)
                label = _evened_label(b, g, r, (i, j), picture, table, slopes)
                labels[np.uint64(c), np.uint64(j), np.uint64(i)] = label
                count += label > 0
    picture.colored = count


class Reader:
    """Reads images with one colour model, without memory.

    Args:
        box: the object, whose size decides by how much each camera's images are reduced for label maps.
        rig: the cameras.
        colors: the colour model.
    """

    def __init__(self, box: Box, rig: CameraRig, colors: ColorModel) -> None:
        self.colors, self.factors = colors, label_factors(rig.cameras, box, rig.arena)
        small, self._radius = self.label_cameras(rig), box.radius
        self.lenses = stack_lenses(small)
        self.shape = len(small), max(c.height for c in small), max(c.width for c in small)

    def label_cameras(self, rig: CameraRig) -> list[Camera]:
        """Return the cameras of the label maps, for a calibration of the cameras."""
        return [label_camera(camera, by) for camera, by in zip(rig.cameras, self.factors, strict=True)]

    def __call__(self, images: Sequence[Image | None]) -> Sight:
        """Read images (H, W, 3), None for a missing one, each in the light estimated from its own greys."""
        images = self.unveiled(images, {})
        return self.labelled(images, self.lit(images))

    def unveiled(self, images: Sequence[Image | None], timing: dict[str, float]) -> list[Image | None]:
        """Return images (H, W, 3) without their veils, if the light of this colour model is normalised.

        timing receives the duration [ms], under `light`.
        """
        begun = time.perf_counter()
        found = [unveiled(one) if one is not None and self.colors.normalise else one for one in images]
        timing["light"] = 1e3 * (time.perf_counter() - begun)
        return found

    def lit(
        self,
        images: Sequence[Image | None],
        lights: Array | None = None,
        fresh: Sequence[bool] | None = None,
        *,
        as_they_are: bool = False,
    ) -> Array:
        """Return pictures (C,) of PICTURE with their light.

        Args:
            images: of the cameras.
            lights: (C,) of PICTURE, with the light of earlier images; None: there is none.
            fresh: for each camera, whether to estimate its light again; None: all.
            as_they_are: whether greys keep their colour and brightness.
        """
        pictures = np.zeros(len(images), PICTURE) if lights is None else lights.copy()
        normalise = self.colors.normalise and not as_they_are
        pictures["used"], pictures["hidden"] = False, 0
        for c, image in enumerate(images):
            if image is not None:
                look_at(image, normalise, fresh is None or fresh[c], pictures, c)
        return pictures

    def labelled(
        self,
        images: Sequence[Image | None],
        pictures: Array,
        around: FloatArray | None = None,
        hidden: Hidden = None,
        shaded: bool = False,
    ) -> Sight:
        """Return the images with their label maps.

        Args:
            images: of the cameras.
            pictures: from `lit`; the number of face-coloured pixels is filled in.
            around: position (3,) [m]; labels away from it are background. None: all are read.
            hidden: masks of pixels whose labels become UNKNOWN and whose edges are ignored.
            shaded: whether to read colours as those of faces in shade.
        """
        labels = np.zeros(self.shape, np.uint8)
        place = (np.zeros(3), math.inf) if around is None else (around, self._radius)
        table = self.colors.shade_table if shaded else self.colors.label_table
        for c, image in enumerate(images):
            if image is not None:
                by = self.factors[c]
                calm = np.asarray(cv2.medianBlur(image, 3), dtype=np.uint8) if pictures["loud"][c] else image
                fill_labels(image, calm, by, table, self.lenses, place, pictures, c, labels)
                if hidden is not None and (mask := hidden[c]) is not None:
                    pictures["colored"][c] -= _hide(labels[c], mask, by)
                    pictures["hidden"][c] = mask.__array_interface__["data"][0]
        return Sight(labels, pictures, tuple(images), hidden, shaded)


def _hide(labels: Array, mask: Array, by: int) -> int:
    """Mark hidden pixels (H, W) in a label map of by × by pixels each; return how many had a face colour."""
    rows, columns = mask.shape[0] // by, mask.shape[1] // by
    covered = mask[: rows * by, : columns * by].reshape(rows, by, columns, by).any(axis=(1, 3))
    part = labels[:rows, :columns]
    lost = int(np.count_nonzero(part[covered]))
    part[covered] = UNKNOWN
    return lost
