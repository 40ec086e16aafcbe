"""Refine the relative poses of the cameras from recordings of a moving object.

Bundle adjustment on images: measure edges, solve, update cameras and poses, and measure again.

The unknowns are the pose δ_f = (δp, δθ) of each frame; the error e_c = (a, w) (see `deviations`), response
exponent γ_c and, on request, focal length and principal point k_c of each camera; and the object's rim ρ.
With J the Jacobian of an edge piece's position with respect to the pose, and B(p) that of the apparent pose
of an object at p with respect to a camera's error, the offset of a piece [px] is
    r = J (δ_f + B(p_f) e_c) + K k_c + bloom γ_c + rim ρ.
The robustly weighted least squares problem is solved with the poses eliminated (Schur complement), since each
occurs in one frame only. D_f (6, 6) is the block of a pose, E_f of the pose with the rest, A of the rest:
    (A - Σ_f E_fᵀ D_f⁻¹ E_f) x = g - Σ_f E_fᵀ D_f⁻¹ g_f,   δ_f = D_f⁻¹ (g_f - E_f x).
No edge can show a motion common to all cameras; the priors on their errors hold it in place.
B. Triggs et al., "Bundle Adjustment: A Modern Synthesis", 2000.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from tracker.calibration.by_object.edges import FAR, VAGUE, Contour, EdgeReader, Frame, seen_motion
from tracker.calibration.by_object.sightings import (
    LEAST,
    UNSEEN,
    Footage,
    all_sightings,
    different,
    require_two,
)
from tracker.calibration.by_object.table import TablePlane, broad, levelled, plane_of, with_origin
from tracker.calibration.deviations import calibration_covariance, element_std
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError, NotBetterError
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import LIKELY
from tracker.pose.refine import EXPECTED_WEAR, EXPONENT_STD
from tracker.pose.solve import GAUSSIAN, TUKEY
from tracker.segmentation.color_model import ColorModel

EXTRINSIC, EXPONENT, FOCAL = slice(0, 6), 6, slice(7, 10)
"""Indices of a camera's unknowns: its error (a, w) [m, rad], its exponent, and the logarithm of its focal
length with its principal point [px]."""

LEAST_STD = 2e-3, np.radians(0.3)
"""Standard deviations of cameras' errors that are assumed in addition to the stated ones [m, rad]."""

FOCAL_STD, CENTER_STD = 5e-3, 0.01
"""Standard deviations of the logarithm of the focal length, and of the principal point [image widths]."""

EDGES_STD = 4e-5
"""Smallest standard deviation of the offset common to the edges of all frames, due to shading and shadows, as
a width of the rim [m]. Like the rim's uncertainty (worn edges look different from sharp ones), it does not
average out over frames, and resembles cameras that are all farther away or nearer."""

LEAST_LIMIT = 0.4
"""Smallest residual at which a piece's weight is zero [px]."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The current estimate of the cameras and the rim, and its prior."""

    cameras: tuple[Camera, ...]
    errors: FloatArray
    """Sum (C, 10) of all changes so far: EXTRINSIC, EXPONENT, FOCAL."""
    rim: float
    """Width of the object's rim [m]."""
    information: FloatArray
    """Prior information (C, 10, 10) on the errors; the prior mean of the exponents is that of LIKELY."""
    likely_rim: tuple[float, float]
    """Prior mean of the rim's width, and its standard deviation [m]."""

    @classmethod
    def of(cls, cameras: Sequence[Camera], rim: tuple[float, float], *, focal: bool) -> Unknowns:
        """Return the prior from `rim` and what cameras state; `focal`: whether lenses are unknown."""
        errors = np.zeros((len(cameras), 10))
        errors[:, EXPONENT] = LIKELY.exponent
        information = np.zeros((len(cameras), 10, 10))
        for one, camera in zip(information, cameras, strict=True):
            one[EXTRINSIC, EXTRINSIC] = calibration_covariance(camera, -1)
            one[EXPONENT, EXPONENT] = EXPONENT_STD**-2
            center = CENTER_STD * camera.width
            stds = np.array([FOCAL_STD, center, center]) if focal else np.full(3, 1e-9)
            one[FOCAL, FOCAL] = np.diag(stds**-2.0)
        return cls(tuple(cameras), errors, rim[0], information, rim)

    def moved(self, change: FloatArray, rim: float) -> Unknowns:
        """Return the estimate after a change (C, 10) of the cameras, with a new rim."""
        cameras = tuple(_changed(camera, one) for camera, one in zip(self.cameras, change, strict=True))
        return dataclasses.replace(self, cameras=cameras, errors=self.errors + change, rim=rim)


@dataclass(frozen=True, eq=False)
class Step:
    """One Gauss-Newton step."""

    poses: FloatArray
    """Change (F, 6) of each frame's pose [m, rad]."""
    change: FloatArray
    """Change (C, 10) of the cameras."""
    rim: float
    """The new width of the rim [m], not its change."""
    rim_std: float
    """Marginal standard deviation of the rim, including EDGES_STD [m]."""
    covariance: FloatArray
    """Covariance (C, 10, C, 10) of the cameras' unknowns."""
    residual: float
    """Robust standard deviation of the offsets before the step [px]."""
    own: float
    """Variance of the offset that the pieces of an edge share [px²]."""


def solve(views: Sequence[tuple[FloatArray, Sequence[Contour | None]]], now: Unknowns) -> Step:
    """Return the step from the current estimate.

    views: for each frame the object's position (3,) [m], and each camera's edges; None if it shows none.
    """
    count, size = len(now.cameras), 10 * len(now.cameras) + 1
    # Each contour with its residuals (N,): offsets that exponent and rim do not explain [px].
    seen = [
        [
            (c, one, one.offset - one.bloom * now.errors[c, EXPONENT] - one.rim * now.rim)
            for c, one in enumerate(contours)
            if one is not None
        ]
        for _, contours in views
    ]
    every = np.concatenate([left for view in seen for *_, left in view])
    scatter = GAUSSIAN * float(np.median(np.abs(every)))
    limit = max(LEAST_LIMIT, TUKEY * scatter)
    own = _own_variance(seen, limit)
    rest, right = _prior(now)
    poses = []
    for (position, _), view in zip(views, seen, strict=True):
        # D (6, 6), E (6, size) and g (6,) of the frame's pose.
        held, joint, force = VAGUE.copy(), np.zeros((6, size)), np.zeros(6)
        motion = seen_motion(position)
        for c, contour, left in view:
            moves = contour.jacobian  # columns of the pose, of the camera (to the lens), rim and residual
            columns = [moves, moves @ motion, contour.bloom, contour.lens, contour.rim, left]
            found = contour.information(np.column_stack(columns), _weights(left, limit), own)
            its = [*range(10 * c, 10 * c + 10), size - 1]
            held += found[:6, :6]
            joint[:, its] += found[:6, 6:-1]
            force += found[:6, -1]
            rest[np.ix_(its, its)] += found[6:-1, 6:-1]
            right[its] += found[6:-1, -1]
        solved = np.linalg.solve(held, np.column_stack([joint, force]))
        rest -= joint.T @ solved[:, :-1]
        right -= joint.T @ solved[:, -1]
        poses.append((held, joint, force))
    # Scale before inverting: metres, radians and pixels differ by orders of magnitude.
    unit = 1.0 / np.sqrt(np.diag(rest))
    covariance = np.linalg.inv(rest * np.outer(unit, unit)) * np.outer(unit, unit)
    found = covariance @ right
    changes = np.array([np.linalg.solve(held, force - joint @ found) for held, joint, force in poses])
    pulled = np.linalg.solve(rest[:-1, :-1], rest[:-1, -1])
    alike = max(EDGES_STD, now.likely_rim[1])
    errors = covariance[:-1, :-1] + alike**2 * np.outer(pulled, pulled)
    return Step(
        changes,
        found[:-1].reshape(count, 10),
        now.rim + float(found[-1]),
        float(np.hypot(np.sqrt(covariance[-1, -1]), EDGES_STD)),
        errors.reshape(count, 10, count, 10),
        scatter,
        own,
    )


def relative_covariance(covariance: FloatArray) -> FloatArray:
    """Return the covariances (C, 6, 6) of the cameras' errors (a, w) without their common motion.

    covariance: (C, 10, C, 10) of a `Step`. Common motion changes the world frame, not the relative poses.
    """
    count = len(covariance)
    joint = covariance[:, EXTRINSIC, :, EXTRINSIC].reshape(6 * count, 6 * count)
    apart = np.kron(np.eye(count) - 1.0 / count, np.eye(6))
    relative = (apart @ joint @ apart.T).reshape(count, 6, count, 6)
    return np.stack([relative[c, :, c] for c in range(count)])


def _weights(left: FloatArray, limit: float) -> FloatArray:
    """Return Tukey's weights (N,)."""
    return np.asarray(np.clip(1.0 - (left / limit) ** 2, 0.0, None) ** 2)


def _own_variance(seen: Sequence[Sequence[tuple[int, Contour, FloatArray]]], limit: float) -> float:
    """Return the variance [px²] of the offset that an edge's pieces share: of their means, less noise."""
    total, count = 0.0, -6.0 * len(seen)  # degrees of freedom of the poses
    for view in seen:
        for _, contour, left in view:
            weights = _weights(left, limit) * (contour.foot == 0.0) / contour.variance
            known = np.bincount(contour.edge, weights, 12)
            shown = known > 0.0
            means = np.bincount(contour.edge, weights * left, 12)[shown] / known[shown]
            total += float((means**2 - 1.0 / known[shown]).sum())
            count += len(means)
    return max(EXPECTED_WEAR**2, total / max(count, 1.0))


def _prior(now: Unknowns) -> tuple[FloatArray, FloatArray]:
    """Return the prior's information (n, n) and right-hand side (n,) on all cameras in turn, then the rim."""
    off = now.errors.copy()
    off[:, EXPONENT] -= LIKELY.exponent
    pulls = [-information @ one for information, one in zip(now.information, off, strict=True)]
    rim, std = now.likely_rim
    return block_diag(*now.information, std**-2.0), np.append(pulls, (rim - now.rim) / std**2)


def _changed(camera: Camera, change: FloatArray) -> Camera:
    """Return a camera after a change (10,) of its unknowns."""
    transform = camera.camera_from_world @ so3.transform(so3.exp(change[3:6]), change[:3])
    transform[:3, :3] = so3.nearest_rotation(transform[:3, :3])
    matrix = camera.matrix.copy()
    matrix[(0, 1), (0, 1)] *= np.exp(change[FOCAL][0])
    matrix[:2, 2] += change[FOCAL][1:]
    return dataclasses.replace(camera, matrix=matrix, camera_from_world=transform)


ITERATIONS, SETTLED = 10, (0.02e-3, np.radians(0.002))
"""Largest number of iterations, and change of the cameras below which they have converged [m, rad]."""


def adjust(
    edges: EdgeReader, frames: Sequence[Frame], rim: tuple[float, float], *, focal: bool
) -> tuple[Unknowns, Step]:
    """Return the estimate that best fits the edges in the frames, and the last step; see `Unknowns.of`.

    The reader's cameras must state deviations wide enough to move (see `wider`).
    """
    now = Unknowns.of(edges.rig.cameras, rim, focal=focal)
    fits = [edges.refine(sight, seen.rotation, seen.position) for sight, seen in frames]
    poses = [(fit.rotation, fit.position) for fit in fits]
    for _ in range(ITERATIONS):
        reader = edges.of(dataclasses.replace(edges.rig, cameras=now.cameras))
        read = [
            (position, reader.contours(sight, rotation, position, fit.end))
            for (sight, _), (rotation, position), fit in zip(frames, poses, fits, strict=True)
        ]
        step = solve(read, now)
        now = now.moved(step.change, step.rim)
        poses = [
            (so3.exp(change[3:]) @ rotation, position + change[:3])
            for (rotation, position), change in zip(poses, step.poses, strict=True)
        ]
        shift, turn = (np.linalg.norm(step.change[:, k : k + 3], axis=1).max() for k in (0, 3))
        if shift < SETTLED[0] and turn < SETTLED[1]:
            break
    return now, step


def _stating(rig: CameraRig, cameras: Sequence[Camera], stds: Iterable[FloatArray | None]) -> CameraRig:
    """Return the rig with other cameras that state deviations (4, 4)."""
    pairs = zip(cameras, stds, strict=True)
    stating = tuple(dataclasses.replace(camera, camera_from_world_std=std) for camera, std in pairs)
    return dataclasses.replace(rig, cameras=stating)


def wider(camera: Camera) -> FloatArray:
    """Return the deviations (4, 4) of a camera's pose: LEAST_STD in addition to the stated ones."""
    least = element_std(camera.camera_from_world[:3, :3], np.diag(np.repeat(np.square(LEAST_STD), 3)))
    std = camera.camera_from_world_std
    return least if std is None else np.hypot(std, least)


REFINE_CONFIDENCE = 0.15
"""Smallest confidence of a pose that is used; it is low since the calibration to refine lowers confidence."""

JUDGED, GAIN = 3, 0.05
"""One in this many frames is held out to judge cameras fitted to the others, and the share by which its
offsets must decrease."""

FLOOR = 0.15e-3, np.radians(0.04)
"""Standard deviations added to those of the result, for errors of the lens and edge models [m, rad]."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Cameras refined from recordings, and how much better they fit."""

    rig: CameraRig
    moved: FloatArray
    """Error (C, 6) of each camera relative to the mean of all at the arena's middle [m, rad], along world
    axes."""
    std: FloatArray
    """Standard deviations (C, 6) of these errors."""
    lenses: FloatArray
    """Change (C, 3) of the focal length [1], and of the principal point [px]."""
    lens_std: tuple[FloatArray, ...]
    """Standard deviations (3, 3) of the cameras' matrices [px]; near zero if lenses were kept."""
    before: float
    """RMS offset of the edges in held-out frames [px of an object of reference size]."""
    after: float
    """The same with cameras fitted without those frames."""
    rim: tuple[float, float]
    """How far inside its nominal edges the object's colours end, and the standard deviation [m]."""
    frames: int
    plane: TablePlane | None
    """The table in the world before levelling; None if the object rested in too few places."""


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
    """Refine the cameras to fit the object's edges in all frames, at most `most`, jointly.

    Cameras are fitted to two thirds of the frames and judged by the others. If those fit better, the final
    cameras are fitted to all. The world frame is not observable: x, y and yaw stay as they are on average
    over the old cameras, weighted by the deviations that they state, and so do z and tilt unless the object
    rested in enough places. `progress` receives the number of new shots that show the object.

    CalibrationError: there is only one camera, or the object was seen in too few poses, or by a camera in too
    few frames. NotBetterError: the refined cameras do not fit the held-out frames better.
    """
    require_two(rig.cameras, "refine", ": it finds their relative positions")
    # The least deviations are those at the object: the world's origin may be far away.
    middle = np.array([*rig.arena.center, rig.arena.ground])
    rig = with_origin(rig, middle)
    wide = _stating(broad(rig), rig.cameras, map(wider, rig))
    tracker, edges = ObjectTracker(model, wide, colors, table_prior=False), EdgeReader(model, wide, colors)
    seen = all_sightings(tracker, footage, REFINE_CONFIDENCE, progress)
    frames = list(edges.sights(different(model.name, seen, most)))
    shown = [[one is not None for one in edges.fitted(frame)[1]] for frame in frames]
    for name, count in zip(rig.names, np.sum(shown, axis=0).tolist(), strict=True):
        if count < LEAST // 3:
            few = f"found that {count} of {len(frames)} frames show {model.name}"
            raise CalibrationError(f"refine: {name}: {few}, expected {LEAST // 3} or more: {UNSEEN}")
    rim = model.rim, model.rim_std
    before, after = _judged(edges, rig, frames, rim, focal=focal)
    now, step = adjust(edges, frames, rim, focal=focal)
    covariances = relative_covariance(step.covariance) + np.diag(np.repeat(np.square(FLOOR), 3))
    rotations = [camera.camera_from_world[:3, :3] for camera in now.cameras]
    found, plane = _stating(rig, now.cameras, map(element_std, rotations, covariances)), None
    # If the object rested in too few places, z and tilt stay as they are.
    with contextlib.suppress(CalibrationError):
        plane = plane_of(edges.of(found), seen)
        middle[2], height = 0.0, plane.height + middle[2]
        found = levelled(found, plane)
        plane = dataclasses.replace(plane, center=(middle[0], middle[1]), height=height)
    return Refined(
        with_origin(found, -middle),
        now.errors[:, EXTRINSIC] - now.errors[:, EXTRINSIC].mean(axis=0),
        np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)),
        now.errors[:, FOCAL],
        tuple(_lens_std(camera, step.covariance[c, :, c]) for c, camera in enumerate(now.cameras)),
        before,
        after,
        (step.rim, step.rim_std),
        len(frames),
        plane,
    )


def _judged(
    edges: EdgeReader, rig: CameraRig, frames: Sequence[Frame], rim: tuple[float, float], *, focal: bool
) -> tuple[float, float]:
    """Return the misfit [px], in frames held out, of a rig and of its cameras fitted to the other frames.

    NotBetterError: it is no less than before.
    """
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
            f"calibration as it is, and {after:.3f} px with the one found; expected {100 * GAIN:.0f} % less: "
            "it is as good as these recordings can tell"
        )
    return before, after


def _lens_std(camera: Camera, covariance: FloatArray) -> FloatArray:
    """Return the deviations (3, 3) of a camera's matrix, from the covariance (10, 10) of its unknowns."""
    focal, *center = np.sqrt(np.diag(covariance[FOCAL, FOCAL]))
    std = np.diag([*(camera.matrix.diagonal()[:2] * focal), 0.0])
    std[:2, 2] = center
    return std


def misfit(edges: EdgeReader, frames: Sequence[Frame]) -> float:
    """Return the root mean square offset, at most FAR, of edges at the poses that fit best."""
    squares, count = 0.0, 0
    for frame in frames:
        fit, found = edges.fitted(frame)
        for one in found:
            if one is not None:
                left = one.offset - one.bloom * fit.end.exponent - one.rim * fit.end.rim
                squares += float(np.minimum(left**2, FAR**2).sum())
                count += len(left)
    return float(np.sqrt(squares / max(count, 1)))
