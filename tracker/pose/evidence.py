"""From pictures to what the pose estimator needs of them: labels, colours, the pattern of a mosaic."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.pose.scale import reduced_size
from tracker.segmentation import mosaic
from tracker.segmentation.color_model import ColorModel
from tracker.segmentation.labels import look_up
from tracker.segmentation.light import AS_IT_IS, Light, evened, find_light, grey_world_gains
from tracker.segmentation.noise import LOUD, calmed, noise_level


class View(NamedTuple):
    """What one camera's picture says, at two resolutions."""

    image: Image
    """(H, W, 3) BGR as the camera gave it."""
    labels: Image
    """(h, w) labels of the reduced picture."""
    channels: Array
    """(3, 256) int32: offsets into the label table of this picture's levels."""
    tilt: FloatArray
    """(2, 2) slope of the light's colour over the picture (`segmentation.light.Light`)."""
    mosaic: int = mosaic.NONE
    """Which pixels measured red, if each measured one colour only (`segmentation.mosaic.find`)."""


class Seen(NamedTuple):
    """A picture whose light is known."""

    image: Image
    """(H, W, 3) BGR as the camera gave it."""
    small: Image
    """(h, w, 3), reduced for labels, in even light."""
    tilt: FloatArray
    """(2, 2) as of View."""
    gains: FloatArray
    """(3,) that make its greys grey."""
    mosaic: int
    """Which pixels measured red, see `mosaic.find`."""


class Lighting(NamedTuple):
    """How the colours of a camera's pictures are to be read, for some time."""

    light: Light
    loud: bool
    """Whether the noise is such that colours are read from filtered pixels."""
    channels: Array
    """(3, 256) as of View."""


class EvidenceReader:
    """Reads pictures by one colour model; has no memory."""

    def __init__(self, colors: ColorModel) -> None:
        self.colors = colors

    def see(self, image: Image) -> Seen:
        """A picture (H, W, 3) in even light, its light judged by the most frequent chromaticity."""
        small = _reduce(calmed(image))
        if not self.colors.normalise:
            return Seen(image, small, np.zeros((2, 2)), np.ones(3), mosaic.find(image))
        light = find_light(small)
        return Seen(image, evened(small, light), light.tilt, light.gains, mosaic.find(image))

    def read(self, seen: Seen, grey_world: bool) -> View:
        """Labels of a whole picture; `grey_world`: its light is judged anew, by the mean of all pixels."""
        gains = grey_world_gains(seen.small) if grey_world else seen.gains
        channels = self.colors.channel_tables(gains)
        labels = np.empty(seen.small.shape[:2], np.uint8)
        look_up(seen.small, channels, self.colors.label_table, gains, labels)
        return View(seen.image, labels, channels, seen.tilt, seen.mosaic)

    def lighting(self, image: Image) -> Lighting:
        """How a picture (H, W, 3), and those that follow it, are to be read."""
        light = find_light(image) if self.colors.normalise else AS_IT_IS
        return Lighting(light, noise_level(image) >= LOUD, self.colors.channel_tables(light.gains))

    def glance(self, image: Image, lighting: Lighting, window: tuple[int, int, int, int]) -> View:
        """As `see` and `read`, with a light that is known, in a window alone.

        Args:
            image: (H, W, 3).
            lighting: of the picture, or of one a moment ago.
            window: left, top, right, bottom [px of the label map]; elsewhere labels are background.
        """
        light = lighting.light
        height, width = image.shape[:2]
        columns, rows = reduced_size(width, height)
        labels = np.zeros((rows, columns), np.uint8)
        by = width // columns
        whole = (columns * by, rows * by) != (width, height)
        left, top, right, bottom = (0, 0, columns, rows) if whole else window
        if left < right and top < bottom:
            part = image if whole else image[by * top : by * bottom, by * left : by * right]
            part = np.asarray(cv2.medianBlur(part, 3), dtype=np.uint8) if lighting.loud else part
            size = (right - left, bottom - top)
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            part = evened(part, light, (left, top, columns, rows))
            found = np.empty(part.shape[:2], np.uint8)
            look_up(part, lighting.channels, self.colors.label_table, light.gains, found)
            labels[top:bottom, left:right] = found
        return View(image, labels, lighting.channels, light.tilt, mosaic.find(image))


def _reduce(image: Image) -> Image:
    height, width = image.shape[:2]
    size = reduced_size(width, height)
    if size == (width, height):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
