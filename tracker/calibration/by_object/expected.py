"""What misses a calibration's stated deviations let expect, and what a lens leaves open.

A camera k whose error is ξ_k (see `looks`) sees an object at P moved by -G ξ_k. Against the pose of the
others camera c then sees it moved by d = -Σ_k M_k G ξ_k, with M_c = 1 and M_k the share of k in that pose,
negative. A corner moves by A d in the picture, with A its Jacobian, so what stated covariances Σ_k let expect
of its square is the trace of A Σ_k (M_k G Σ_k Gᵀ M_kᵀ) Aᵀ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.by_object.looks import CameraErrors, Look
from tracker.calibration.deviations import calibration_covariance
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera

FOCAL = 295.0
"""Focal length of the pictures in whose pixels cameras are compared, whatever their own [px]."""

SQUARE = 0.003
"""Share by which the two focal lengths of a camera may differ: those of a board's photos differ by 0.001."""

DEPTH = 2e-3
"""Error of one camera's depth for which the needed accuracy of its focal length is given [m]."""


@dataclass(frozen=True)
class Corners:
    """By how much a camera misses the object's corners where the others have them.

    Of each look the root mean square over the corners, of those the median [px at FOCAL]; NaN: not asked.
    """

    seen: float
    """What the looks show."""
    shift: float
    """The part of it that the corners of a look have in common: where the object is."""
    shape: float
    """The rest: how large the object is, and how it is turned."""
    stated: float
    """What the deviations that the cameras' files state let expect; NaN where one states none."""


@dataclass(frozen=True)
class FocalCheck:
    """What a focal length leaves open of the depth that a camera alone sees."""

    ratio: float
    """Of the focal lengths, fy over fx."""
    off: float
    """Share by which the focal length may be off: the deviation that the camera's file states, at least half
    of what the two focal lengths differ by."""
    distance: float
    """From the camera to the object, median over the looks [m]; NaN: not asked."""

    @property
    def depth(self) -> float:
        """Error of the camera's depth that follows [m]."""
        return self.off * self.distance

    @property
    def needed(self) -> float:
        """Share to which the focal length must be right for an error of DEPTH."""
        return DEPTH / self.distance

    @property
    def is_square(self) -> bool:
        """Whether pixels are as high as wide, within SQUARE."""
        return abs(self.ratio - 1.0) <= SQUARE


def corner_misses(looks: Sequence[Look], cameras: Sequence[Camera], problem: CameraErrors) -> list[Corners]:
    """What each camera misses of the corners, and what was to be expected."""
    stated = all(one.camera_from_world_std is not None and one.camera_from_world_std.any() for one in cameras)
    covariances = np.array([calibration_covariance(one) for one in cameras])
    result = []
    for c, camera in enumerate(cameras):
        rows = []
        for f, look in enumerate(looks):
            shares = problem.shares(f, c)
            if shares is None:
                continue
            motion = _corner_motion(camera, look)
            moves = (motion @ np.einsum("kij,kj->i", shares, look.moved)).reshape(-1, 2)
            shift = moves.mean(axis=0)
            feigned = motion @ shares @ problem.lever[f]
            expected = np.einsum("kni,kij,knj->", feigned, covariances, feigned) / len(moves)
            rows.append(
                [(moves**2).sum(1).mean(), shift @ shift, ((moves - shift) ** 2).sum(1).mean(), expected]
            )
        seen, shift, shape, expected = np.sqrt(np.median(rows, axis=0)) if rows else [float("nan")] * 4
        result.append(
            Corners(float(seen), float(shift), float(shape), float(expected) if stated else float("nan"))
        )
    return result


def focal_check(camera: Camera, distances: FloatArray, focal_std: Mapping[str, float]) -> FocalCheck:
    """What a camera's lens leaves open at distances (N,) [m]; `focal_std`: see `check_calibration`."""
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    off = max(abs(fy / fx - 1.0) / 2.0, focal_std.get(camera.name, 0.0))
    return FocalCheck(
        float(fy / fx), float(off), float(np.median(distances)) if len(distances) else float("nan")
    )


def _corner_motion(camera: Camera, look: Look) -> FloatArray:
    """(2 N, 6) motion of a look's corners in a camera's picture with the object's pose [px at FOCAL]."""
    _, jacobian = camera.project_with_jacobian(look.corners)
    swing = np.stack([-so3.hat(arm) for arm in look.corners - look.position])
    motion = np.concatenate([jacobian, jacobian @ swing], axis=2)
    motion *= FOCAL / camera.matrix[(0, 1), (0, 1)][:, None]
    return np.asarray(motion.reshape(-1, 6))
