"""Dice painted with OpenCV: views and masks of scenes that are known exactly."""

from collections.abc import Sequence

import cv2
import numpy as np

from tests.helpers import exposed, opencv_pixels
from tracker import Camera
from tracker.conventions import FloatArray, Image
from tracker.geometry import cuboid, so3

EDGE = 0.022

_FINE = 4
_SHADES = {4: 1.0, 0: 0.62, 1: 0.52, 2: 0.57, 3: 0.48}
"""Brightness of faces, by their number in FACE_NAMES."""

_BLUE, _PIP = np.array([190.0, 110.0, 10.0]), np.array([205.0, 205.0, 205.0])
_PIPS = {
    1: ((0, 0),),
    2: ((1, 1), (-1, -1)),
    3: ((1, 1), (0, 0), (-1, -1)),
    4: ((1, 1), (1, -1), (-1, 1), (-1, -1)),
}


def dice_at(places: Sequence[tuple[float, ...]], turn: float = 0.0) -> FloatArray:
    """Dice (N, 4) as x, y, height of the foot [m], yaw [rad], from (x, y) or (x, y, foot); yaws k · turn."""
    return np.array([[*place[:2], *(place[2:] or (0.0,)), k * turn] for k, place in enumerate(places)])


def painted(camera: Camera, dice: FloatArray, rng: np.random.Generator | None = None) -> tuple[Image, Image]:
    """The view of dice on a dark table before a light wall, blurred by 0.6 px, and its mask (0, 255)."""
    size = (camera.height * _FINE, camera.width * _FINE)
    fine = camera.resized(size[1], size[0])
    image, mask = np.full((*size, 3), 115.0), np.zeros(size, np.uint8)
    angles = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rim = np.stack([0.192 * np.cos(angles), 0.192 * np.sin(angles), 0 * angles], axis=1)
    cv2.fillPoly(image, [_pixels(fine, rim)], (45, 47, 46))
    order = np.argsort([-np.linalg.norm(die[:3] - camera.position) for die in dice], kind="stable")
    for die in dice[order]:
        _paint(fine, die, image, mask)
    scale = _FINE * camera.width / 270
    image = cv2.GaussianBlur(image, (0, 0), 0.6 * scale)
    image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    if rng is not None:
        image = image + rng.normal(0, 2, image.shape)
    small = cv2.resize(mask, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return exposed(image), np.where(small >= 128, 255, 0).astype(np.uint8)


def _paint(camera: Camera, die: FloatArray, image: FloatArray, mask: Image) -> None:
    center, rotation = die[:3] + np.array([0, 0, EDGE / 2]), so3.exp([0, 0, die[3]])
    size = np.full(3, EDGE)
    corners = cuboid.corners(size)
    seen = cuboid.visible_faces(size, rotation.T @ (camera.position - center))
    for number, face in enumerate(np.flatnonzero(seen)):
        loop = corners[cuboid.FACE_CORNERS[face]]
        outline = _pixels(camera, center + loop @ rotation.T)
        cv2.fillPoly(image, [outline], (_BLUE * _SHADES[int(face)]).tolist())
        cv2.fillPoly(mask, [outline], 255)
        across, along, middle = loop[1] - loop[0], loop[3] - loop[0], loop.mean(axis=0)
        for u, v in _PIPS[number + 2]:
            angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
            round_ = np.outer(np.cos(angles), across / EDGE) + np.outer(np.sin(angles), along / EDGE)
            pip = middle + 0.2 * (u * across + v * along) + 0.0017 * round_
            outline = _pixels(camera, center + pip @ rotation.T)
            cv2.fillPoly(image, [outline], (_PIP * _SHADES[int(face)]).tolist())


def _pixels(camera: Camera, points: FloatArray) -> np.ndarray:
    return np.rint(opencv_pixels(camera, points)).astype(np.int32)
