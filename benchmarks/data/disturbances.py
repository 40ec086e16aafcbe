"""Disturbances of images and calibration that make detection harder."""

import dataclasses
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera

Disturbance = Callable[[Sequence[Image], np.random.Generator], list[Image]]
"""Function from all cameras' images to disturbed ones; each camera has its own random draws."""

SHIFT_STD, TURN_STD = 0.0005, float(np.radians(0.1))
"""Standard deviations of the perturbation of camera_from_world, per axis [m, rad]."""


def light(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Vary white balance by ±20 % per channel and exposure from 0.6 to 1.4, for each camera."""
    return [as_bytes(image * (rng.uniform(0.8, 1.2, 3) * rng.uniform(0.6, 1.4))) for image in images]


def hard_light(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Vary gains from 0.6 to 1.5, exposure from 0.4 to 1.7, gamma from 0.7 to 1.4; add ramps of up to ±35 %.

    Linear ramps in random directions act on all channels together and on each channel separately; their
    product stays within ±35 % of the middle. Exposure is applied before gamma, as in a camera.
    """
    result = []
    for image in images:
        gains = rng.uniform(0.6, 1.5, 3) * rng.uniform(0.4, 1.7)
        share = rng.uniform(0, 1)
        slopes = share * np.tile(_slope(rng), (3, 1)) + (1 - share) * np.stack(
            [_slope(rng) for _ in range(3)]
        )
        ramps = np.stack([_ramp(image.shape[:2], slope) for slope in slopes], axis=-1)
        gamma = rng.uniform(0.7, 1.4)
        result.append(as_bytes(255 * np.clip(image * gains * ramps / 255, 0, 1) ** gamma))
    return result


def poor_images(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Blur by σ 1.5 px, then add noise of σ 16, then compress to JPEG of quality 60."""
    result = []
    for image in images:
        blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.5)
        result.append(_jpeg(as_bytes(blurred + rng.normal(0, 16, image.shape))))
    return result


def slight_blur(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Blur by σ 0.5 px, the least that a lens in focus adds to the area of a pixel."""
    return [as_bytes(cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.5)) for image in images]


def slightly_poor(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Imitate an ordinary camera: blur of σ 0.3 to 0.8 px, gains of ±7 % per channel, noise of σ 3."""
    result = []
    for image in images:
        blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), rng.uniform(0.3, 0.8))
        gains = rng.uniform(0.93, 1.07, 3)
        result.append(as_bytes(blurred * gains + rng.normal(0, 3, image.shape)))
    return result


def jpeg(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Compress to JPEG of quality 60, with chroma at half the resolution, and nothing else."""
    return [_jpeg(image) for image in images]


def flooded(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Dazzle one camera: three times the light, and a veil of 80 levels."""
    return _in_one(images, rng, lambda image: as_bytes(3.0 * image.astype(np.float32) + 80.0))


def black(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Make one camera's image black."""
    return _in_one(images, rng, np.zeros_like)


def swapped(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Swap the images of two cameras."""
    result = list(images)
    one, other = rng.choice(len(result), 2, replace=False)
    result[one], result[other] = result[other], result[one]
    return result


def _in_one(
    images: Sequence[Image], rng: np.random.Generator, change: Callable[[Image], Image]
) -> list[Image]:
    chosen = int(rng.integers(len(images)))
    return [change(image) if k == chosen else image for k, image in enumerate(images)]


def moved_rig(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """Return the rig with each camera perturbed by normal draws; it states their standard deviations.

    The transform [R | t] becomes [exp(ω) R | t + δ], with three independent draws for each of ω and δ.
    """
    return dataclasses.replace(rig, cameras=tuple(_moved(camera, rng) for camera in rig))


def _moved(camera: Camera, rng: np.random.Generator) -> Camera:
    moved = shifted(camera, rng.normal(0, TURN_STD, 3), rng.normal(0, SHIFT_STD, 3))
    # ω_k changes element (i, j) of exp(ω) R by element (i, j) of [e_k]× R.
    parts = so3.hat(np.eye(3)) @ moved.camera_from_world[:3, :3]
    std = np.zeros((4, 4))
    std[:3, :3] = TURN_STD * np.sqrt((parts**2).sum(axis=0))
    std[:3, 3] = SHIFT_STD
    return dataclasses.replace(moved, camera_from_world_std=std)


def shifted(camera: Camera, turn: FloatArray, shift: FloatArray) -> Camera:
    """Return the camera with camera_from_world [exp(turn) R | t + shift]."""
    transform = camera.camera_from_world.copy()
    transform[:3, :3] = so3.exp(turn) @ transform[:3, :3]
    transform[:3, 3] += shift
    return dataclasses.replace(camera, camera_from_world=transform)


def _slope(rng: np.random.Generator) -> FloatArray:
    angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.35)
    return size * np.array([np.cos(angle), np.sin(angle)])


def _ramp(shape: tuple[int, ...], slope: FloatArray) -> FloatArray:
    """Return factors (H, W), 1 in the middle and 1 ± |slope| at the farthest points along the slope."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    reach = max(float(np.abs(slope).sum()), 1e-12) / max(float(np.linalg.norm(slope)), 1e-12)
    result: FloatArray = 1 + (slope[0] * x[None, :] + slope[1] * y[:, None]) / reach
    return result


def as_bytes(values: Array) -> Image:
    """Return levels rounded and clipped to bytes."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _jpeg(image: Image) -> Image:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 60])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
