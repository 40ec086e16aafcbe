"""How sharp a camera is, which differs from camera to camera, with depth and with colour.

A thin lens blurs what is 1/z away, and focused on what is 1/f away, by a disc whose width grows with
|1/z - 1/f| times aperture times focal length; a simple lens does not focus all colours at one distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tracker.conventions import Array

_PASS = 0.25
"""Greatest variance [px²] of one pass: of three samples, whose variance is exactly what it is meant to be."""


@dataclass(frozen=True)
class Focus:
    """Where one camera is sharp, and how sharp. Pixels are those of a picture 540 px high.

    The sharpest quarter of the edges of recorded mosaics is blurred by 0.32 to 0.63 px in green, a pixel's
    own square alone by 0.29 px (scripts/measure_cameras.py); blue is blurred more.
    """

    least: float
    """Standard deviation of the blur of what is in focus [px]."""
    slope: float
    """Standard deviation of the blur [px m], for each 1/m between 1/depth and where the lens is focused."""
    focused: float
    """1 / distance at which green is in focus [1/m]."""
    shifts: tuple[float, float, float]
    """By how much blue, green and red are focused at other distances [1/m]."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Focus:
        """A camera whose lens was focused by hand somewhere between 0.35 and 0.8 m, at F/1.4 to F/4."""
        return cls(
            least=float(rng.uniform(0.1, 0.3)),
            slope=float(rng.uniform(0.1, 0.4)),
            focused=float(rng.uniform(1.25, 2.85)),
            shifts=(float(rng.uniform(-0.6, 0.6)), 0.0, float(rng.uniform(-0.3, 0.3))),
        )

    def variance(self, nearness: Array, channel: int, height: int) -> Array:
        """Of the blur [px²] at 1/depth `nearness` [1/m], in a picture of `height` [px]."""
        away = np.asarray(nearness, dtype=np.float32) - np.float32(self.focused + self.shifts[channel])
        scale = np.float32(height / 540)
        result: Array = scale**2 * (np.float32(self.least**2) + np.float32(self.slope**2) * away**2)
        return result

    def blurred(self, light: Array, nearness: Array) -> Array:
        """Light (H, W, 3) as it falls on the sensor; `nearness` (H, W) is 1/depth, 0 where nothing is."""
        channels = [
            _blurred(np.ascontiguousarray(light[:, :, c]), self.variance(nearness, c, light.shape[0]))
            for c in range(3)
        ]
        return np.dstack(channels)


def _blurred(channel: Array, variance: Array) -> Array:
    """A channel (H, W) blurred by a variance [px²] of each pixel's own.

    Between two blurs the variance is linear in their shares, so few of them serve for all.
    """
    low, high = float(variance.min()), float(variance.max())
    current = _spread(channel, low)
    result = current.copy()
    while high - low > 1e-6:
        step = min(_PASS, high - low)
        following = _spread(current, step)
        result += np.clip((variance - low) / step, 0, 1).astype(np.float32) * (following - current)
        current, low = following, low + step
    return result


def _spread(channel: Array, variance: float) -> Array:
    count = max(1, int(np.ceil(variance / _PASS)))
    side = 0.5 * variance / count
    taps = np.array([side, 1 - 2 * side, side], dtype=np.float32)
    for _ in range(count):
        channel = np.asarray(cv2.sepFilter2D(channel, -1, taps, taps, borderType=cv2.BORDER_REPLICATE))
    return channel
