"""An unsharp mask, as cameras and drivers apply it to their pictures before they give them out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tracker.conventions import Image


@dataclass(frozen=True)
class Sharpening:
    """A mask of one camera: value + amount · (value - value blurred by sigma).

    The platform's recorded mosaics show none: beside the step of sharp edges they are 0.05 of the step
    brighter and darker than a blurred step is, half of which the objects' rims explain
    (scripts/measure_cameras.py). Cameras that interpolate their own mosaic sharpen.
    """

    amount: float
    """0: none."""
    sigma: float
    """Of the blurred picture that is taken off [px of a picture 540 px high]."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Sharpening:
        """Of three cameras two do it."""
        amount, sigma = rng.uniform(-0.3, 0.6), rng.uniform(0.6, 1.4)
        return cls(float(max(amount, 0.0)), float(sigma))

    def applied(self, picture: Image) -> Image:
        """A picture (H, W, 3) uint8 sharpened."""
        if self.amount == 0:
            return picture
        sigma = max(0.4, self.sigma * picture.shape[0] / 540)
        values = picture.astype(np.float32)
        soft = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return np.clip(np.rint(values + self.amount * (values - soft)), 0, 255).astype(np.uint8)
