"""Mends a calibration by what recordings of a moving object show: how the cameras stand to each other.

Bundle adjustment over pictures: read edges, solve, move cameras and poses, and read again.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.by_object.bundle import (
    EXTRINSIC,
    FOCAL,
    LEAST_STD,
    Step,
    Unknowns,
    relative_covariance,
    solve,
)
from tracker.calibration.by_object.edges import EdgeReader, Frame
from tracker.calibration.by_object.sightings import Footage, all_sightings, different, require_two
from tracker.calibration.by_object.table import TablePlane, broad, levelled, plane_of
from tracker.calibration.deviations import element_std
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError, NotBetterError
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.segmentation.color_model import ColorModel

ITERATIONS = 10
"""Steps, at most."""

SETTLED = 0.02e-3, np.radians(0.002)
"""Change of a camera below which it has settled [m, rad]."""


def adjust(
    edges: EdgeReader, frames: Sequence[Frame], rim: tuple[float, float], *, focal: bool
) -> tuple[Unknowns, Step]:
    """The cameras that fit the frames' edges best, with what else was unknown, and the last step.

    The reader's cameras state deviations that leave them room (see `_wider`). `rim`: of the object, and its
    standard deviation [m]. `focal`: whether focal lengths and principal points are unknown, too.
    """
    now = Unknowns.of(edges.rig.cameras, rim, focal=focal)
    fits = [edges.refine(sight, seen.rotation, seen.position) for sight, seen in frames]
    poses = [(fit.rotation, fit.position) for fit in fits]
    # At first the cameras see the object beside where they should.
    aims: Sequence[FloatArray | None] = [fit.offsets for fit in fits]
    for _ in range(ITERATIONS):
        reader = edges.of(dataclasses.replace(edges.rig, cameras=now.cameras))
        read = [
            (position, reader.contours(sight, rotation, position, fit.end, aim))
            for (sight, _), (rotation, position), fit, aim in zip(frames, poses, fits, aims, strict=True)
        ]
        step = solve(read, now)
        now = now.moved(step.change, step.rim)
        poses = [
            (so3.exp(change[3:]) @ rotation, position + change[:3])
            for (rotation, position), change in zip(poses, step.poses, strict=True)
        ]
        aims = [None] * len(frames)
        shift, turn = (np.linalg.norm(step.change[:, k : k + 3], axis=1).max() for k in (0, 3))
        if shift < SETTLED[0] and turn < SETTLED[1]:
            break
    return now, step


def _stating(rig: CameraRig, cameras: Sequence[Camera], stds: Iterable[FloatArray | None]) -> CameraRig:
    """The rig with other cameras, which state deviations (4, 4)."""
    pairs = zip(cameras, stds, strict=True)
    stating = tuple(dataclasses.replace(camera, camera_from_world_std=std) for camera, std in pairs)
    return dataclasses.replace(rig, cameras=stating)


def _wider(camera: Camera) -> FloatArray:
    """What a camera states of its place, at least LEAST_STD."""
    least = element_std(camera.camera_from_world[:3, :3], np.diag(np.repeat(np.square(LEAST_STD), 3)))
    std = camera.camera_from_world_std
    return least if std is None else np.maximum(std, least)


SURE = 0.15
"""Least confidence of a pose that counts: a calibration that is off makes it low, and is to be mended."""

JUDGED = 3
"""One in so many frames judges what the others teach."""

MISSED = 2.0
"""Offset as which a larger one counts when cameras are judged [px of an object of reference size]."""

GAIN = 0.05
"""Share by which the held-out offsets must shrink."""

FLOOR = 0.15e-3, np.radians(0.04)
"""Standard deviations that are always stated: what a model of lenses and edges does not know [m, rad]."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Cameras that fit the recordings, and how much better."""

    rig: CameraRig
    """The cameras."""
    moved: FloatArray
    """(C, 6) by how much each was off against the mean of all [m, rad], along world axes."""
    std: FloatArray
    """(C, 6) of that."""
    lenses: FloatArray
    """(C, 3) change of the focal length [1], and of the principal point [px]."""
    before: float
    """Root mean square offset of the edges in frames held out [px of an object of reference size]."""
    after: float
    """The same with cameras fitted without those frames."""
    rim: tuple[float, float]
    """How far within its nominal edges the object's colours end, and how well that is known [m]."""
    frames: int
    """Frames that were used."""
    plane: TablePlane | None
    """The table in the refined cameras' world of before, where the object rested often enough to see it."""


def refine_cameras(
    model: CuboidModel,
    footage: Sequence[Footage],
    rig: CameraRig,
    colors: ColorModel,
    *,
    focal: bool = False,
    most: int = 90,
    progress: Callable[[int], None] = lambda _: None,
) -> Refined:
    """The cameras that fit the object's edges in all frames together.

    Cameras are taught by two thirds of the frames and judged by the others; if those are fitted better, the
    final ones are taught by all. Where the world is, they cannot tell: x, y and yaw stay as the old cameras
    have them on the average, and so do z and tilt unless the object rested often enough to show the table.

    `most` frames are used; `progress` takes how many more shots showed the object.

    Raises:
        CalibrationError: there is one camera only, or the object was seen in too few poses.
        NotBetterError: held-out frames are fitted no better.
    """
    require_two(rig.cameras, "refine", ", which stand to each other")
    wide = _stating(broad(rig), rig.cameras, map(_wider, rig))
    tracker, edges = ObjectTracker(model, wide, colors, table_prior=False), EdgeReader(model, wide, colors)
    seen = all_sightings(tracker, footage, SURE, progress)
    frames = list(edges.sights(footage, different(model.name, seen, most)))
    rim = model.rim, model.rim_std
    taught = [frame for k, frame in enumerate(frames) if k % JUDGED]
    judges = frames[::JUDGED]
    lesson, _ = adjust(edges, taught, rim, focal=focal)
    before, after = (
        misfit(edges.of(_stating(rig, cameras, [None] * len(rig))), judges)
        for cameras in (rig.cameras, lesson.cameras)
    )
    if not after < (1.0 - GAIN) * before:
        raise NotBetterError(
            f"refine: refused: edges in {len(judges)} frames held out are {before:.3f} px off with the "
            f"calibration as it is, and {after:.3f} px with the one found; expected {GAIN:.0%} less: it is "
            "as good as these recordings can tell"
        )
    now, step = adjust(edges, frames, rim, focal=focal)
    covariances = relative_covariance(step.covariance) + np.diag(np.repeat(np.square(FLOOR), 3))
    stds = [
        element_std(camera.camera_from_world[:3, :3], one)
        for camera, one in zip(now.cameras, covariances, strict=True)
    ]
    found, plane = _stating(rig, now.cameras, stds), None
    # Where it hardly rests, z and tilt stay as they are.
    with contextlib.suppress(CalibrationError):
        plane = plane_of(model, edges.of(found), footage, seen)
    return Refined(
        found if plane is None else levelled(found, plane),
        now.errors[:, EXTRINSIC] - now.errors[:, EXTRINSIC].mean(axis=0),
        np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)),
        now.errors[:, FOCAL],
        before,
        after,
        (step.rim, step.rim_std),
        len(frames),
        plane,
    )


def misfit(edges: EdgeReader, frames: Sequence[Frame]) -> float:
    """Root mean square offset [px at reference size] of edges at the poses that fit best."""
    squares, count = 0.0, 0
    for frame in frames:
        fit, found = edges.fitted(frame)
        for one in found:
            if one is not None:
                left = one.offset - one.bloom * fit.end.exponent - one.rim * fit.end.rim
                squares += float(np.minimum(left**2, MISSED**2).sum())
                count += len(left)
    return float(np.sqrt(squares / max(count, 1)))
