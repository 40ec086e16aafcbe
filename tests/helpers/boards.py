"""Photos of boards with exact truth, by OpenCV's camera model and none of the tracker's."""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from tests.helpers import exposed, opencv_pixels
from tests.helpers.log_writers import write_picture
from tracker import Camera, CameraRig
from tracker.calibration.board.board import Board, Page, page_image
from tracker.calibration.board.sighting import BoardView
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3

BOARD = Board(5, 7, 0.04, 0.03)
OFTEN = 3
"""Rays across a pixel."""

_DOTS = 254.0
_MARGIN = 10.0

LENS = Camera(
    name="lens",
    width=360,
    height=270,
    matrix=np.array([[294.8, 0, 181.3], [0, 295.6, 137.1], [0, 0, 1]]),
    distortion=np.array([-0.24, 0.12, 0.0008, -0.0005, -0.03]),
    camera_from_world=np.eye(4),
)


def pose_towards(rng: np.random.Generator, tilt: float = 0.7) -> FloatArray:
    """(4, 4) camera_from_board of a board that faces the camera, turned and tilted [rad] at random."""
    turned = cv2.Rodrigues(np.array([0, 0, rng.uniform(-np.pi, np.pi)]))[0]
    axis = rng.uniform(0, 2 * np.pi)
    lean = cv2.Rodrigues(rng.uniform(0.3, 1) * tilt * np.array([np.cos(axis), np.sin(axis), 0]))[0]
    facing = lean @ np.diag([1.0, -1.0, -1.0]) @ turned  # its z points at the camera
    return so3.transform(facing, (*rng.uniform(-0.08, 0.08, 2), 0.5 * rng.uniform(0.85, 1.2)))


def sighting(
    name: str, pose: FloatArray, rng: np.random.Generator, *, noise: float = 0.1, lens: Camera = LENS
) -> BoardView:
    """The corners inside of the image, each off by noise [px] along both axes."""
    pixels = opencv_pixels(lens, BOARD.corners, pose)
    inside = ((pixels > 3) & (pixels < np.array([lens.width, lens.height]) - 4)).all(axis=1)
    numbers = np.flatnonzero(inside)
    seen = pixels[inside] + rng.normal(0, noise, (len(numbers), 2))
    return BoardView(name, (lens.width, lens.height), numbers, seen, BOARD.corners[numbers], 0.6)


def photo(pose: FloatArray, rng: np.random.Generator, *, board: Board = BOARD, blur: float = 0.4) -> Image:
    """(H, W, 3) the board before a grey wall through LENS, blurred [px] and noisy."""
    board_from_camera = np.linalg.inv(pose)
    rays = _rays() @ board_from_camera[:3, :3].T
    start = board_from_camera[:3, 3]
    on_plane = start[:2] - rays[..., :2] * (start[2] / rays[..., 2:])
    page, printed = _print(board)
    width, height = board.size
    at = (on_plane * (1000, -1000) + (500 * width, 500 * height) + page.origin) * (_DOTS / 25.4) - 0.5
    grey = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": 110}
    fine = cv2.remap(printed, at.astype(np.float32), None, cv2.INTER_NEAREST, **grey)
    fine = np.where(rays[..., 2] * start[2] < 0, fine, 110)
    image = fine.reshape(LENS.height, OFTEN, LENS.width, OFTEN).mean(axis=(1, 3)) * 0.75 + 20
    image = cv2.GaussianBlur(image, (0, 0), blur) + rng.normal(0, 1.5, image.shape)
    return np.repeat(exposed(image)[:, :, None], 3, axis=2)


def write_photos(
    root: Path, cameras: Mapping[str, FloatArray], places: Mapping[str, FloatArray], rng: np.random.Generator
) -> None:
    """The lenses of cameras (name: camera_from_world), and their photos of each place of the board."""
    CameraRig(tuple(dataclasses.replace(LENS, name=name) for name in cameras)).save(root / "lenses")
    for folder, place in places.items():
        for name, true in cameras.items():
            write_picture(root / folder / f"{name}.png", photo(true @ place, rng))


@functools.cache
def _rays() -> FloatArray:
    """(H · OFTEN, W · OFTEN, 3) rays through parts of pixels, z = 1; between pixels they are linear."""
    rows, columns = np.mgrid[: LENS.height, : LENS.width]
    target = np.stack([columns, rows], axis=-1).reshape(-1, 2) - LENS.matrix[:2, 2]
    target, distortion = target / LENS.matrix[(0, 1), (0, 1)], np.array(LENS.distortion)
    flat = target.copy()
    for _ in range(8):  # a fixed point, whatever the version's own inverse does
        ahead = np.insert(flat, 2, 1.0, axis=1)
        bent, _ = cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), np.eye(3), distortion)
        flat += target - bent[:, 0]
    fine = cv2.resize(flat.reshape(LENS.height, LENS.width, 2), None, fx=OFTEN, fy=OFTEN)
    return np.insert(fine, 2, 1.0, axis=2)


@functools.lru_cache(maxsize=4)
def _print(board: Board) -> tuple[Page, Image]:
    """The board with a white rim, at _DOTS per inch."""
    width, height = board.size
    page = Page(board, 1000 * width + 2 * _MARGIN, 1000 * height + 2 * _MARGIN)
    return page, page_image(page, _DOTS)
