"""Bundle adjustment over pictures: read edges, solve, move cameras and poses, and read again."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.by_object.bundle import LEAST_STD, Posed, Prior, Step, Unknowns, solve
from tracker.calibration.by_object.edges import EdgeReader
from tracker.calibration.deviations import element_std
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.pose.fit import Start
from tracker.pose.views import Sight

ITERATIONS = 10
"""Steps, at most."""

SETTLED = 0.02e-3, np.radians(0.002)
"""Change of a camera below which it has settled [m, rad]."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Pictures of the object in a pose."""

    sight: Sight
    """What they say."""
    position: FloatArray
    """(3,) about where it is [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object, about."""


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Cameras that fit the edges of all frames."""

    unknowns: Unknowns
    """The cameras, and what else was unknown."""
    step: Step
    """The last one."""
    iterations: int
    converged: bool


def widened(rig: CameraRig) -> CameraRig:
    """The same cameras, stated to be at most as good as LEAST_STD."""
    return _replaced(rig, [_with_std(camera, _wider(camera)) for camera in rig])


def exact(rig: CameraRig) -> CameraRig:
    """The same cameras, stated to be exact."""
    return _replaced(rig, [_with_std(camera, None) for camera in rig])


def adjust(edges: EdgeReader, frames: Sequence[Frame], rim: tuple[float, float], *, focal: bool) -> Adjusted:
    """The cameras that fit the frames' edges best.

    Args:
        edges: reader of the cameras as they were, with deviations that leave them room (see `widened`).
        frames: in which the object is seen by some of them.
        rim: of the object, and its standard deviation [m].
        focal: whether focal lengths and principal points are unknown, too.
    """
    prior = Prior.of(edges.rig.cameras, rim, focal=focal)
    now = Unknowns.of(edges.rig.cameras, rim[0])
    poses, starts, offsets = [], [], []
    for frame in frames:
        refined = edges.refine(frame.sight, frame.rotation, frame.position)
        poses.append((refined.rotation, refined.position))
        starts.append(refined.end)
        # At first the cameras see the object beside where they should.
        offsets.append(refined.offsets)
    aims: Sequence[FloatArray | None] = offsets
    converged, done = False, 0
    while not converged and done < ITERATIONS:
        reader = edges.of(_replaced(edges.rig, now.cameras))
        step = solve(_read(reader, frames, poses, starts, aims), now, prior)
        now = now.moved(step.change, step.rim)
        poses = [_moved(pose, change) for pose, change in zip(poses, step.poses, strict=True)]
        aims = [None] * len(frames)
        shift, turn = (np.linalg.norm(step.change[:, k : k + 3], axis=1).max() for k in (0, 3))
        converged = bool(shift < SETTLED[0] and turn < SETTLED[1])
        done += 1
    return Adjusted(now, step, done, converged)


def _read(
    reader: EdgeReader,
    frames: Sequence[Frame],
    poses: Sequence[tuple[FloatArray, FloatArray]],
    starts: Sequence[Start],
    aims: Sequence[FloatArray | None],
) -> list[Posed]:
    result = []
    for frame, (rotation, position), start, aim in zip(frames, poses, starts, aims, strict=True):
        result.append(Posed(position, reader.contours(frame.sight, rotation, position, start, aim)))
    return result


def _moved(pose: tuple[FloatArray, FloatArray], change: FloatArray) -> tuple[FloatArray, FloatArray]:
    return so3.exp(change[3:]) @ pose[0], pose[1] + change[:3]


def _replaced(rig: CameraRig, cameras: Sequence[Camera]) -> CameraRig:
    return dataclasses.replace(rig, cameras=tuple(cameras))


def _with_std(camera: Camera, std: FloatArray | None) -> Camera:
    return dataclasses.replace(camera, camera_from_world_std=std)


def _wider(camera: Camera) -> FloatArray:
    least = element_std(camera.camera_from_world[:3, :3], np.diag(np.repeat(np.square(LEAST_STD), 3)))
    std = camera.camera_from_world_std
    return least if std is None else np.maximum(std, least)
