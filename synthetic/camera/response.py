"""How one camera turns light into values: exponent, black level, vignetting, and noise to match.

Measured on recorded pictures by `scripts/measure_cameras.py`: noise against brightness is that of exponents
from 1.4 to 2.4, in the median 1.9 in blue and red and 1.5 in green; on photos of a board 18 to 35 %, in the
median 27 %, of the light is lost at half the height from the centre, as cos⁴ of the angle says.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from synthetic.camera.sensor import BLACK, RESPONSE_GAMMA, Sensor, linear
from tracker.conventions import FloatArray

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
