"""What looks at a ray-cast scene: three cameras like the platform's, and what their sensors make of light."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tracker.conventions import Array, Image
from tracker.geometry.camera import Camera

_DISTORTIONS = (
    (-0.236, 0.112, -0.0012, 0.0003, -0.041),
    (-0.233, 0.106, -0.0021, 0.0001, -0.034),
    (-0.239, 0.121, -0.0008, -0.0002, -0.052),
)
_FOCALS_PX = ((294.2, 295.9), (293.1, 294.6), (295.0, 296.3))
_PRINCIPAL_POINTS_PX = ((138.4, 136.1), (132.7, 139.8), (140.2, 133.5))
_AZIMUTHS_DEG = (60, 180, 300)
_POSITIONS_M = ((0.345, 0.392), (0.328, 0.408), (0.339, 0.398))
_TARGETS_M = ((0.004, -0.006, 0.012), (-0.005, 0.002, 0.004), (0.002, 0.007, 0.008))


def default_cameras(width: int = 270) -> tuple[Camera, ...]:
    """Three cameras, 60, 180 and 300 degrees around the arena, with square images of `width` pixels.

    They differ a little from each other, as on a real platform, and their standard deviations are zero:
    images rendered through them obey them exactly.
    """
    return tuple(_camera(index).resized(width, width) for index in range(len(_AZIMUTHS_DEG)))


def _camera(index: int) -> Camera:
    azimuth = np.radians(_AZIMUTHS_DEG[index])
    radius, height = _POSITIONS_M[index]
    position = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    forward = np.asarray(_TARGETS_M[index]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ position

    (fx, fy), (cx, cy) = _FOCALS_PX[index], _PRINCIPAL_POINTS_PX[index]
    return Camera(
        name=f"camera{_AZIMUTHS_DEG[index]}",
        width=270,
        height=270,
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.array(_DISTORTIONS[index]),
        camera_from_world=camera_from_world,
        camera_from_world_std=np.zeros((4, 4)),
    )


@dataclass(frozen=True)
class Sensor:
    """From radiance to bytes. Radiance 1 becomes 255 where exposure and gains are 1."""

    psf_sigma: float = 0.7
    """Standard deviation [px] of the Gaussian blur of lens and focus, on top of the pixel's own square."""

    exposure: tuple[float, float] = (1.0, 1.0)
    """Least and largest factor on all channels of a camera; log-uniform, drawn per camera and picture."""

    white_balance: float = 0.0
    """Each channel of each camera gets a gain that is log-uniform in 1 / (1 + w) ... 1 + w."""

    vignetting: float = 0.0
    """Share of light lost in the image's corners; grows with the square of the distance to its centre."""

    ramp: float = 0.0
    """Largest gain or loss of light at an image's border, along a random direction, per camera."""

    gamma: float = 1.0
    """value = light ** (1 / gamma); 1 is the linear response of a machine vision camera."""

    full_well: float = np.inf
    """Electrons [1] at value 255: shot noise has the variance 255 · value / full_well; infinite: none."""

    read_noise: float = 0.0
    """Standard deviation [steps of 8 bits] of the noise that does not depend on light."""

    bayer: bool = False
    """One colour per pixel (RGGB), interpolated by OpenCV afterwards, as raw pictures are."""

    @classmethod
    def clean(cls) -> Sensor:
        """Blur and rounding only: no noise and no difference between cameras."""
        return cls()

    @classmethod
    def realistic(cls) -> Sensor:
        """Like the platform's cameras: a little noise, mosaic, small differences of colour and brightness."""
        return cls(
            exposure=(0.8, 1.25),
            white_balance=0.04,
            vignetting=0.15,
            ramp=0.1,
            full_well=20_000.0,
            read_noise=0.8,
            bayer=True,
        )

    def expose(self, radiance: Array, rng: np.random.Generator) -> Image:
        """The picture (H, W, 3) uint8 that one camera takes of `radiance` (H, W, 3), BGR."""
        # Every draw happens whatever the options, so that two sensors see the same scene and noise pattern.
        exposure = np.exp(rng.uniform(*np.log(self.exposure)))
        gains = np.exp(rng.uniform(-1.0, 1.0, 3) * np.log1p(self.white_balance))
        angle, slope = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 1.0) * self.ramp
        noise = rng.standard_normal(radiance.shape, dtype=np.float32)

        light = radiance.astype(np.float32) * (exposure * gains).astype(np.float32)
        light *= self._falloff(radiance.shape[:2], angle, slope)[:, :, None]
        if self.psf_sigma > 0:
            light = cv2.GaussianBlur(light, (0, 0), self.psf_sigma, borderType=cv2.BORDER_REPLICATE)
        value = 255.0 * light
        value += noise * np.sqrt(self.read_noise**2 + np.maximum(value, 0.0) * (255.0 / self.full_well))
        if self.gamma != 1.0:
            value = 255.0 * (np.maximum(value, 0.0) / 255.0) ** (1.0 / self.gamma)
        image = np.clip(np.rint(value), 0, 255).astype(np.uint8)
        return _mosaic_and_back(image) if self.bayer else image

    def _falloff(self, shape: tuple[int, int], angle: float, slope: float) -> Array:
        # Factor (H, W) of vignetting and ramp; coordinates run from -1 to 1 between the image's borders.
        y, x = (np.linspace(-1.0, 1.0, n, dtype=np.float32) for n in shape)
        vignetting = 1.0 - self.vignetting * (x[None, :] ** 2 + y[:, None] ** 2) / 2.0
        ramp = 1.0 + slope * (np.cos(angle) * x[None, :] + np.sin(angle) * y[:, None])
        factor: Array = vignetting * ramp
        return factor.astype(np.float32)


def _mosaic_and_back(image: Image) -> Image:
    raw = image[:, :, 1].copy()
    raw[0::2, 0::2] = image[0::2, 0::2, 2]
    raw[1::2, 1::2] = image[1::2, 1::2, 0]
    # OpenCV names a pattern by its second row's second and third pixel: "BG" is RGGB.
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR), dtype=np.uint8)
