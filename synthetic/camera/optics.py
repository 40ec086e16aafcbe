"""What a camera's own lens does to light: blur by depth and colour, fringes, and a skewed point spread.

A thin lens blurs what is 1/z away, and focused on what is 1/f away, by a disc whose width grows with
|1/z - 1/f| times aperture times focal length; a simple lens does not focus all colours at one distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray

_PASS = 0.25
"""Greatest variance [px²] of one pass: of three samples, whose variance is exactly what it is meant to be."""


CORNER = 135 * np.sqrt(2.0)
"""Distance of a corner from the centre of a picture of 270 × 270 [px]."""

MOST = 0.5
"""Greatest shift in that corner [px]."""


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
        return scale**2 * (np.float32(self.least**2) + np.float32(self.slope**2) * away**2)

    def blurred(self, light: Array, nearness: Array) -> Array:
        """Light (H, W, 3) as it falls on the sensor; `nearness` (H, W) is 1/depth, 0 where nothing is."""
        channels = [
            _blurred(np.ascontiguousarray(light[:, :, c]), self.variance(nearness, c, light.shape[0]))
            for c in range(3)
        ]
        return np.dstack(channels)


@dataclass(frozen=True)
class Fringes:
    """By how much colours are off in the corner of a picture of 270 × 270 [px], outwards; none in the centre.

    On photos of a board red edges lie 0.17 to 0.31 px, in the median 0.24 px, further out than green ones at
    half the height of a picture of 540 px, and blue ones 0.05 px (scripts/measure_cameras.py).
    """

    blue: float
    red: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Fringes:
        """A lens like the measured ones, or a worse one."""
        red = 0.17 * np.exp(rng.normal(0.0, 0.5))
        blue = 0.04 + rng.normal(0.0, 0.08)
        return cls(float(np.clip(blue, -MOST, MOST)), float(np.clip(red, -MOST, MOST)))

    @property
    def stretch(self) -> FloatArray:
        """(3,) how much larger blue, green and red are drawn, about the principal point."""
        result: FloatArray = 1.0 + np.array([self.blue, 0.0, self.red]) / CORNER
        return result


@dataclass(frozen=True)
class Coma:
    """A skewed point spread: the comet of a lens whose parts are not quite on one axis.

    Its middle stays where the point is: a calibration already contains the shift. A cheap lens at F/1.4
    to F/2.8 leaves comets of up to 20 µm, three times the width of a pixel of the platform's cameras.
    """

    length: float
    """From the comet's head to the end of its tail [px of a picture 540 px high]."""
    direction: float
    """Of its tail [rad], from x to y."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Coma:
        """A lens as they come."""
        return cls(float(rng.uniform(0.0, 3.0)), float(rng.uniform(0.0, 2 * np.pi)))

    def kernel(self, height: int) -> FloatArray:
        """(9, 9) of a picture of `height` [px]: light that goes to each neighbour."""
        # Rings of the pupil draw circles, each twice around, that move out and grow with the ring's area.
        ring, turn = np.meshgrid((np.arange(12) + 0.5) / 12, 2 * np.pi * np.arange(24) / 24)
        along, across = ring * (2 + np.cos(2 * turn)), ring * np.sin(2 * turn)
        scale, c, s = self.length / 3 * height / 540, np.cos(self.direction), np.sin(self.direction)
        along = along - along.mean()
        x, y = scale * (c * along - s * across), scale * (s * along + c * across)
        cells = np.arange(-4, 5)[:, None]
        result: FloatArray = _between(cells - y.ravel()) @ _between(cells - x.ravel()).T / x.size
        return result

    def applied(self, light: Array) -> Array:
        """Light (H, W, 3) with this spread."""
        # OpenCV correlates: the kernel turned round convolves.
        kernel = np.ascontiguousarray(self.kernel(light.shape[0])[::-1, ::-1], dtype=np.float32)
        return np.asarray(cv2.filter2D(light, -1, kernel, borderType=cv2.BORDER_REPLICATE))


def _between(distance: FloatArray) -> FloatArray:
    """Weights of a pixel at these distances [px] from a point between pixels (Keys): no blur of their own."""
    d = np.abs(distance)
    near, far = (1.5 * d - 2.5) * d * d + 1, ((-0.5 * d + 2.5) * d - 4) * d + 2
    return np.where(d < 1, near, np.where(d < 2, far, 0.0))


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
