"""What several test files share."""

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from synthetic.camera.rigs import default_cameras, looking
from tracker import Camera, CameraRig, ObjectTracker
from tracker.calibration.deviations import element_std
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3
from tracker.pose.views import Sight

ROOT = Path(__file__).resolve().parents[2]

RIG = CameraRig(default_cameras())
"""Three cameras like the platform's, 270×270, whose calibration is exact."""


def run_python(
    arguments: Sequence[object], folder: Path = ROOT, *, check: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run the interpreter in `folder`, with this repository's packages whether or not they are installed."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=check,
        timeout=300,
    )


def contents(folder: Path) -> dict[str, bytes | None]:
    """All that is in a folder, by its path from there; None of folders."""
    paths = sorted(folder.rglob("*"))
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in paths}


def numerical_jacobian(function: Callable[[FloatArray], Array], at: Array, step: float = 1e-6) -> FloatArray:
    """Central differences of `function` (n,) -> (...) at `at` (n,): derivatives (..., n)."""
    at = np.asarray(at, dtype=np.float64)
    offsets = step * np.eye(len(at))
    columns = [np.subtract(function(at + offset), function(at - offset)) / (2 * step) for offset in offsets]
    return np.stack(columns, axis=-1)


def random_rotations(rng: np.random.Generator, count: int) -> FloatArray:
    """Uniform rotations (count, 3, 3)."""
    return so3.matrix_from_quaternion(rng.normal(size=(count, 4)))


def look_at(position: Array, target: Array = (0.0, 0.0, 0.0)) -> FloatArray:
    """camera_from_world (4, 4) of a camera at `position` (3,) [m] that looks at `target` (3,) [m]."""
    return looking(np.asarray(position), target)


LENSES = {
    5: (-0.2358, 0.1142, -0.00136, -5.2e-05, -0.0506),
    8: (0.31, -0.12, -0.00136, 0.0007, 0.021, 0.55, -0.06, 0.011),
    12: (-0.21, 0.09, 0.0011, -0.0004, -0.03, 0.02, -0.01, 0.004, 0.003, -0.001, -0.002, 0.0015),
    14: (-0.21, 0.09, 0.0011, -0.0004, -0.03, 0.02, -0.01, 0.004, 0.003, -0.001, -0.002, 0.0015, 0.03, -0.05),
}
"""Coefficients of distortion by their number, each of a size that lenses have."""


def make_camera(azimuth_degrees: float = 60.0, name: str | None = None) -> Camera:
    """A camera like those of the platform, 270×270, half a metre from the arena's centre."""
    azimuth = np.deg2rad(azimuth_degrees)
    position = np.array([0.35 * np.cos(azimuth), 0.35 * np.sin(azimuth), 0.37])
    std = np.full((4, 4), 0.002)
    std[:3, 3] = 0.0005
    std[3] = 0
    return Camera(
        name=name or f"camera{azimuth_degrees:.0f}",
        width=270,
        height=270,
        matrix=np.array([[294.4, 0.0, 135.9], [0.0, 296.4, 141.5], [0.0, 0.0, 1.0]]),
        distortion=np.array(LENSES[5]),
        camera_from_world=look_at(position),
        camera_from_world_std=std,
    )


def misplaced(camera: Camera, rng: np.random.Generator, shift: float, turn: float) -> Camera:
    """The camera off by these standard deviations [m, rad] along each of its axes."""
    pose = camera.camera_from_world.copy()
    pose[:3, :3] = so3.exp(turn * rng.normal(size=3)) @ pose[:3, :3]
    pose[:3, 3] += shift * rng.normal(size=3)
    return dataclasses.replace(camera, camera_from_world=pose)


def off_as_stated(
    camera: Camera, rng: np.random.Generator, shift: float, turn: float, times: float = 1.0
) -> Camera:
    """The camera as a file has it that states these deviations, off by so many times as much."""
    given = misplaced(camera, rng, times * shift, times * turn)
    covariance = np.diag(np.repeat(np.square([shift, turn]), 3))
    std = element_std(given.camera_from_world[:3, :3], covariance)
    return dataclasses.replace(given, camera_from_world_std=std)


def nudged(rig: CameraRig, c: int, turn: Array = (0, 0, 0), shift: Array = (0, 0, 0)) -> CameraRig:
    """The rig with camera c shifted [m], then turned about itself [rad], along its own axes."""
    cameras, pose = list(rig), rig[c].camera_from_world.copy()
    pose[:3, 3] += shift
    pose[:3] = so3.exp(turn) @ pose[:3]
    cameras[c] = dataclasses.replace(rig[c], camera_from_world=pose)
    return dataclasses.replace(rig, cameras=tuple(cameras))


def make_rig(*size: int) -> CameraRig:
    """Three such cameras around the arena, of another width and height if given."""
    cameras = (make_camera(azimuth) for azimuth in (60, 180, 300))
    return CameraRig(tuple(camera.resized(*size) if size else camera for camera in cameras))


def image_grid(camera: Camera, count: int = 15) -> FloatArray:
    """Pixels (count², 2) of an even grid over the image, from corner to corner."""
    columns = np.linspace(-0.5, camera.width - 0.5, count)
    rows = np.linspace(-0.5, camera.height - 0.5, count)
    return np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)


def opencv_pixels(camera: Camera, points: Array, transform: Array | None = None) -> FloatArray:
    """By OpenCV: pixels (N, 2) of points in the world, or in the frame that `transform` (4, 4) gives."""
    camera_from = np.array(camera.camera_from_world if transform is None else transform)
    rotvec, _ = cv2.Rodrigues(camera_from[:3, :3])
    lens = np.array(camera.matrix), np.array(camera.distortion)
    return cv2.projectPoints(np.asarray(points), rotvec, camera_from[:3, 3], *lens)[0][:, 0]


def apart(one: Any, other: Any) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses."""
    shift = float(np.linalg.norm(one.position - other.position))
    return shift, float(so3.angle_between(one.rotation, other.rotation))


def within(one: Any, other: Any, metres: float, degrees: float) -> bool:
    """Whether two poses are so near each other."""
    shift, turn = apart(one, other)
    return shift < metres and turn < np.radians(degrees)


BAYER = [cv2.COLOR_BAYER_BG2BGR, cv2.COLOR_BAYER_GB2BGR, cv2.COLOR_BAYER_GR2BGR, cv2.COLOR_BAYER_RG2BGR]
"""Interpolations of mosaics whose red pixels are those of the phases 0 to 3."""


def exposed(levels: Array, gains: Array | float = 1.0) -> Image:
    """The image (H, W, 3) of levels of light, after a gain for each channel."""
    return np.clip(np.rint(levels * np.asarray(gains)), 0, 255).astype(np.uint8)


def veiled(image: Image, level: float) -> Image:
    """The image under stray light that lifts black to a level, and white not at all."""
    return exposed(level + image * (1.0 - level / 255.0))


def sight_of(tracker: ObjectTracker, images: Sequence[Image]) -> Sight:
    """What a tracker's estimator is given of its cameras' images."""
    return tracker._estimator.reader(images)
