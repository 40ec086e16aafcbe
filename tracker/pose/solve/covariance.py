"""From the information of the edges to an honest covariance."""

from __future__ import annotations

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.pose.solve.step import EXPONENT, OWN

PRIOR = np.array([3.0] * 3 + [10.0] * 3)
"""Information of a prior of 0.6 radii of the object and 0.3 rad around the present pose, which holds unseen
directions; of positions in units of the radius."""

DEVIATION_STD = 0.13
"""Standard deviation of a camera's exponent of response around that of all."""

MODEL_STD = 4e-4, 3e-4
"""What no number of samples averages away: edge lengths, unmodelled optics [radii of the object, rad]."""


@compiled
def offset_weights(calibration_information, position):  # type: ignore[no-untyped-def]
    """(C, 7, 7) inverse covariance of what each camera has of its own: offsets [m, rad] and exponent.

    This is equation (15) of docs/how-it-works.md.
    An error (δt, ω) of camera_from_world moves a point in the camera by δt + ω × (R P), which is what
    an object at `position` would show if it had moved by δp + δθ × (P - position) along world axes, with
    δθ = Rᵀω and δp = Rᵀδt + δθ × position. calibration_information (C, 6, 6) is the inverse of
    `calibration.deviations.calibration_covariance`.
    """
    back = np.eye(6)
    x, y, z = position[0], position[1], position[2]
    back[0, 4], back[0, 5], back[1, 3] = -z, y, z
    back[1, 5], back[2, 3], back[2, 4] = -x, -y, x
    out = np.zeros((len(calibration_information), OWN, OWN))
    for c in range(len(out)):
        out[c, EXPONENT, EXPONENT] = 1.0 / DEVIATION_STD**2
        for i in range(6):
            for j in range(6):
                out[c, i, j] = 0.0
                for k in range(6):
                    for m in range(6):
                        out[c, i, j] += back[k, i] * calibration_information[c, k, m] * back[m, j]
    return out


def with_model_errors(covariance: FloatArray, radius: float) -> FloatArray:
    """The covariance (6, 6) of a pose with what no number of samples averages away; radius: of the object.

    This is equation (19) of docs/how-it-works.md.
    """
    result: FloatArray = 0.5 * (covariance + covariance.T)
    diagonal = result.ravel()[::7]
    diagonal[:3] += (MODEL_STD[0] * radius) ** 2
    diagonal[3:] += MODEL_STD[1] ** 2
    return result
