"""Refinement on the edges' offsets in the full images: from measurements to a better pose."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.pose.edges import COLUMNS, MAX_SAMPLES, J, edge_samples
from tracker.pose.profile import BLUR, MAX_REACH, OFFSET, VALID, VARIANCE, measure, read_profiles

NOISE = 3.0
"""Standard deviation assumed of a pixel's channel [levels]; the residuals' scale corrects it."""

EXPECTED, USABLE, INLIERS, SQUARES, BLURS, BLUR_SUM = range(6)
"""Columns of a summary: samples, usable ones, inlier weight, inliers' weighted squared residuals [px²],
count and sum of the blurs measured [px]."""


class Window(NamedTuple):
    """How one refinement step reads the profiles."""

    reach: int
    """Half length of a profile [px]."""
    blur: float
    """Standard deviation of the image's steps [px]."""
    tukey: float
    """Residual at which a sample's weight reaches zero [px]."""
    floor: float
    """Variance that noise does not explain [px²]."""
    spacing: float
    """Distance of samples along an edge [px]."""
    margin: float
    """Distance that samples keep from corners, where three surfaces mix [px]."""


class Workspace(NamedTuple):
    """Arrays that a refinement step works in, made once."""

    samples: FloatArray
    profiles: FloatArray
    readable: Array
    measured: FloatArray

    def residuals(self, count: int) -> FloatArray:
        """Absolute offsets [px] of the usable ones among the first `count` samples."""
        measured = self.measured[:count]
        offsets: FloatArray = np.abs(measured[measured[:, VALID] > 0, OFFSET])
        return offsets


def workspace() -> Workspace:
    """A new work space."""
    return Workspace(
        np.empty((MAX_SAMPLES, COLUMNS)),
        np.empty((MAX_SAMPLES, 2 * MAX_REACH + 1, 3)),
        np.empty(MAX_SAMPLES, np.bool_),
        np.empty((MAX_SAMPLES, 4)),
    )


@numba.njit(cache=True, nogil=True)
def accumulate(samples, measured, n, tukey, floor, matrix, vector, summary):  # type: ignore[no-untyped-def]
    """Add n weighted measurements to the normal equations (6, 6), (6,) and the summary (6,)."""
    for s in range(n):
        summary[EXPECTED] += 1.0
        if measured[s, VALID] == 0.0:
            continue
        summary[USABLE] += 1.0
        r = measured[s, OFFSET]
        if measured[s, BLUR] > 0.0:
            summary[BLURS] += 1.0
            summary[BLUR_SUM] += measured[s, BLUR]
        if abs(r) >= tukey:
            continue
        robust = (1.0 - (r / tukey) ** 2) ** 2
        summary[INLIERS] += robust
        summary[SQUARES] += robust * r * r
        weight = robust / (floor + measured[s, VARIANCE])
        for i in range(6):
            ji = samples[s, J + i]
            vector[i] += weight * ji * r
            for k in range(i + 1):
                matrix[i, k] += weight * ji * samples[s, J + k]


@numba.njit(cache=True, nogil=True)
def refine_view(lenses, c, view, table, box, rotation, position, window, work, matrix, vector, summary):  # type: ignore[no-untyped-def]
    """Measure one camera's edges at a pose and fill its normal equations (6, 6), (6,) and summary (6,)."""
    matrix[:], vector[:], summary[:] = 0.0, 0.0, 0.0
    n = edge_samples(
        lenses, c, box.half, box.face_labels, rotation, position, window.spacing, window.margin, work.samples
    )
    read_profiles(view.image, work.samples, n, window.reach, work.profiles, work.readable)
    measure(
        view.channels, table, work.samples, n, window.reach, window.blur, NOISE,
        work.profiles, work.readable, work.measured,
    )  # fmt: skip
    accumulate(work.samples, work.measured, n, window.tukey, window.floor, matrix, vector, summary)
