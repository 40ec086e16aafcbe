"""Bundle adjustment of cameras over the edges of an object in many poses.

Unknown are the pose of each frame, δ_f = (δp, δθ); of each camera its error e_c = (a, w) (see `deviations`),
the exponent γ_c of its response and, on request, its focal length and principal point k_c; and the object's
rim ρ.
With J the motion of a piece of an edge with the pose, and B(p) that of an object at p with a camera's error,
its offset [px] is
    r = J (δ_f + B(p_f) e_c) + K k_c + bloom γ_c + rim ρ.
Weighted least squares with robust weights; the poses are eliminated (Schur), since each is in its own frame
only: D_f (6, 6) of a pose, E_f of its pose with the rest, A of the rest:
    (A - Σ_f E_fᵀ D_f⁻¹ E_f) x = g - Σ_f E_fᵀ D_f⁻¹ g_f,   δ_f = D_f⁻¹ (g_f - E_f x).
What would move all cameras alike no edge can tell; priors on their errors keep it where it was.
B. Triggs et al., "Bundle Adjustment: A Modern Synthesis", 2000.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.calibration.by_object.edges import EXPONENT_STD, OWN, Contour, seen_motion
from tracker.calibration.deviations import calibration_covariance
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera

EXTRINSIC, EXPONENT, FOCAL = slice(0, 6), 6, slice(7, 10)
"""What is unknown of a camera: its error (a, w) [m, rad], its exponent, and its logarithm of the focal length
and principal point [px]."""

LEAST_STD = 2e-3, np.radians(0.3)
"""Standard deviations of cameras' errors that are reckoned with beside those that are stated [m, rad]."""

FOCAL_STD, CENTER_STD = 5e-3, 0.01
"""Standard deviations of the logarithm of the focal length, and of the principal point [pictures' widths]."""

LIKELY_EXPONENT = 0.3
"""Exponent of response (less 1) that is expected."""

EDGES_STD = 4e-5
"""What edges of all frames are off by together, as a rim's width [m], at least: shade and shadows move them.
No number of frames averages that away, nor by how much the rim is not known, since worn edges look otherwise
than sharp ones; it looks like cameras that are all farther away or nearer."""

TUKEY, LEAST_LIMIT = 4.685, 0.4
"""Residual at which a piece's weight reaches zero [robust standard deviations], and the least such [px]."""

_HELD = np.diag(np.repeat([2e-2, 3e-1], 3) ** -2.0)
"""(6, 6) information that holds what no camera sees of a pose [m, rad]."""


class Posed(NamedTuple):
    """What the cameras show of the object in one frame."""

    position: FloatArray
    """(3,) where it is looked for [m]."""
    contours: Sequence[Contour | None]
    """Of each camera."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The cameras as known so far, and how far they are from where their files have them."""

    cameras: tuple[Camera, ...]
    """As they are now taken to be."""
    errors: FloatArray
    """(C, 10) EXTRINSIC, EXPONENT, FOCAL: what has been added up."""
    rim: float
    """Of the object [m]."""

    @classmethod
    def of(cls, cameras: Sequence[Camera], rim: float) -> Unknowns:
        """To begin with."""
        errors = np.zeros((len(cameras), 10))
        errors[:, EXPONENT] = LIKELY_EXPONENT
        return cls(tuple(cameras), errors, rim)

    def moved(self, change: FloatArray, rim: float) -> Unknowns:
        """After a change (C, 10) of the cameras, and with another rim."""
        cameras = tuple(_changed(camera, one) for camera, one in zip(self.cameras, change, strict=True))
        return Unknowns(cameras, self.errors + change, rim)


class Prior(NamedTuple):
    """What is known beforehand."""

    information: FloatArray
    """(C, 10, 10) on the cameras' errors, exponents about LIKELY_EXPONENT."""
    rim: tuple[float, float]
    """Width of the rim, and its standard deviation [m]."""

    @classmethod
    def of(cls, cameras: Sequence[Camera], rim: tuple[float, float], *, focal: bool) -> Prior:
        """From what the cameras' files state, and LEAST_STD; `focal`: whether lenses may change, too."""
        information = np.zeros((len(cameras), 10, 10))
        least = np.diag(np.repeat(np.square(LEAST_STD), 3))
        for one, camera in zip(information, cameras, strict=True):
            stated = calibration_covariance(camera)
            one[EXTRINSIC, EXTRINSIC] = np.linalg.inv(stated + least)
            one[EXPONENT, EXPONENT] = EXPONENT_STD**-2
            center = CENTER_STD * camera.width
            stds = np.array([FOCAL_STD, center, center]) if focal else np.full(3, 1e-9)
            one[FOCAL, FOCAL] = np.diag(stds**-2.0)
        return cls(information, rim)


@dataclass(frozen=True, eq=False)
class Step:
    """One step of Gauss and Newton."""

    poses: FloatArray
    """(F, 6) change of each frame's pose [m, rad]."""
    change: FloatArray
    """(C, 10) of the cameras."""
    rim: float
    """The rim [m], not its change."""
    rim_std: float
    """Its standard deviation, whatever is not known of where the cameras are, with EDGES_STD [m]."""
    covariance: FloatArray
    """(C, 10, C, 10) of what is unknown of the cameras."""
    residual: float
    """Robust standard deviation of the offsets before it [px]."""
    own: float
    """Variance of what the pieces of an edge have in common [px²]."""


def solve(views: Sequence[Posed], now: Unknowns, prior: Prior) -> Step:
    """The step from what is known now; contours are those that the present cameras see."""
    count = len(now.cameras)
    left = [[None if o is None else _left(o, now, c) for c, o in enumerate(v.contours)] for v in views]
    known = [one for part in left for one in part if one is not None]
    scatter = 1.4826 * float(np.median(np.abs(np.concatenate(known))))
    limit = max(LEAST_LIMIT, TUKEY * scatter)
    rest, right = _prior(now, prior)
    own = _own_variance(views, left, limit)
    poses = []
    for view, offsets in zip(views, left, strict=True):
        held, joint, force = _frame(view, offsets, limit, own, rest, right)
        solved = np.linalg.solve(held, np.column_stack([joint, force]))
        rest -= joint.T @ solved[:, :-1]
        right -= joint.T @ solved[:, -1]
        poses.append((held, joint, force))
    # Metres, radians and pixels differ by orders of magnitude.
    unit = 1.0 / np.sqrt(np.diag(rest))
    covariance = np.linalg.inv(rest * np.outer(unit, unit)) * np.outer(unit, unit)
    found = covariance @ right
    changes = np.array([np.linalg.solve(held, force - joint @ found) for held, joint, force in poses])
    pulled = np.linalg.solve(rest[:-1, :-1], rest[:-1, -1])
    alike = max(EDGES_STD, prior.rim[1])
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


def _frame(
    view: Posed,
    offsets: Sequence[FloatArray | None],
    limit: float,
    own: float,
    rest: FloatArray,
    right: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """D (6, 6), E (6, n) and g (6,) of a frame's pose; A (n, n) and g (n,) of the rest are added to."""
    size = len(right)
    held, joint, force = _HELD.copy(), np.zeros((6, size)), np.zeros(6)
    motion = seen_motion(view.position)
    for c, (contour, left) in enumerate(zip(view.contours, offsets, strict=True)):
        if contour is None or left is None:
            continue
        found = _products(contour, motion, left, limit, own)
        its = [*range(10 * c, 10 * c + 10), size - 1]
        held += found[:6, :6]
        joint[:, its] += found[:6, 6:-1]
        force += found[:6, -1]
        rest[np.ix_(its, its)] += found[6:-1, 6:-1]
        right[its] += found[6:-1, -1]
    return held, joint, force


def relative_covariance(covariance: FloatArray) -> FloatArray:
    """(C, 6, 6) covariances of the cameras' errors (a, w), less what moves all of them alike.

    covariance: (C, 10, C, 10) of a `Step`. What is left out is where the world is, not how cameras stand to
    each other.
    """
    count = len(covariance)
    joint = covariance[:, EXTRINSIC, :, EXTRINSIC].reshape(6 * count, 6 * count)
    apart = np.kron(np.eye(count) - 1.0 / count, np.eye(6))
    relative = (apart @ joint @ apart.T).reshape(count, 6, count, 6)
    result: FloatArray = np.stack([relative[c, :, c] for c in range(count)])
    return result


def _left(contour: Contour, now: Unknowns, c: int) -> FloatArray:
    """(N,) offsets that the exponent and the rim do not explain [px]."""
    result: FloatArray = contour.offset - contour.bloom * now.errors[c, EXPONENT] - contour.rim * now.rim
    return result


def _products(contour: Contour, motion: FloatArray, left: FloatArray, limit: float, own: float) -> FloatArray:
    """(18, 18) of the columns pose, camera, rim and residual."""
    lens = np.column_stack([np.einsum("ni,ni->n", contour.normal, contour.pixel), contour.normal])
    columns = np.column_stack(
        [
            contour.jacobian,
            contour.jacobian @ motion,
            contour.bloom,
            lens / contour.scale,
            contour.rim,
            left,
        ]
    )
    return contour.information(columns, _weights(left, limit), own)


def _weights(left: FloatArray, limit: float) -> FloatArray:
    """(N,) Tukey's."""
    result: FloatArray = np.clip(1.0 - (left / limit) ** 2, 0.0, None) ** 2
    return result


def _own_variance(views: Sequence[Posed], left: Sequence[Sequence[FloatArray | None]], limit: float) -> float:
    """Variance [px²] of what the pieces of an edge have in common: what their means vary more than noise."""
    total, count = 0.0, -6.0 * len(views)  # the poses take up as many
    for view, offsets in zip(views, left, strict=True):
        for contour, its in zip(view.contours, offsets, strict=True):
            if contour is None or its is None:
                continue
            weights = _weights(its, limit) * (contour.foot == 0.0) / contour.variance
            known = np.bincount(contour.edge, weights, 12)
            seen = known > 0.0
            means = np.bincount(contour.edge, weights * its, 12)[seen] / known[seen]
            total += float((means**2 - 1.0 / known[seen]).sum())
            count += len(means)
    return max(OWN**2, total / max(count, 1.0))


def _prior(now: Unknowns, prior: Prior) -> tuple[FloatArray, FloatArray]:
    """(n, n) information on the rest, the cameras one after the other and the rim, and (n,) its pull."""
    size = 10 * len(now.cameras) + 1
    rest, right = np.zeros((size, size)), np.zeros(size)
    for c, information in enumerate(prior.information):
        its = slice(10 * c, 10 * c + 10)
        off = now.errors[c].copy()
        off[EXPONENT] -= LIKELY_EXPONENT
        rest[its, its] = information
        right[its] = -information @ off
    rest[-1, -1] = prior.rim[1] ** -2.0
    right[-1] = (prior.rim[0] - now.rim) / prior.rim[1] ** 2
    return rest, right


def _changed(camera: Camera, change: FloatArray) -> Camera:
    """A camera with a change (10,) of what is unknown of it."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = so3.exp(change[3:6]), change[:3]
    transform = camera.camera_from_world @ transform
    transform[:3, :3] = so3.nearest_rotation(transform[:3, :3])
    matrix = camera.matrix.copy()
    matrix[(0, 1), (0, 1)] *= np.exp(change[FOCAL][0])
    matrix[:2, 2] += change[FOCAL][1:]
    return dataclasses.replace(camera, matrix=matrix, camera_from_world=transform)
