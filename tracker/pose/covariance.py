"""From the information of the edges to an honest covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera

CORRELATION = 1.5
"""Neighbouring samples of an edge share blur, mosaic and model errors: σ is larger than if they did not."""

MODEL_STD = np.array([2e-5, 2e-5, 2e-5, 3e-4, 3e-4, 3e-4])
"""What no number of samples averages away: edge lengths, unmodelled optics [m, rad]."""


def rotation_vector_variance(rotation: FloatArray, element_std: FloatArray) -> FloatArray:
    """Variances (3,) of ω in exp(ω) R whose element-wise standard deviations come nearest to those given (3, 3).

    Element (i, j) of [e_k]× R tells how much it moves with ω_k, so the squares of the given standard
    deviations are linear in the variances; they are solved for with the constraint of being positive.
    """
    design = np.stack([(so3.hat(axis) @ rotation).ravel() ** 2 for axis in np.eye(3)], axis=1)
    solution, _ = nnls(design, np.asarray(element_std).ravel() ** 2)
    return np.asarray(solution)


def calibration_covariance(camera: Camera) -> FloatArray | None:
    """(6, 6) covariance of a camera's (translation, rotation) error along world axes, None where not stated.

    The error moves a point in the camera by δt + ω × (R P); it is turned to world axes so that it
    adds to the object's own motion.
    """
    std = camera.camera_from_world_std
    if std is None:
        return None
    rotation = camera.camera_from_world[:3, :3]
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = rotation.T @ np.diag(std[:3, 3] ** 2) @ rotation
    variances = rotation_vector_variance(rotation, std[:3, :3])
    covariance[3:, 3:] = rotation.T @ np.diag(variances) @ rotation
    return covariance


def pose_covariance(
    information: FloatArray,
    position: FloatArray,
    residual_scale: float,
    calibration: Sequence[FloatArray | None],
) -> FloatArray:
    """Covariance (6, 6) of a pose from each camera's information (C, 6, 6) at an assumed noise.

    residual_scale: how many times larger than assumed the residuals are. calibration: each camera's
    (6, 6) covariance or None. A camera's error ξ moves its residuals as if the object had moved by
    M ξ, where M shifts the centre of rotation from the object to the world's origin; it moves the
    pose by H⁻¹ H_c M ξ.
    """
    total = information.sum(axis=0) + np.diag([1e3] * 3 + [10.0] * 3)
    inverse = np.linalg.inv(total)
    covariance = inverse * (CORRELATION * max(residual_scale, 1.0)) ** 2 + np.diag(MODEL_STD**2)
    shift = np.eye(6)
    shift[:3, 3:] = -so3.hat(position)
    for own, stated in zip(information, calibration, strict=True):
        if stated is not None:
            effect = inverse @ own @ shift
            covariance += effect @ stated @ effect.T
    return 0.5 * (covariance + covariance.T)
