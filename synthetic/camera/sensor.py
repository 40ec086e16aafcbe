"""The sensor model of the platform's cameras: from light to 8-bit values.

The figures of `Sensor.sample` are measured on recorded images. These are, to the bit, bilinear interpolations
of an RGGB mosaic. The mosaic's noise falls from 10 steps in the dark to 2 in bright parts; a square-root
response with constant and shot noise explains it, no linear one does. Dark channels of pure colours are
0, and green saturates at 249.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray, Image

RESPONSE_GAMMA = 2.0
"""Exponent: value = 255 · light ** (1 / gamma) in the platform's images; their noise gives 1.5 to 1.9."""

BLACK = (0.010, 0.003, 0.006)
"""Typical black level of blue, green and red [light 1]: in dark parts of the platform's images 97, 77 and
92 % of the values are 0 in spite of the noise."""

PATHS = ("plain", "new", "old")


def linear(levels: Array, gamma: float = RESPONSE_GAMMA) -> FloatArray:
    """Return the light that gives the 8-bit `levels` in an image of exposure 1."""
    return (np.asarray(levels, dtype=np.float64) / 255.0) ** gamma


@dataclass(frozen=True, eq=False)
class CameraSettings:
    """Settings and lighting of one camera, constant while it records."""

    gains: FloatArray
    """(3,) factors on blue, green and red light: exposure times white balance."""
    slope: FloatArray
    """(2,) relative change of light from the image's centre to its right and to its lower border."""


@dataclass(frozen=True)
class Sensor:
    """A kind of camera. Light 1 gives the value 255 where exposure and gains are 1."""

    psf_sigma: float = 0.7
    """Standard deviation of the Gaussian blur of lens and focus [px of the light's grid], in addition to the
    pixel's own square."""
    exposure: tuple[float, float] = (1.0, 1.0)
    """Smallest and largest factor on all channels; log-uniform, drawn for each camera."""
    white_balance: float = 0.0
    """w: each channel of each camera gets a gain that is log-uniform in 1 / (1 + w) ... 1 + w."""
    vignetting: float = 0.0
    """Share of light lost in the image's corners; grows with the square of the distance to its centre."""
    ramp: float = 0.0
    """Largest relative change of light at an image's border, along a random direction for each camera."""
    full_well: float = np.inf
    """Electrons at light 1: shot noise has the variance light · raw gain / full_well; infinite: none."""
    read_noise: float = 0.0
    """Standard deviation of the noise without light [1/255 of light 1], before the raw gain multiplies it."""
    raw_gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Gains of blue, green and red that make grey grey; they amplify noise as well."""
    black: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Black level of blue, green and red [light 1], which is subtracted; lower light becomes 0."""
    gamma: float = 1.0
    """value = 255 · (light - black) ** (1 / gamma)."""
    ceiling: tuple[float, float, float] = (255.0, 255.0, 255.0)
    """Values of blue, green and red where the sensor is saturated, at light 1 [steps of 8 bits]."""
    gain: float = 1.0
    """Factor on all light, besides exposure and white balance."""
    noise: tuple[tuple[float, float, float], ...] | None = None
    """For blue, green and red: variance at light 1, power of light by which it grows, and least light for
    which that holds. None: noise by `full_well`, `read_noise` and `raw_gains`."""
    binned: bool = False
    """Whether four recorded pixels make one pixel of the light's grid."""
    path: str = "plain"
    """`plain`: three colours for each pixel. `new`: interpolated from a mosaic (RGGB); halved after a median
    over 3 pixels. `old`: interpolated from a mosaic; when halved, mosaicked and interpolated once more, so
    that colours bleed at edges."""

    def __post_init__(self) -> None:
        if self.path not in PATHS:
            raise ValueError(f"sensor path: found {self.path!r}, expected one of {', '.join(PATHS)}")

    @classmethod
    def clean(cls) -> Sensor:
        """Return a sensor with blur and rounding only: no noise and no difference between cameras."""
        return cls(gamma=RESPONSE_GAMMA)

    @classmethod
    def realistic(cls) -> Sensor:
        """Return a sensor with noise, mosaic and small camera differences, on the images' own grid."""
        return cls(
            exposure=(1.0, 1.56),
            white_balance=0.04,
            vignetting=0.15,
            ramp=0.1,
            full_well=20_000.0,
            read_noise=0.8,
            black=BLACK,
            gamma=RESPONSE_GAMMA,
            path="new",
        )

    @classmethod
    def sample(cls, rng: np.random.Generator, path: str | None = None) -> Sensor:
        """Draw a sensor like those of one of the platform's robots on one day, for light on a 540 px grid.

        Its path is `new` or `old`, drawn by default.
        """
        drawn = ("new", "old")[int(rng.integers(2))]
        blue, green, red = (float(part) for part in np.multiply(BLACK, rng.uniform(0.7, 1.2)))
        middle = np.exp(rng.uniform(0.1, 0.65))
        return cls(
            psf_sigma=rng.uniform(0.55, 0.95),
            exposure=(float(0.9 * middle), float(1.12 * middle)),
            white_balance=rng.uniform(0.02, 0.12),
            vignetting=rng.uniform(0.1, 0.35),
            ramp=rng.uniform(0.0, 0.15),
            full_well=rng.uniform(5_500.0, 9_000.0),
            read_noise=rng.uniform(1.1, 1.6),
            raw_gains=(1.5, 0.85, 1.2),
            black=(blue, green, red),
            gamma=RESPONSE_GAMMA,
            ceiling=(255.0, 249.0, 255.0),
            path=path or drawn,
        )

    def settings(self, rng: np.random.Generator) -> CameraSettings:
        """Draw one camera of this kind. All sensors use the same draws, so that they can be compared."""
        exposure = np.exp(rng.uniform(*np.log(self.exposure)))
        gains = np.exp(rng.uniform(-1.0, 1.0, 3) * np.log1p(self.white_balance))
        angle, slope = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 1.0) * self.ramp
        return CameraSettings(exposure * gains, slope * np.array([np.cos(angle), np.sin(angle)]))

    def expose(
        self,
        light: Array,
        rng: np.random.Generator,
        settings: CameraSettings | None = None,
        *,
        halved: bool = False,
        pattern: Callable[[Array], Array] | None = None,
        finish: Callable[[Image], Image] | None = None,
    ) -> Image:
        """Return the image (H, W, 3) uint8 BGR that one camera takes of `light` (H, W, 3).

        Args:
            light: linear light, the mean over each pixel.
            rng: draws the noise, and the settings where none are given.
            settings: settings of the camera.
            halved: return the image at half the resolution, by the sensor's path; H and W must be even.
            pattern: applied to the light on the pixels, before noise is added.
            finish: the camera's own processing of its image, before it is halved.
        """
        settings = settings or self.settings(rng)
        light = np.asarray(light, dtype=np.float32)
        if self.psf_sigma > 0:
            light = cv2.GaussianBlur(light, (0, 0), self.psf_sigma, borderType=cv2.BORDER_REPLICATE)
        if pattern is not None:
            light = pattern(light)
        height, width = light.shape[:2]
        falloff = self._falloff((height, width), settings.slope)
        if self.path == "plain":
            picture = self._digits(
                light * falloff[:, :, None], np.asarray(settings.gains, dtype=np.float32), slice(None), rng
            )
        else:
            picture = demosaicked(self._raw(light, falloff, settings, rng))
        if finish is not None:
            picture = finish(picture)
        if not halved:
            return picture
        if self.path == "new":
            picture = np.asarray(cv2.medianBlur(picture, 3), dtype=np.uint8)
        half = cv2.resize(picture, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        small: Image = np.asarray(half, dtype=np.uint8)
        return demosaicked(mosaicked(small)) if self.path == "old" else small

    def _raw(self, light: Array, falloff: Array, settings: CameraSettings, rng: np.random.Generator) -> Array:
        raw = np.empty(falloff.shape, np.uint8)
        for row, column, channel in ((0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 0)):
            site = (slice(row, None, 2), slice(column, None, 2))
            gain = float(settings.gains[channel])
            raw[site] = self._digits(light[(*site, channel)] * falloff[site], gain, channel, rng)
        return raw

    def _digits(
        self, light: Array, gain: Array | float, channel: int | slice, rng: np.random.Generator
    ) -> Array:
        """Return the values of `light`; `channel` is that of its last axis, or of all of it."""
        light = light * (gain * self.gain)
        raw_gain = np.asarray(self.raw_gains, dtype=np.float32)[channel]
        if self.noise is not None or self.read_noise > 0 or np.isfinite(self.full_well):
            if self.noise is None:
                constant = (raw_gain * self.read_noise / 255.0) ** 2
                variance = constant + np.maximum(light, 0.0) * (raw_gain / np.float32(self.full_well))
            else:
                unit, power, least = np.asarray(self.noise, dtype=np.float32).T[..., channel]
                variance = unit * np.maximum(light, least) ** power
            light = light + rng.standard_normal(light.shape, dtype=np.float32) * np.sqrt(variance)
        black = np.asarray(self.black, dtype=np.float32)[channel]
        light = np.clip((light - black) / (1.0 - black), 0.0, 1.0)
        if self.gamma == 2.0:
            light = np.sqrt(light)  # a tenth of the time of a general power
        elif self.gamma != 1.0:
            light **= 1.0 / self.gamma
        values: Array = np.rint(light * np.asarray(self.ceiling, dtype=np.float32)[channel])
        return values.astype(np.uint8)

    def _falloff(self, shape: tuple[int, int], slope: FloatArray) -> Array:
        # Factor (H, W) of vignetting and ramp; coordinates run from -1 to 1 between the image's borders.
        y, x = (np.linspace(-1.0, 1.0, n, dtype=np.float32) for n in shape)
        vignetting = 1.0 - self.vignetting * (x[None, :] ** 2 + y[:, None] ** 2) / 2.0
        factor: Array = vignetting * (1.0 + slope[0] * x[None, :] + slope[1] * y[:, None])
        return factor.astype(np.float32)


def mosaicked(image: Image) -> Image:
    """Return the one colour (H, W) that each pixel of an RGGB sensor keeps of an image (H, W, 3) BGR."""
    raw = image[:, :, 1].copy()
    raw[0::2, 0::2] = image[0::2, 0::2, 2]
    raw[1::2, 1::2] = image[1::2, 1::2, 0]
    return raw


def demosaicked(raw: Array) -> Image:
    """Interpolate an RGGB mosaic (H, W) to an image (H, W, 3) BGR with OpenCV, as the platform does."""
    # OpenCV names a pattern by the second and third pixel of its second row: "BG" is RGGB.
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR), dtype=np.uint8)
