"""How one camera turns light into values: response and noise, fixed pattern, drift, sharpening.

`scripts/measure_cameras.py` measures recorded pictures: noise against brightness is that of exponents from
1.4 to 2.4, in the median 1.9 in blue and red and 1.5 in green; on photos of a board 18 to 35 %, in the
median 27 %, of the light is lost at half the height from the centre, as cos⁴ of the angle says.
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
"""At which the noise is known."""

LEAST = 20.0
"""Level below which the noise of light grows no more."""

NOISE = ((6.9, 2.7), (4.3, 2.4), (5.9, 2.05))
"""Standard deviation of blue, green and red noise at these levels [steps of 8 bits], medians of mosaics."""

OLD_NOISE = 0.85, 0.5
"""Share of it at these levels in the recordings that were mosaicked twice."""

MIDDLE = 0.2
"""Light whose value stays whatever the exponent: exposure is set by the picture."""


@dataclass(frozen=True)
class Response:
    """What one camera does to light."""

    exponent: float
    """value = 255 · (light - black) ** (1 / exponent)."""
    black: float
    """Of the typical black level."""
    vignetting: float
    """Share of light lost in the image's corners."""
    noise: float
    """Of the typical noise."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Response:
        """A camera like the measured ones."""
        return cls(
            exponent=float(rng.uniform(1.5, 2.0)),
            black=float(rng.uniform(0.5, 1.7)),
            vignetting=float(rng.uniform(0.38, 0.64)),
            noise=float(np.exp(rng.uniform(-0.15, 0.15))),
        )

    @property
    def gain(self) -> float:
        """Factor on light that keeps the value of MIDDLE."""
        return float(MIDDLE ** (self.exponent / RESPONSE_GAMMA - 1.0))

    def of(self, sensor: Sensor) -> Sensor:
        """The sensor with this response; as bright as before in the mean over the picture."""
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
    """Variance at light 1, power of light, and least light to which that holds, by the noise at LEVELS.

    With the exponents of the range no constant and shot noise alone would give what is measured of red.
    """
    light = linear(np.array(LEVELS), exponent)
    # dv/dlight = 255 / exponent · light ** (1 / exponent - 1).
    variance = (noise * exponent / 255 * light ** (1 - 1 / exponent)) ** 2
    power = float(np.log(variance[1] / variance[0]) / np.log(light[1] / light[0]))
    return float(variance[0] / light[0] ** power), power, float(linear(np.array(LEAST), exponent))


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


@dataclass(frozen=True)
class FixedPattern:
    """What differs from pixel to pixel and stays: gains and offsets, a part of both common to a column.

    Data sheets by EMVA 1288 give sensors of cheap industrial cameras a photo response non-uniformity of 0.4
    to 1.5 %, and offsets of 2 to 10 electrons of 20,000.
    """

    gain: float
    """Relative standard deviation of the gain."""
    offset: float
    """Standard deviation of the offset [light 1]."""
    seed: int
    """Of the pattern itself."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> FixedPattern:
        """A sensor."""
        return cls(float(rng.uniform(0.004, 0.015)), float(rng.uniform(1e-4, 5e-4)), int(rng.integers(2**62)))

    def applied(self, light: Array, *, binned: bool = False) -> Array:
        """Light (H, W, 3) as pixels see it; where four `binned` ones make one they differ half as much."""
        gains, offsets = _patterns(self.seed, light.shape[0], light.shape[1])
        share = 0.5 if binned else 1.0
        result: Array = light * (1 + np.float32(share * self.gain) * gains)
        result += np.float32(share * self.offset) * offsets
        return result


@lru_cache(maxsize=4)
def _patterns(seed: int, height: int, width: int) -> Array:
    """(2, H, W, 1) float32 of standard deviation 1, a fifth of whose variance is by column."""
    rng = np.random.default_rng(seed)
    own = rng.standard_normal((2, height, width, 1), dtype=np.float32)
    columns = rng.standard_normal((2, 1, width, 1), dtype=np.float32)
    return np.float32(np.sqrt(0.8)) * own + np.float32(np.sqrt(0.2)) * columns


@dataclass(frozen=True)
class Drift:
    """Exposure that changes slowly: lamps warm up, clouds pass, a cheap camera's control follows the arms.

    Up to 15 % up and down within 4 to 40 s; single scenes show one moment of it, a constant factor.
    """

    amplitude: float
    """Of the logarithm of the exposure."""
    period: float
    """[s]"""
    phase: float
    """[1], 0 to 1."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Drift:
        """A camera on a day."""
        period = np.exp(rng.uniform(np.log(4.0), np.log(40.0)))
        return cls(float(rng.uniform(0.02, 0.15)), float(period), float(rng.random()))

    def at(self, time: float) -> float:
        """Factor on the exposure at a time [s]."""
        return float(np.exp(self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))))
