"""What is watched of each camera over time: whether its image is new, its light, its noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.conventions import Array, Image
from tracker.segmentation.denoise import LOUD, noise_level
from tracker.segmentation.normalise import Light, find_light

EVERY = 5
"""Images of a camera after which its light and noise are looked at again; cameras take turns."""

ROWS = 12
"""Rows of pixels that tell whether an image has changed."""

NOISELESS = 0.5
"""Standard deviation of an image's noise [levels] up to which it may stay the same."""

BLACK = 12
"""Level that some pixel of an image must exceed [levels]."""


class Watch:
    """The memory of a rig's cameras."""

    def __init__(self, cameras: int) -> None:
        self._samples: list[Array | None] = [None] * cameras
        self._lights: list[tuple[Light, bool] | None] = [None] * cameras
        self._ages = [EVERY * c // max(cameras, 1) for c in range(cameras)]

    def usable(self, images: Sequence[Image | None]) -> list[Image | None]:
        """The images but those that are black, or frozen: the same as before down to their noise."""
        return [None if image is None else self._usable(c, image) for c, image in enumerate(images)]

    def _usable(self, c: int, image: Image) -> Image | None:
        step = max(image.shape[0] // ROWS, 1)
        sample = image[step // 2 :: step].copy()
        before, self._samples[c] = self._samples[c], sample
        if sample.max() < BLACK:
            return None
        # Pictures of a simulation have no noise: those of a scene at rest are the same.
        unchanged = before is not None and np.array_equal(before, sample)
        return None if unchanged and noise_level(image) > NOISELESS else image

    def light(self, c: int, image: Image) -> tuple[Light, bool]:
        """Light of camera c's image, and whether it is loud: as looked at not more than EVERY images ago."""
        known = self._lights[c]
        self._ages[c] += 1
        if known is None or self._ages[c] >= EVERY:
            known = find_light(image), noise_level(image) >= LOUD
            self._lights[c], self._ages[c] = known, 0
        return known
