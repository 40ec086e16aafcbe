"""How one camera turns light into pixel values: response and noise, fixed pattern, drift, sharpening.

Measured on recorded images by `scripts/measure_cameras.py`: noise against brightness fits exponents of 1.4 to
2.4 (median 1.9 in blue and red, 1.5 in green); on photos of a board 18 to 35 % (median 27 %) of the light is
lost at half the height from the centre, as the cos⁴ law predicts.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from synthetic.camera.sensor import BLACK, RESPONSE_GAMMA, Sensor, linear
from tracker.conventions import Array, FloatArray, Image

LEVELS = (40.0, 120.0)
"""Pixel values at which the noise is known."""

LEAST = 20.0
"""Pixel value below which the noise is that of this value: its variance grows no more."""

NOISE = ((6.9, 2.7), (4.3, 2.4), (5.9, 2.05))
"""Standard deviation of blue, green and red noise at LEVELS [steps of 8 bits], medians of mosaics."""

OLD_NOISE = 0.85, 0.5
"""Factor on the noise at LEVELS in the recordings that were mosaicked twice."""

MIDDLE = 0.2
"""Light whose value is the same for all exponents, since exposure is chosen by looking at the image."""


@dataclass(frozen=True)
class Response:
    """Tone response, black level, vignetting and noise of one camera."""

    exponent: float
    """value = 255 · (light - black) ** (1 / exponent)."""
    black: float
    """Black level relative to the typical one."""
    vignetting: float
    """Share of light lost in the image's corners."""
    noise: float
    """Noise relative to the typical one."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Response:
        """Draw a camera like the measured ones."""
        return cls(
            exponent=float(rng.uniform(1.5, 2.0)),
            black=float(rng.uniform(0.5, 1.7)),
            vignetting=float(rng.uniform(0.38, 0.64)),
            noise=float(np.exp(rng.uniform(-0.15, 0.15))),
        )

    @property
    def gain(self) -> float:
        """Factor on light that keeps the value at MIDDLE."""
        return float(MIDDLE ** (self.exponent / RESPONSE_GAMMA - 1.0))

    def of(self, sensor: Sensor) -> Sensor:
        """Return the sensor with this response and the same mean brightness over the image."""
        light = (1 - sensor.vignetting / 3) / (1 - self.vignetting / 3) * self.gain
        blue, green, red = (self.gain * self.black * level for level in BLACK)
        share = self.noise * (0.7 if sensor.binned else 1.0)
        shares = share * np.array(OLD_NOISE if sensor.path == "old" else (1.0, 1.0))
        return dataclasses.replace(
            sensor,
            gain=light,
            gamma=self.exponent,
            black=(blue, green, red),
            vignetting=self.vignetting,
            noise=tuple(_power(shares * np.array(noise), self.exponent) for noise in NOISE),
        )


def _power(noise: FloatArray, exponent: float) -> tuple[float, float, float]:
    """Fit the noise at LEVELS: variance at light 1, power of light, least light for which the power holds.

    In this range of exponents, constant plus shot noise alone cannot explain the noise measured in red.
    """
    light = linear(np.array(LEVELS), exponent)
    # dv/dlight = 255 / exponent · light ** (1 / exponent - 1).
    variance = (noise * exponent / 255 * light ** (1 - 1 / exponent)) ** 2
    power = float(np.log(variance[1] / variance[0]) / np.log(light[1] / light[0]))
    return float(variance[0] / light[0] ** power), power, float(linear(np.array(LEAST), exponent))


@dataclass(frozen=True)
class Sharpening:
    """Unsharp mask of one camera: value + amount · (value - value blurred by sigma).

    The platform's recorded mosaics show none: beside sharp edges they overshoot a blurred step by 0.05 of
    the step on both sides, half of which the objects' rims explain (scripts/measure_cameras.py). Cameras that
    interpolate their own mosaic do sharpen.
    """

    amount: float
    """Strength; 0: no sharpening."""
    sigma: float
    """Sigma of the blurred image that is subtracted [px of an image 540 px high]."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Sharpening:
        """Draw a camera; two of three sharpen."""
        amount, sigma = rng.uniform(-0.3, 0.6), rng.uniform(0.6, 1.4)
        return cls(float(max(amount, 0.0)), float(sigma))

    def applied(self, picture: Image) -> Image:
        """Return the image (H, W, 3) uint8 sharpened."""
        if self.amount == 0:
            return picture
        sigma = max(0.4, self.sigma * picture.shape[0] / 540)
        values = picture.astype(np.float32)
        soft = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return np.clip(np.rint(values + self.amount * (values - soft)), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class FixedPattern:
    """Constant differences between pixels: gains and offsets, both partly common to a column.

    EMVA 1288 data sheets give the sensors of cheap industrial cameras a photo response non-uniformity of 0.4
    to 1.5 %, and offsets of 2 to 10 electrons of 20,000.
    """

    gain: float
    """Relative standard deviation of the gain."""
    offset: float
    """Standard deviation of the offset [light 1]."""
    seed: int

    @classmethod
    def sample(cls, rng: np.random.Generator) -> FixedPattern:
        """Draw a sensor."""
        return cls(float(rng.uniform(0.004, 0.015)), float(rng.uniform(1e-4, 5e-4)), int(rng.integers(2**62)))

    def applied(self, light: Array, *, binned: bool = False) -> Array:
        """Return light (H, W, 3) with the pattern; half as strong where `binned`, four pixels making one."""
        gains, offsets = _patterns(self.seed, light.shape[0], light.shape[1])
        share = 0.5 if binned else 1.0
        result: Array = light * (1 + np.float32(share * self.gain) * gains)
        result += np.float32(share * self.offset) * offsets
        return result


@lru_cache(maxsize=4)
def _patterns(seed: int, height: int, width: int) -> Array:
    """Return patterns (2, H, W, 1) float32 of standard deviation 1; a fifth of the variance is by column."""
    rng = np.random.default_rng(seed)
    own = rng.standard_normal((2, height, width, 1), dtype=np.float32)
    columns = rng.standard_normal((2, 1, width, 1), dtype=np.float32)
    return np.float32(np.sqrt(0.8)) * own + np.float32(np.sqrt(0.2)) * columns


@dataclass(frozen=True)
class Drift:
    """Slow changes of exposure: lamps warm up, clouds pass, a cheap camera's control follows the arms.

    Up to 15 % up and down within 4 to 40 s; a single scene shows one moment of it, a constant factor.
    """

    amplitude: float
    """Amplitude of the logarithm of the exposure."""
    period: float
    """[s]"""
    phase: float
    """[1], 0 to 1."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Drift:
        """Draw the drift of one camera on one day."""
        period = np.exp(rng.uniform(np.log(4.0), np.log(40.0)))
        return cls(float(rng.uniform(0.02, 0.15)), float(period), float(rng.random()))

    def at(self, time: float) -> float:
        """Return the factor on the exposure at a time [s]."""
        return float(np.exp(self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))))
