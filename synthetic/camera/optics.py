"""Effects of a camera's own lens: blur that depends on depth and colour, colour fringes, and coma.

A thin lens focused at distance f blurs a point at depth z to a disc whose width is proportional to
|1/z - 1/f| times aperture times focal length; a simple lens focuses each colour at another distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray

_PASS = 0.25
"""Largest variance [px²] of one blur pass of three taps, whose variance is then exact."""


CORNER = 135 * np.sqrt(2.0)
"""Distance of a corner from the centre of an image of 270 × 270 [px]."""

MOST = 0.5
"""Largest colour shift in that corner [px]."""


@dataclass(frozen=True)
class Focus:
    """Focus distance and blur of one camera. Pixels are those of an image 540 px high.

    The sharpest quarter of the edges in recorded mosaics has a blur of 0.32 to 0.63 px in green, where the
    pixel's own square contributes 0.29 px (scripts/measure_cameras.py); blue is blurred more.
    """

    least: float
    """Standard deviation of the blur in focus [px]."""
    slope: float
    """Standard deviation of the blur per defocus [px m]; the defocus is 1/depth minus 1/focus distance."""
    focused: float
    """1 / focus distance of green [1/m]."""
    shifts: tuple[float, float, float]
    """Offsets from it of 1 / focus distance of blue, green and red [1/m]."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Focus:
        """Draw a lens focused by hand somewhere between 0.35 and 0.8 m, at F/1.4 to F/4."""
        return cls(
            least=float(rng.uniform(0.1, 0.3)),
            slope=float(rng.uniform(0.1, 0.4)),
            focused=float(rng.uniform(1.25, 2.85)),
            shifts=(float(rng.uniform(-0.6, 0.6)), 0.0, float(rng.uniform(-0.3, 0.3))),
        )

    def variance(self, nearness: Array, channel: int, height: int) -> Array:
        """Return the blur's variance [px²] at `nearness`, 1/depth [1/m], in an image of `height` [px]."""
        away = np.asarray(nearness, dtype=np.float32) - np.float32(self.focused + self.shifts[channel])
        scale = np.float32(height / 540)
        return scale**2 * (np.float32(self.least**2) + np.float32(self.slope**2) * away**2)

    def blurred(self, light: Array, nearness: Array) -> Array:
        """Blur the light (H, W, 3) on the sensor; `nearness` (H, W) is 1/depth, 0 where nothing is."""
        channels = [
            _blurred(np.ascontiguousarray(light[:, :, c]), self.variance(nearness, c, light.shape[0]))
            for c in range(3)
        ]
        return np.dstack(channels)


@dataclass(frozen=True)
class Fringes:
    """Outward shifts of blue and red in the corner of an image of 270 × 270 [px]; zero in the centre.

    On photos of a board, red edges lie 0.17 to 0.31 px (median 0.24 px) further out than green ones at half
    the height of an image of 540 px, and blue ones 0.05 px (scripts/measure_cameras.py).
    """

    blue: float
    red: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Fringes:
        """Draw a lens like the measured ones, or a worse one."""
        red = 0.17 * np.exp(rng.normal(0.0, 0.5))
        blue = 0.04 + rng.normal(0.0, 0.08)
        return cls(float(np.clip(blue, -MOST, MOST)), float(np.clip(red, -MOST, MOST)))

    @property
    def stretch(self) -> FloatArray:
        """(3,) magnification of blue, green and red about the principal point."""
        result: FloatArray = 1.0 + np.array([self.blue, 0.0, self.red]) / CORNER
        return result


@dataclass(frozen=True)
class Coma:
    """A skewed, comet-shaped point spread function of a lens whose elements are not quite on one axis.

    Its centroid stays at the point, since a calibration already contains the shift. A cheap lens at F/1.4
    to F/2.8 leaves comets of up to 20 µm, three times the pixel width of the platform's cameras.
    """

    length: float
    """Length from the comet's head to the end of its tail [px of an image 540 px high]."""
    direction: float
    """Direction of its tail [rad], from x to y."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Coma:
        """Draw a typical lens."""
        return cls(float(rng.uniform(0.0, 3.0)), float(rng.uniform(0.0, 2 * np.pi)))

    def kernel(self, height: int) -> FloatArray:
        """Return the (9, 9) point spread function for an image of `height` [px]."""
        # Rings of the pupil map to circles, traversed twice; shift and radius grow with the ring's area.
        ring, turn = np.meshgrid((np.arange(12) + 0.5) / 12, 2 * np.pi * np.arange(24) / 24)
        along, across = ring * (2 + np.cos(2 * turn)), ring * np.sin(2 * turn)
        scale, c, s = self.length / 3 * height / 540, np.cos(self.direction), np.sin(self.direction)
        along = along - along.mean()
        x, y = scale * (c * along - s * across), scale * (s * along + c * across)
        cells = np.arange(-4, 5)[:, None]
        result: FloatArray = _between(cells - y.ravel()) @ _between(cells - x.ravel()).T / x.size
        return result

    def applied(self, light: Array) -> Array:
        """Return the light (H, W, 3) after this point spread."""
        # OpenCV correlates, so the kernel is turned round to convolve.
        kernel = np.ascontiguousarray(self.kernel(light.shape[0])[::-1, ::-1], dtype=np.float32)
        return np.asarray(cv2.filter2D(light, -1, kernel, borderType=cv2.BORDER_REPLICATE))


def _between(distance: FloatArray) -> FloatArray:
    """Return cubic interpolation weights (Keys) of pixels at these distances [px]: they add no blur."""
    d = np.abs(distance)
    near, far = (1.5 * d - 2.5) * d * d + 1, ((-0.5 * d + 2.5) * d - 4) * d + 2
    return np.where(d < 1, near, np.where(d < 2, far, 0.0))


def _blurred(channel: Array, variance: Array) -> Array:
    """Blur a channel (H, W) by a different variance [px²] at each pixel.

    The variance of a mix of two blurs is linear in the weights, so a few uniform blurs are enough.
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
