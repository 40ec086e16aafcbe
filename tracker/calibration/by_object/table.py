"""Estimate the table's height and tilt from the lowest faces of objects at rest.

Each pose at rest gives three equations: the height of its contact and two slopes of its lowest face. Camera
errors shift all poses together; they are kept apart from errors that average out over many poses.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.by_object.edges import EdgeReader, Frame, pose_errors, seen_motion
from tracker.calibration.by_object.sightings import (
    Footage,
    Sighting,
    all_sightings,
    apart,
    require_two,
    resting,
)
from tracker.calibration.deviations import calibration_covariance, element_std, is_stated
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.judge import MIN_VIEW
from tracker.segmentation.color_model import ColorModel

FLOOR = 0.3e-3, np.radians(0.15)
"""Standard deviations of an object at rest due to worn table and edges: of height [m] and tilt [rad]."""

OUTLIER = 25.0
"""Squared Mahalanobis distance from the plane at which a pose's weight is zero (Tukey)."""

LOWEST = 0.2
"""Share of poses, the lowest ones, initially assumed to be at rest: held objects are higher, never lower."""

WIDER = (3.0, 2.0, 1.5) + (1.0,) * 12
"""Factors on the standard deviations, iteration by iteration."""

LEAST, SPREAD = 5, 0.015
"""Smallest number of poses that must rest on the plane, and standard deviation of their places of contact in
the direction in which they vary least [m]."""


@dataclass(frozen=True, eq=False)
class Rest:
    """An object that may lie on the table, at (3,) [m] with a rotation (3, 3) world_from_object."""

    position: FloatArray
    rotation: FloatArray
    own: FloatArray
    """Covariance (6, 6) of the errors specific to this pose [m, rad]."""
    common: FloatArray
    """Jacobian (6, C, 6) of the pose with respect to the cameras' errors (see `calibration.deviations`)."""


@dataclass(frozen=True, eq=False)
class TablePlane:
    """A plane z = height + slope · ((x, y) - center)."""

    center: tuple[float, float]
    """x and y of the point whose height is given [m]."""
    height: float
    """[m]"""
    slope: FloatArray
    """Slopes (2,) along x and y."""
    covariance: FloatArray
    """Covariance (3, 3) of height and slopes, including the cameras' errors, which all poses share."""
    used: Array
    """Weights (N,) of the poses, from 0 to 1."""
    scatter: float
    """Root mean square distance from the plane, over the poses at rest [m]."""

    @property
    def tilt(self) -> float:
        """Angle between the plane and z = 0 [rad]."""
        return float(np.arctan(np.hypot(*self.slope)))

    @property
    def std(self) -> tuple[float, float]:
        """Standard deviations of the height [m], and of the tilt in its least certain direction [rad]."""
        worst = np.linalg.eigvalsh(self.covariance[1:, 1:])[-1]
        return float(np.sqrt(self.covariance[0, 0])), float(np.sqrt(worst))


def fit_table(rests: Sequence[Rest], size: FloatArray, rig: CameraRig) -> TablePlane:
    """Fit the plane on which a cuboid of `size` (3,) [m] rests, robustly against poses in which it does not.

    CalibrationError: too few poses agree, or their positions are too close together.
    """
    center = rig.arena.center
    if len(rests) < LEAST:
        raise CalibrationError(
            f"table: found {len(rests)} places in which the object rests, expected {LEAST} or more, spread "
            "over the table"
        )
    rows = [_equations(rest, size, center) for rest in rests]
    values, designs, moves = (np.array(part) for part in zip(*rows, strict=True))
    floor = np.diag(np.square([FLOOR[0], FLOOR[1], FLOOR[1]]))
    own = np.array([move @ rest.own @ move.T + floor for move, rest in zip(moves, rests, strict=True)])
    known = np.linalg.inv(own)
    found, weights = _start(values, designs), np.ones(len(rests))
    for wider in WIDER:
        left = values - designs @ found
        distance = np.einsum("ni,nij,nj->n", left, known, left) / wider**2
        weights = np.clip(1.0 - distance / OUTLIER, 0.0, None) ** 2
        if np.count_nonzero(weights) < LEAST:
            continue
        weighted = np.einsum("n,nji,njk->nik", weights, designs, known)
        normal = np.einsum("nij,njk->ik", weighted, designs)
        found = np.linalg.solve(normal, np.einsum("nij,nj->i", weighted, values))
    _refuse(weights, designs, center)
    gain = np.linalg.solve(normal, weighted)
    covariance = np.einsum("nij,njk,nlk->il", gain, own, gain)
    shared = np.einsum("nij,njk,nkcm->icm", gain, moves, np.array([rest.common for rest in rests]))
    for c, camera in enumerate(rig):
        covariance += shared[:, c] @ calibration_covariance(camera) @ shared[:, c].T
    left = (values - designs @ found)[:, 0]
    scatter = float(np.sqrt((weights * left**2).sum() / weights.sum()))
    return TablePlane(center, float(found[0]), found[1:], covariance, weights, scatter)


def levelled(rig: CameraRig, plane: TablePlane) -> CameraRig:
    """Return the same cameras in a world whose z = 0 is the plane; x, y and yaw stay as they are.

    The world is turned by the tilt about a horizontal axis through the plane's centre, and moved along z. The
    cameras keep their uncertainty; the arena states that of the plane, and its top stays where it is if no
    table was stated.
    """
    axis = np.array([-plane.slope[1], plane.slope[0], 0.0])
    length = np.linalg.norm(axis)
    turn = so3.exp(axis / length * plane.tilt) if length > 0.0 else np.eye(3)
    place = np.array([*plane.center, 0.0])
    world_from_level = so3.transform(turn.T, np.array([*plane.center, plane.height]) - turn.T @ place)
    height = rig.arena.height - (plane.height if rig.arena.table is None else 0.0)
    arena = dataclasses.replace(rig.arena, height=height, table=0.0, table_std=plane.std)
    return dataclasses.replace(moved(rig, world_from_level), arena=arena)


def with_origin(rig: CameraRig, origin: FloatArray) -> CameraRig:
    """Return the same cameras and arena in a world that has its origin at (3,) [m]."""
    x, y, z = (np.array([*rig.arena.center, rig.arena.ground]) - origin).tolist()
    arena = dataclasses.replace(rig.arena, center=(x, y), table=None if rig.arena.table is None else z)
    return dataclasses.replace(moved(rig, so3.transform(np.eye(3), origin)), arena=arena)


def moved(rig: CameraRig, world_from_new: FloatArray) -> CameraRig:
    """Return the same cameras in a new world, given world_from_new (4, 4), with deviations transformed.

    Deviations of a position are those at the world's origin; their correlation with the rotation's is lost.
    """
    cameras, turn = [], np.kron(np.eye(2), world_from_new[:3, :3].T)
    for camera in rig:
        transform = camera.camera_from_world @ world_from_new
        transform[:3, :3] = so3.nearest_rotation(transform[:3, :3])
        std = camera.camera_from_world_std
        if is_stated(camera):
            motion = turn @ seen_motion(world_from_new[:3, 3])
            std = element_std(transform[:3, :3], motion @ calibration_covariance(camera) @ motion.T)
        cameras.append(dataclasses.replace(camera, camera_from_world=transform, camera_from_world_std=std))
    return dataclasses.replace(rig, cameras=tuple(cameras))


def _equations(
    rest: Rest, size: FloatArray, center: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the equations of a pose: values (3,) = design (3, 3) · (height, slopes), and moves (3, 6).

    The rows are the contact's height and the lowest face's slopes; moves: their change per error of the pose.
    """
    # The centre of the lowest face, and its inward normal.
    axis = int(np.argmax(np.abs(rest.rotation[2])))
    up = np.copysign(1.0, rest.rotation[2, axis]) * rest.rotation[:, axis]
    point = rest.position - 0.5 * size[axis] * up
    slope = -up[:2] / up[2]
    values, design = np.array([point[2], *slope]), np.eye(3)
    design[0, 1:] = point[:2] - center
    # δup = δθ × up. A turn about the centre moves the contact within its face only.
    moves, upwards = np.zeros((3, 6)), -so3.hat(up)
    moves[0, :3] = [*-slope, 1.0]
    moves[1:, 3:] = -(upwards[:2] + slope[:, None] * upwards[2]) / up[2]
    return values, design, moves


def _start(values: FloatArray, designs: FloatArray) -> FloatArray:
    """Return initial height and slopes (3,): the median slopes, and the height of the lowest poses."""
    slopes = np.median(values[:, 1:], axis=0)
    heights = values[:, 0] - designs[:, 0, 1:] @ slopes
    lowest = np.argsort(heights, kind="stable")[: max(2, round(LOWEST * len(heights)))]
    return np.array([np.median(heights[lowest]), *slopes])


def _refuse(weights: FloatArray, designs: FloatArray, center: tuple[float, float]) -> None:
    """Raise CalibrationError if too few poses rest on the plane, or all lie near one line."""
    if np.count_nonzero(weights) < LEAST:
        raise CalibrationError(
            f"table: found {np.count_nonzero(weights)} of {len(weights)} poses at rest to lie on one plane, "
            f"expected {LEAST} or more; was the object held, or did the cameras move?"
        )
    places = designs[:, 0, 1:]
    middle = np.average(places, axis=0, weights=weights)
    variances, axes = np.linalg.eigh(np.cov(places.T, aweights=weights, ddof=0))
    if variances[0] < SPREAD**2:
        spread, toward = np.sqrt(max(variances[0], 0.0)), axes[:, 0]
        one, other = (middle + sign * 3.0 * SPREAD * toward + center for sign in (1.0, -1.0))
        raise CalibrationError(
            f"table: the object rested in places that spread by {1e3 * spread:.0f} mm only, expected "
            f"{1e3 * SPREAD:.0f} mm to every side; lay it also near x, y = {one[0]:.2f}, {one[1]:.2f} m and "
            f"{other[0]:.2f}, {other[1]:.2f} m"
        )


BROAD = 0.015, 0.05
"""Standard deviations of the table's height [m] and tilt [rad] before it is estimated."""

TABLE_CONFIDENCE = 0.5
"""Smallest confidence of a pose that is used."""


def find_table(
    model: CuboidModel,
    footage: Sequence[Footage],
    rig: CameraRig,
    colors: ColorModel,
    progress: Callable[[int], None] = lambda _: None,
) -> tuple[CameraRig, TablePlane, int]:
    """Estimate the table from recordings and stills of an object that sometimes rests on it.

    Return the cameras and the arena in a world whose z = 0 is the table, the table in the given world, and
    the number of shots in which the object was surely seen. `progress` receives the number of new ones.
    CalibrationError: there is only one camera, or the object rested in too few places.
    """
    require_two(rig.cameras, "table", ": one camera's depth is not the table's height")
    loose = broad(rig)
    tracker, edges = ObjectTracker(model, loose, colors, table_prior=False), EdgeReader(model, loose, colors)
    seen = all_sightings(tracker, footage, TABLE_CONFIDENCE, progress)
    if not seen:
        raise CalibrationError(f"table: found no set of images in which {model.name} is surely seen")
    plane = plane_of(edges, seen)
    return levelled(rig, plane), plane, len(seen)


def broad(rig: CameraRig) -> CameraRig:
    """Return the same rig with the table's uncertainty raised to at least BROAD."""
    height, tilt = rig.arena.table_std
    std = max(height, BROAD[0]), max(tilt, BROAD[1])
    return dataclasses.replace(rig, arena=dataclasses.replace(rig.arena, table_std=std))


def plane_of(edges: EdgeReader, seen: Sequence[Sighting]) -> TablePlane:
    """Return the plane on which an object was seen to rest; CalibrationError: it rested in too few places."""
    found = [_rest(edges, frame) for frame in edges.sights(apart(resting(seen)))]
    rests = [rest for rest in found if rest is not None]
    if len(rests) < LEAST <= len(found):
        raise CalibrationError(
            f"table: found {len(found) - len(rests)} places in which one camera alone sees the object at "
            f"rest, and {len(rests)} in which others do, expected {LEAST} of these: one camera's depth is "
            "not the table's height"
        )
    return fit_table(rests, edges.model.size, edges.rig)


def _rest(edges: EdgeReader, frame: Frame) -> Rest | None:
    """Refit the pose in one shot and return it with its errors; None if fewer than two cameras see edges."""
    fit, found = edges.fitted(frame)
    if sum(one is not None and len(one.offset) >= MIN_VIEW for one in found) < 2:
        return None
    own, common = pose_errors(found, fit.position, edges.rig.cameras, edges.model.rim_std)
    return Rest(fit.position, fit.rotation, own, common) if np.isfinite(own).all() else None
