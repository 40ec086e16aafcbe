"""Sub-pixel refinement on the edges' colour profiles in the full images.

Across each edge sample a profile of colours is read. Its two ends give the colours of the two
surfaces (smoothed along the edge), and projected on the line between them the profile becomes a step
from 0 to 1. A matched filter turns the step's deviation from one centred on the predicted edge into
an offset in pixels: symmetric blur does not bias it, and gains, exposure and shading cancel. The
idea of local colour statistics on both sides of a contour is that of R. Hanek and M. Beetz, "The
Contracting Curve Density Algorithm", IJCV 59(3), 2004; here with a closed-form offset for each
sample and robust weights instead of pixel-wise densities.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from tracker.pose.edges import (
    COLUMNS,
    INSIDE,
    MAX_SAMPLES,
    NU,
    NV,
    OUTSIDE,
    REACH_IN,
    REACH_OUT,
    J,
    U,
    V,
    edge_samples,
    solve6,
)
from tracker.pose.lens import apply_update

MIN_CONTRAST = 14.0
"""Least distance between the two surfaces' colours [levels]."""

NOISE = 3.0
"""Standard deviation assumed of a pixel's channel [levels]; the residuals' scale corrects it."""

MAX_REACH = 24


class Window(NamedTuple):
    """How one refinement step reads the profiles."""

    reach: int
    """Half length of a profile [px]."""
    blur: float
    """Standard deviation of the assumed step [px]."""
    tukey: float
    """Residual at which a sample's weight reaches zero [px]."""
    floor: float
    """Variance that noise does not explain [px²]."""
    spacing: float
    """Distance of samples along an edge [px]."""
    margin: float
    """Distance that samples keep from corners, where three surfaces mix [px]."""


OFFSET, VARIANCE, VALID = 0, 1, 2
"""Columns of a measurement: offset along the normal [px], its variance from noise [px²], 1 if usable."""


@numba.njit(cache=True, nogil=True, inline="always")
def _bilinear(image, u, v, out):  # type: ignore[no-untyped-def]
    i, j = int(math.floor(u)), int(math.floor(v))
    a, b = u - i, v - j
    w00, w10, w01, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    for k in range(3):
        out[k] = (
            w00 * image[j, i, k] + w10 * image[j, i + 1, k] + w01 * image[j + 1, i, k] + w11 * image[j + 1, i + 1, k]
        )


@numba.njit(cache=True, nogil=True)
def measure(image, channels, table, samples, n, reach, blur, noise, profiles, ends, out):  # type: ignore[no-untyped-def]
    """Offsets of n edge samples: out (n, 3), see OFFSET.

    reach: half length of the profile [px]; blur: standard deviation assumed for the step [px];
    noise: of a pixel's channel [levels]; profiles (MAX_SAMPLES, 2·MAX_REACH + 1, 3), ends
    (MAX_SAMPLES, 8): work space.
    """
    height, width = image.shape[0], image.shape[1]
    size = 2 * reach + 1
    for s in range(n):
        row = samples[s]
        out[s, VALID] = 0.0
        ends[s, 7] = 0.0
        span = min(float(reach), row[REACH_IN] - 0.7, row[REACH_OUT] - 0.7)
        u0, v0 = row[U] - reach * row[NU], row[V] - reach * row[NV]
        u1, v1 = row[U] + reach * row[NU], row[V] + reach * row[NV]
        if min(u0, u1) < 0 or min(v0, v1) < 0 or max(u0, u1) >= width - 1 or max(v0, v1) >= height - 1:
            continue
        for k in range(size):
            t = k - reach
            _bilinear(image, row[U] + t * row[NU], row[V] + t * row[NV], profiles[s, k])
        # The surface inside must be the face: a finger's edge is none of the object's.
        last = int(span)
        if last < 2:
            continue
        fits_in, fits_out = 0, 0
        for k in range(last - 1, last + 1):
            p, q = profiles[s, reach - k], profiles[s, reach + k]
            cell = channels[0, int(p[0] + 0.5)] + channels[1, int(p[1] + 0.5)] + channels[2, int(p[2] + 0.5)]
            fits_in += table[cell] == row[INSIDE]
            cell = channels[0, int(q[0] + 0.5)] + channels[1, int(q[1] + 0.5)] + channels[2, int(q[2] + 0.5)]
            fits_out += table[cell] == row[OUTSIDE] or (row[OUTSIDE] == 0 and table[cell] != row[INSIDE])
        if fits_in == 0 or fits_out == 0:
            continue
        for k in range(3):
            ends[s, k] = 0.5 * (profiles[s, reach - last, k] + profiles[s, reach - last + 1, k])
            ends[s, 3 + k] = 0.5 * (profiles[s, reach + last, k] + profiles[s, reach + last - 1, k])
        ends[s, 6] = last
        ends[s, 7] = 1.0
    inside, outside = np.empty(3), np.empty(3)
    for s in range(n):
        if ends[s, 7] == 0.0:
            continue
        row = samples[s]
        # Smooth both colours along the edge: neighbours are the same surface, the noise is not.
        inside[:], outside[:] = 0.0, 0.0
        total = 0.0
        for d in range(-2, 3):
            q = s + d
            if q < 0 or q >= n or ends[q, 7] == 0.0:
                continue
            if samples[q, INSIDE] != row[INSIDE] or samples[q, OUTSIDE] != row[OUTSIDE]:
                continue
            if samples[q, NU] * row[NU] + samples[q, NV] * row[NV] < 0.9:
                continue
            for k in range(3):
                inside[k] += ends[q, k]
                outside[k] += ends[q, 3 + k]
            total += 1.0
        contrast = 0.0
        for k in range(3):
            inside[k] /= total
            outside[k] /= total
            contrast += (outside[k] - inside[k]) ** 2
        if contrast < MIN_CONTRAST**2:
            continue
        last = int(ends[s, 6])
        shift, gain, energy = 0.0, 0.0, 0.0
        for t in range(-last, last + 1):
            m = 0.0
            for k in range(3):
                m += (profiles[s, reach + t, k] - inside[k]) * (outside[k] - inside[k])
            m = min(1.4, max(-0.4, m / contrast))
            x = t / blur
            window = math.exp(-0.5 * x * x)
            slope = window / (blur * math.sqrt(2.0 * math.pi))
            step = 0.5 * (1.0 + math.erf(x / math.sqrt(2.0)))
            shift += window * (step - m)
            gain += window * slope
            energy += window * window
        offset = shift / gain
        # Beyond the window the linear filter saturates; a residual that large is not this edge.
        out[s, OFFSET] = min(float(last), max(-float(last), offset))
        # Noise of the profile, and of the two end colours, each a mean of about 2·total readings.
        relative = noise * noise / contrast
        out[s, VARIANCE] = relative * (energy + (gain * blur * 2.5) ** 2 / (4.0 * total)) / (gain * gain)
        out[s, VALID] = 1.0


@numba.njit(cache=True, nogil=True)
def accumulate(samples, measured, n, tukey, floor, matrix, vector, summary):  # type: ignore[no-untyped-def]
    """Add n weighted measurements to the normal equations (6, 6), (6,).

    tukey: residual [px] at which the weight reaches zero; floor: variance [px²] of what noise does not
    explain. summary (4,) gains: samples, usable ones, weights of the inliers, their weighted squared residuals.
    """
    for s in range(n):
        summary[0] += 1.0
        if measured[s, VALID] == 0.0:
            continue
        summary[1] += 1.0
        r = measured[s, OFFSET]
        if abs(r) >= tukey:
            continue
        robust = (1.0 - (r / tukey) ** 2) ** 2
        summary[2] += robust
        summary[3] += robust * r * r
        weight = robust / (floor + measured[s, VARIANCE])
        for i in range(6):
            ji = samples[s, J + i]
            vector[i] += weight * ji * r
            for k in range(i + 1):
                matrix[i, k] += weight * ji * samples[s, J + k]


@numba.njit(cache=True, nogil=True)
def refine_view(lenses, c, view, table, box, rotation, position, window, work, matrix, vector, summary):  # type: ignore[no-untyped-def]
    """Measure one camera's edges at a pose and fill its normal equations (6, 6), (6,) and summary (4,)."""
    samples, profiles, ends, measured = work
    matrix[:], vector[:], summary[:] = 0.0, 0.0, 0.0
    n = edge_samples(
        lenses, c, box.half, box.face_labels, rotation, position, window.spacing, window.margin, samples
    )
    measure(
        view.image, view.channels, table, samples, n, window.reach, window.blur, NOISE, profiles, ends, measured
    )
    accumulate(samples, measured, n, window.tukey, window.floor, matrix, vector, summary)


@numba.njit(cache=True, nogil=True)
def step_pose(matrix, vector, rotation, position):  # type: ignore[no-untyped-def]
    """Solve the normal equations (lower half given) and move the pose; returns the step's length [px-like], -1 if none."""
    update = np.empty(6)
    for i in range(6):
        # A prior of 3 cm and 0.3 rad against 1 px keeps unseen directions where they are.
        matrix[i, i] += 1e3 if i < 3 else 10.0
        for k in range(i):
            matrix[k, i] = matrix[i, k]
    if not solve6(matrix, vector, update):
        return -1.0
    length = math.sqrt(update[0] ** 2 + update[1] ** 2 + update[2] ** 2)
    turn = math.sqrt(update[3] ** 2 + update[4] ** 2 + update[5] ** 2)
    limit = max(length / 0.02, turn / 0.3, 1.0)
    for i in range(6):
        update[i] /= limit
    apply_update(rotation, position, update)
    return length + 0.05 * turn


def workspace() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Arrays that `measure` works in: samples, profiles, ends, measurements."""
    return (
        np.empty((MAX_SAMPLES, COLUMNS)),
        np.empty((MAX_SAMPLES, 2 * MAX_REACH + 1, 3)),
        np.empty((MAX_SAMPLES, 8)),
        np.empty((MAX_SAMPLES, 3)),
    )


