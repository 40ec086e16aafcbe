"""The tracker's errors on films with ground truth, as episodes for `benchmarks.score.noise`.

A film is played with many calibrations, each an episode. In every second episode, grey covers in front of the
object come and go, so that all visible fractions occur.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable

import cv2
import numpy as np

import tracker
from benchmarks.data.films import RATE, FilmFrame, FilmStore
from benchmarks.data.plan import Plan
from benchmarks.data.scenes import rig
from benchmarks.measure.timing import one_thread
from benchmarks.score.errors import placed, projected
from synthetic.camera.miscalibration import stated
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera

FILMS, LENGTH, CALIBRATIONS = 12, 60, 24
"""Number of films per object, frames per film, and calibrations per film."""

REFINED = 0.16e-3, np.radians(0.02)
"""Standard deviation of refined cameras [m, rad]: benchmarks/development.md, "Cameras, refined"."""

COVERED = 1.0
"""Mean duration of a period with or without covers [s]."""


def measure_noise(
    object_name: str, plan: Plan, *, refined: bool = False
) -> tuple[list[Array], list[int], list[float]]:
    """Return episodes, the film number of each, and the processor time of all updates [s]."""
    store = FilmStore(object_name, "errors", LENGTH, plan)
    store.prepare(range(FILMS), vanishing=False)
    model = tracker.load_object(object_name)
    episodes, films, spent = [], [], []
    with one_thread():
        for film in range(FILMS):
            frames = list(store.frames(film, range(LENGTH)))
            true, given = frames[0].rigs(rig())
            for k in range(CALIBRATIONS):
                rng = np.random.default_rng([plan.seed, film, k])
                own = given if k == 0 else stated(true, rng)
                own = mended(true, own, rng) if refined else own
                shown = covered(frames, true, model.size, rng) if k % 2 else frames
                rows, seconds = played(tracker.ObjectTracker(model, own), shown)
                episodes.append(rows)
                films.append(film)
                spent += seconds
    return episodes, films, spent


def mended(true: CameraRig, given: CameraRig, rng: np.random.Generator) -> CameraRig:
    """Draw the cameras that a refinement would yield."""

    def one(camera: Camera, before: Camera) -> Camera:
        transform, std = camera.camera_from_world.copy(), before.camera_from_world_std
        turn, shift = (size / np.sqrt(3.0) * rng.standard_normal(3) for size in REFINED[::-1])
        transform[:3, :3] = so3.exp(turn) @ transform[:3, :3]
        transform[:3, 3] += shift
        return dataclasses.replace(
            camera, camera_from_world=transform, camera_from_world_std=None if std is None else 0.3 * std
        )

    return dataclasses.replace(true, cameras=tuple(map(one, true, given)))


def played(own: tracker.ObjectTracker, frames: Iterable[FilmFrame]) -> tuple[FloatArray, list[float]]:
    """Return an episode (T, 16) of the poses that `update` measures, and the processor time of each [s]."""
    rows, spent = [], []
    for frame in frames:
        assert frame.position is not None
        assert frame.rotation is not None
        start = time.process_time()
        pose = own.update(frame.images, frame.timestamp).object_pose
        spent.append(time.process_time() - start)
        error = np.full(7, np.nan)
        if pose is not None:
            turn = so3.log(so3.matrix_from_quaternion(pose.orientation) @ frame.rotation.T)
            error = np.r_[pose.position - frame.position, turn, pose.confidence]
        true = frame.position, so3.quaternion_from_matrix(frame.rotation)
        rows.append(np.concatenate([[frame.timestamp, np.mean(frame.visible_fraction)], error, *true]))
    return np.array(rows), spent


def covered(
    frames: list[FilmFrame], true: CameraRig, size: FloatArray, rng: np.random.Generator
) -> list[FilmFrame]:
    """Return the film with covers that temporarily hide part of the object from each camera."""
    shares, at = np.zeros((len(frames), len(true))), 0
    while at < len(frames):
        at += max(1, round(RATE * rng.exponential(COVERED)))
        end = at + max(1, round(RATE * rng.exponential(COVERED)))
        own = np.sqrt(rng.random()) + 0.15 * rng.standard_normal(len(true))
        shares[at:end] = np.clip(own, 0.0, 1.0)
        at = end
    angles, grey = rng.uniform(0.0, 2.0 * np.pi, len(true)), int(rng.integers(30, 160))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    result = []
    for frame, share in zip(frames, shares, strict=True):
        corners = placed(0.5 * size * signs, frame.position, frame.rotation)  # type: ignore[arg-type]
        images = tuple(
            _with_cover(image, projected(camera, corners), float(part), float(angle), grey)
            for image, camera, part, angle in zip(frame.images, true, share, angles, strict=True)
        )
        seen = frame.visible_fraction * (1.0 - share)
        result.append(dataclasses.replace(frame, images=images, visible_fraction=seen))
    return result


def _with_cover(image: Image, corners: FloatArray, share: float, angle: float, grey: int) -> Image:
    outline = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(outline, cv2.convexHull(np.round(corners).astype(np.int32)), (1,))
    if share <= 0.0 or not outline.any():
        return image
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    across = np.cos(angle) * x + np.sin(angle) * y
    center = corners.mean(axis=0)
    reach = 1.2 * np.linalg.norm(corners - center, axis=1).max()
    near = np.hypot(x - center[0], y - center[1]) < reach
    result = image.copy()
    result[near & (across <= np.quantile(across[outline > 0], share))] = grey
    return result
