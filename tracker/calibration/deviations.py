"""Convert the standard deviations in a calibration file to the covariance of a camera's errors, and back.

If camera_from_world is R, t and the truth is exp(ω) R, t + δt, the camera sees a point P of the world as if
the world had moved by a = Rᵀδt and w = Rᵀω: R (exp(w) P + a) + t. Covariances are those of (a, w) [m, rad],
along world axes.
"""

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera

UNSTATED_STD = np.full((4, 4), 1e-7)
"""Element-wise standard deviation of a transform whose file states none; it counts as exact."""

LEAST_VARIANCE = 1e-14
"""Smallest variance of a calibration: that of a ten-thousandth of a millimetre or milliradian [m², rad²]."""


def rotation_slopes(rotation: FloatArray) -> FloatArray:
    """Return the derivatives (3, 3, 3) of exp(ω) R with respect to each ω_k at ω = 0: [e_k]× R."""
    return so3.hat(np.eye(3)) @ rotation


def rotation_vector_variance(rotation: FloatArray, element_std: FloatArray) -> FloatArray:
    """Return the variances (3,) of ω in exp(ω) R that best explain element-wise standard deviations (3, 3).

    The squares of these deviations are linear in the variances, which are solved for under the constraint
    that none is negative.
    """
    design = rotation_slopes(rotation).reshape(3, 9).T ** 2
    variances = np.asarray(element_std).ravel() ** 2
    solution = np.asarray(np.linalg.lstsq(design, variances, rcond=None)[0], dtype=np.float64)
    if solution.min() < 0.0:
        # Imported here since it is hardly ever needed, and takes a fifth of the time to the first pose.
        from scipy.optimize import nnls

        solution = nnls(design, variances)[0]
    return solution


def is_stated(camera: Camera) -> bool:
    """Return whether a calibration states deviations; if not, it counts as exact."""
    return camera.camera_from_world_std is not None and bool(camera.camera_from_world_std.any())


def calibration_covariance(camera: Camera, power: int = 1) -> FloatArray:
    """Return the covariance (6, 6) of (Rᵀδt, Rᵀω) [m, rad], for errors δt and exp(ω) of camera_from_world.

    power: -1 for its inverse, exact even where deviations differ by orders of magnitude.
    """
    std = camera.camera_from_world_std
    if std is None:
        std = UNSTATED_STD
    rotation = camera.camera_from_world[:3, :3]
    variances = np.concatenate([std[:3, 3] ** 2, rotation_vector_variance(rotation, std[:3, :3])])
    turned = np.zeros((6, 6))
    turned[:3, :3] = turned[3:, 3:] = rotation.T
    out = turned @ np.diag(np.maximum(variances, LEAST_VARIANCE) ** power) @ turned.T
    return np.asarray((out + out.T) / 2)


def element_std(rotation: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the element-wise deviations (4, 4) of a transform with a rotation (3, 3) and covariance (6, 6).

    Inverse of `calibration_covariance`, for covariances whose principal axes are the camera's.
    """
    turned = np.kron(np.eye(2), rotation)
    variances = np.diag(turned @ covariance @ turned.T)
    out = np.zeros((4, 4))
    out[:3, 3] = np.sqrt(variances[:3])
    out[:3, :3] = np.sqrt(np.tensordot(variances[3:], rotation_slopes(rotation) ** 2, axes=1))
    return out
