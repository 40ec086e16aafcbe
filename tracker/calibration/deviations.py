"""What a calibration file states of a camera's errors, as a covariance and back.

An error (δt, ω) of camera_from_world, which is exp(ω) R and t + δt in truth, moves a point P of the world in
the camera as if the world had moved by a = Rᵀδt and w = Rᵀω: R (exp(w) P + a) + t. Covariances are of (a, w)
[m, rad], along world axes.
"""

from __future__ import annotations

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera

UNSTATED_STD = np.full((4, 4), 1e-7)
"""Element-wise standard deviation of a transform whose file states none: taken as exact."""

LEAST_VARIANCE = 1e-14
"""A calibration is never taken to be more exact than a ten-thousandth of a millimetre or milliradian."""


def rotation_vector_variance(rotation: FloatArray, element_std: FloatArray) -> FloatArray:
    """Variances (3,) of ω in exp(ω) R that come nearest to element-wise standard deviations (3, 3).

    Element (i, j) of [e_k]× R tells how much it moves with ω_k, so the squares of the given standard
    deviations are linear in the variances; they are solved for with the constraint of being positive.
    """
    design = np.stack([(so3.hat(axis) @ rotation).ravel() ** 2 for axis in np.eye(3)], axis=1)
    variances = np.asarray(element_std).ravel() ** 2
    solution = np.asarray(np.linalg.lstsq(design, variances, rcond=None)[0], dtype=np.float64)
    if solution.min() < 0.0:
        # Imported where it is needed, which is hardly ever: a fifth of the time to the first pose.
        from scipy.optimize import nnls

        solution = nnls(design, variances)[0]
    return solution


def is_stated(camera: Camera) -> bool:
    """Whether a calibration states deviations; else it is taken as exact."""
    return camera.camera_from_world_std is not None and bool(camera.camera_from_world_std.any())


def calibration_covariance(camera: Camera) -> FloatArray:
    """(6, 6) covariance of (Rᵀδt, Rᵀω) [m, rad], where camera_from_world is off by δt and exp(ω)."""
    std = camera.camera_from_world_std
    if std is None:
        std = UNSTATED_STD
    rotation = camera.camera_from_world[:3, :3]
    variances = np.concatenate([std[:3, 3] ** 2, rotation_vector_variance(rotation, std[:3, :3])])
    turned = np.zeros((6, 6))
    turned[:3, :3] = turned[3:, 3:] = rotation.T
    return turned @ np.diag(np.maximum(variances, LEAST_VARIANCE)) @ turned.T


def turned_std(rotation: FloatArray, std: FloatArray, turned: FloatArray) -> FloatArray:
    """(3, 3) element-wise standard deviations of a rotation that is now `turned` (3, 3), errors as before."""
    variances = rotation_vector_variance(rotation, std)
    moved = np.stack([so3.hat(axis) @ turned for axis in np.eye(3)])
    out: FloatArray = np.sqrt(np.tensordot(variances, moved**2, axes=1))
    return out


def element_std(rotation: FloatArray, covariance: FloatArray) -> FloatArray:
    """(4, 4) element-wise standard deviations of a transform with rotation (3, 3) and a covariance (6, 6).

    The inverse of `calibration_covariance`, for covariances whose axes are the camera's.
    """
    turned = np.kron(np.eye(2), rotation)
    variances = np.diag(turned @ covariance @ turned.T)
    out = np.zeros((4, 4))
    out[:3, 3] = np.sqrt(variances[:3])
    moved = np.stack([so3.hat(axis) @ rotation for axis in np.eye(3)])
    out[:3, :3] = np.sqrt(np.tensordot(variances[3:], moved**2, axes=1))
    return out
