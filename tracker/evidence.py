"""From images to what the pose estimator needs of them: even light, labels, the pattern of a mosaic."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.pose.views import Evidence, reduced_size
from tracker.segmentation import mosaic
from tracker.segmentation.color_model import ColorModel
from tracker.segmentation.denoise import calmed
from tracker.segmentation.labels import look_up
from tracker.segmentation.normalise import Light, evened, find_light, grey_world_gains


class Seen(NamedTuple):
    """An image in even light."""

    image: Image
    """(H, W, 3) BGR."""
    small: Image
    """(h, w, 3), reduced for labels."""
    gains: FloatArray
    """(3,) that make its greys grey."""
    mosaic: int
    """Which pixels measured red, see `mosaic.find`."""


class EvidenceReader:
    """Reads the images of a number of cameras by one colour model."""

    def __init__(self, colors: ColorModel, cameras: int) -> None:
        self.colors = colors
        self._channels: list[tuple[Light | None, Array]] = [(None, np.empty(0))] * cameras

    def see(self, image: Image) -> Seen:
        """An image (H, W, 3) in even light, its light judged by the most frequent chromaticity."""
        small = _reduce(calmed(image))
        if not self.colors.normalise:
            return Seen(image, small, np.ones(3), mosaic.find(image))
        light = find_light(small)
        return Seen(evened(image, light), evened(small, light), light.gains, mosaic.find(image))

    def read(self, seen: Seen, grey_world: bool) -> Evidence:
        """Labels of a whole image; `grey_world`: its light is judged anew, by the mean of all pixels."""
        gains = grey_world_gains(seen.small) if grey_world else seen.gains
        channels = self.colors.channel_tables(gains)
        labels = np.empty(seen.small.shape[:2], np.uint8)
        look_up(seen.small, channels, self.colors.label_table, gains, labels)
        return Evidence(seen.image, labels, channels, seen.mosaic)

    def glance(
        self, c: int, image: Image, light: Light, loud: bool, window: tuple[int, int, int, int]
    ) -> Evidence:
        """As `see` and `read` of camera c's image, with a light that is known, in a window alone.

        Args:
            c: number of the camera.
            image: (H, W, 3).
            light: of the image, or of one a moment ago.
            loud: whether its noise is such that colours are read from filtered pixels.
            window: left, top, right, bottom [px of the label map]; elsewhere labels are background.
        """
        pattern = mosaic.find(image)
        gains = np.ones(3)
        if self.colors.normalise:
            image, gains = evened(image, light), light.gains
        height, width = image.shape[:2]
        columns, rows = reduced_size(width, height)
        labels = np.zeros((rows, columns), np.uint8)
        by = width // columns
        whole = (columns * by, rows * by) != (width, height)
        left, top, right, bottom = (0, 0, columns, rows) if whole else window
        if self._channels[c][0] is not light:
            self._channels[c] = light, self.colors.channel_tables(gains)
        channels = self._channels[c][1]
        if left < right and top < bottom:
            part = image if whole else image[by * top : by * bottom, by * left : by * right]
            part = np.asarray(cv2.medianBlur(part, 3), dtype=np.uint8) if loud else part
            size = (right - left, bottom - top)
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            found = np.empty(part.shape[:2], np.uint8)
            look_up(part, channels, self.colors.label_table, gains, found)
            labels[top:bottom, left:right] = found
        return Evidence(image, labels, channels, pattern)


def _reduce(image: Image) -> Image:
    height, width = image.shape[:2]
    size = reduced_size(width, height)
    if size == (width, height):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
