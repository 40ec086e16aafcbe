"""The Cramér-Rao bound: how near to the truth the edges in view allow any unbiased estimate to come.

Every pixel of visible edge tells the edge's place across itself with a standard deviation σ. With the
derivatives J of these places with respect to the pose, all of them hold the information Σ JᵀJ / σ², whose
inverse no unbiased estimate's covariance undercuts. An uncertain calibration is a further unknown of each
camera, of which the stated standard deviations tell something, and is marginalised.

σ is measured at each edge of each picture. The picture is sampled on lines across the edge, half a pixel
apart; the mean over all lines is the profile I(t), and what a line deviates from the mean of its neighbours
is noise of variance s²(t), for each channel. An estimate from independent noise then has
1/σ² = Σ_channels ∫ I'(t)² / s²(t) dt. Rows of the mosaic, dirt and texture count as noise. The samples along
an edge are taken to be independent; what is found by shifting the profile to fit each line has the same
long-run variance within about 20 %.

A second bound takes σ = 0.3 px everywhere, which is what edges of hard labels give.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from benchmarks.data.disturbances import SHIFT_STD, TURN_STD, moved_rig
from benchmarks.data.workloads import Case
from benchmarks.score.edges import EdgeSamples, edge_samples
from tracker.conventions import FloatArray, Image
from tracker.objects.model import CuboidModel

FIXED_SIGMA = 0.3
"""Edge noise of the second bound [px]."""

REACH, SPACING = 4.0, 0.5
"""Half the length of the lines across an edge, and the distance of samples on them [px]."""

NEIGHBOURS = 9
"""Lines whose mean the noise is a deviation from, the line itself included."""

FEWEST = 8
"""Visible lines from which on an edge's noise is measured; shorter ones take the picture's median."""

LEAST_VARIANCE = 1 / 12
"""Of rounding to whole values."""

MOST_CONDITION = 1e12
"""Condition number of the information [m, rad] beyond which the edges do not fix a pose."""


def scene_edges(case: Case, model: CuboidModel) -> list[list[EdgeSamples]]:
    """The visible edges of each camera; workloads of one scene share them."""
    scene = case.scene
    assert scene.position is not None
    assert scene.rotation is not None
    return [
        edge_samples(camera, model, labels, scene.position, scene.rotation)
        for camera, labels in zip(case.true_rig, scene.labels, strict=True)
    ]


def bounds(case: Case, edges: Sequence[Sequence[EdgeSamples]]) -> tuple[float, float, float, float]:
    """Bounds of position [m] and rotation [rad], with measured and with fixed edge noise.

    Each is the square root of the trace of its block of the covariance; nan where the edges in view do not
    fix the pose.
    """
    measured, fixed = np.zeros((6, 6)), np.zeros((6, 6))
    for k in case.used:
        image = case.images[k]
        assert image is not None
        sigmas = edge_noise(image, edges[k])
        prior = calibration_information(case)
        measured += information(edges[k], sigmas, prior)
        fixed += information(edges[k], np.full(len(sigmas), FIXED_SIGMA), prior)
    return (*root_traces(measured), *root_traces(fixed))


def calibration_information(case: Case) -> FloatArray | None:
    """Inverse variances (6,) of (δt, ω) of a camera that was moved; None: it is exact."""
    moved = case.workload.believed is moved_rig
    return np.repeat([SHIFT_STD**-2, TURN_STD**-2], 3) if moved else None


def information(
    edges: Sequence[EdgeSamples], sigmas: FloatArray, calibration: FloatArray | None = None
) -> FloatArray:
    """Information (6, 6) of one camera's edges of noise (E,) [px] on the pose, along world axes.

    Args:
        edges: of one camera.
        sigmas: noise of each [px].
        calibration: inverse variances (6,) of the camera's unknown (δt, ω); None: it is exact.
    """
    full = np.zeros((12, 12))
    for edge, sigma in zip(edges, sigmas, strict=True):
        rows = np.concatenate([edge.jacobian, edge.by_camera], axis=1)[edge.visible] / sigma
        full += rows.T @ rows
    if calibration is None:
        return full[:6, :6]
    own = full[6:, 6:] + np.diag(calibration)
    result: FloatArray = full[:6, :6] - full[:6, 6:] @ np.linalg.solve(own, full[6:, :6])
    return result


def root_traces(total: FloatArray) -> tuple[float, float]:
    """Square roots of the traces of the inverse's two blocks [m, rad]; nan where there is no inverse."""
    if not np.linalg.cond(total) < MOST_CONDITION:
        return float("nan"), float("nan")
    variances = np.diag(np.linalg.inv(total))
    return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))


def edge_noise(image: Image, edges: Sequence[EdgeSamples]) -> FloatArray:
    """Standard deviation (E,) [px] with which each pixel of each edge tells the edge's place."""
    found = np.array([_own_noise(image, edge) for edge in edges])
    known = np.isfinite(found)
    return np.where(known, found, np.median(found[known]) if known.any() else FIXED_SIGMA)


def _own_noise(image: Image, edge: EdgeSamples) -> float:
    """That of one edge [px]; nan where too little of it is in view or no step shows."""
    count = int(edge.visible.sum())
    if count < FEWEST:
        return float("nan")
    offsets = np.arange(-REACH, REACH + SPACING / 2, SPACING)
    lines = profiles(image, edge, offsets)
    mean = cv2.blur(lines.reshape(count, -1), (1, NEIGHBOURS)).reshape(lines.shape)
    variance = ((lines - mean) ** 2).mean(axis=0) * NEIGHBOURS / (NEIGHBOURS - 1)
    variance = np.maximum(variance, LEAST_VARIANCE)
    slope = np.gradient(lines.mean(axis=0), SPACING, axis=0)
    # The mean over few lines is itself noisy, and its differences over 2 SPACING look like slopes.
    spurious = 2 * variance / count / (2 * SPACING) ** 2
    total = float((SPACING * (slope**2 - spurious) / variance).sum())
    return total**-0.5 if total > 0 else float("nan")


def profiles(image: Image, edge: EdgeSamples, offsets: FloatArray) -> FloatArray:
    """Values (N, T, 3) at `offsets` (T,) [px] across the visible samples of an edge."""
    places = edge.pixels[:, None] + offsets[None, :, None] * edge.normals[:, None]
    x, y = places[edge.visible].astype(np.float32).transpose(2, 0, 1)
    source = image.astype(np.float32)
    values = cv2.remap(source, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float64)
