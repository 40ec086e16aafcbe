"""From pictures to what the pose estimator needs of them: labels, colours, the pattern of a mosaic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.pose.scale import reduced
from tracker.segmentation import mosaic
from tracker.segmentation.color_model import ColorModel
from tracker.segmentation.labels import in_even_light, look_up
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
    """Reads pictures by one colour model; has no memory.

    Args:
        colors: the colour model.
        factors: by which each camera's pictures are reduced for label maps.
    """

    def __init__(self, colors: ColorModel, factors: Sequence[int]) -> None:
        self.colors, self.factors = colors, tuple(factors)

    def see(self, c: int, image: Image) -> Seen:
        """Camera c's picture (H, W, 3), its light judged by the most frequent chromaticity."""
        small, light = in_even_light(reduced(calmed(image), self.factors[c]), self.colors)
        return Seen(image, small, light.tilt, light.gains, mosaic.find(image))

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

    def glance(self, c: int, image: Image, lighting: Lighting, window: tuple[int, int, int, int]) -> View:
        """As `see` and `read`, with a light that is known, in a window alone.

        Args:
            c: number of the camera.
            image: (H, W, 3).
            lighting: of the picture, or of one a moment ago.
            window: left, top, right, bottom [px of the label map]; elsewhere labels are background.
        """
        by, light = self.factors[c], lighting.light
        rows, columns = image.shape[0] // by, image.shape[1] // by
        labels = np.zeros((rows, columns), np.uint8)
        left, top, right, bottom = window
        if left < right and top < bottom:
            part = image[by * top : by * bottom, by * left : by * right]
            part = np.asarray(cv2.medianBlur(part, 3), dtype=np.uint8) if lighting.loud else part
            part = evened(reduced(part, by), light, (left, top, columns, rows))
            found = np.empty(part.shape[:2], np.uint8)
            look_up(part, lighting.channels, self.colors.label_table, light.gains, found)
            labels[top:bottom, left:right] = found
        return View(image, labels, lighting.channels, light.tilt, mosaic.find(image))
