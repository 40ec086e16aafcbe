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
        """The images but those that are black, or frozen: the same, noise and all, while others change."""
        result, unchanged = list(images), []
        others_change = False
        for c, image in enumerate(images):
            if image is None:
                continue
            step = max(image.shape[0] // ROWS, 1)
            sample = image[step // 2 :: step].copy()
            before, self._samples[c] = self._samples[c], sample
            if sample.max() < BLACK:
                result[c] = None
            elif before is not None and np.array_equal(before, sample):
                unchanged.append(c)
            else:
                others_change = True
        for c in unchanged if others_change else ():
            image = images[c]
            # Pictures of a simulation have no noise: where nothing moves in them they are the same.
            if image is not None and noise_level(image) > NOISELESS:
                result[c] = None
        return result

    def light(self, c: int, image: Image) -> tuple[Light, bool]:
        """Light of camera c's image, and whether it is loud: as looked at not more than EVERY images ago."""
        known = self._lights[c]
        self._ages[c] += 1
        if known is None or self._ages[c] >= EVERY:
            known = find_light(image), noise_level(image) >= LOUD
            self._lights[c], self._ages[c] = known, 0
        return known
