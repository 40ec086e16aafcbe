"""Refine a hypothesis on the images' contours, with an offset for each camera's calibration error."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.pose import align, contour
from tracker.pose.covariance import (
    CORRELATION,
    PRIOR,
    calibration_covariance,
    offset_covariance,
    pose_covariance,
    solve_step,
)
from tracker.pose.fit import Fit
from tracker.pose.lens import apply_update
from tracker.pose.profile import MAX_REACH
from tracker.pose.views import ALIGN_SIZE, Box, Evidence, reduced_size, stack_lenses

FINE_REACHES = np.array([6, 6, 5, 4])
"""Reach of the label transitions' search in each alignment step [px of the finer label map]."""

LABELLED = 1.5
"""How far around the object its finer label map reaches, in its radii."""

REFERENCE_FOCAL = 295.0
"""Focal length [px] at which lengths in the refinement are stated: the platform's at 270×270."""

REACHES = (5.0, 5.0, 4.0, 3.2)
"""Half length of the profiles in each step, the last for all that follow [px at the reference]."""

ASSUMED_SPREAD = 0.12
"""Standard deviation of an edge's place that noise does not explain [px at the reference]."""

TUKEY, MIN_TUKEY = 4.685, 0.5
"""Residual at which a sample's weight reaches zero: in robust standard deviations, and at least [px]."""

FREEZE_SPREAD = 5
"""Steps after which the residuals' scale stays: a scale that follows the weights converges slowly."""

START_BLUR, MIN_BLUR, MAX_BLUR = 0.9, 0.5, 3.0
"""Blur of the image's steps before it is measured, and its bounds [px at the reference]."""

MIN_BLURS = 8
"""Profiles that must have shown the blur before it is believed."""

MIN_STEPS, MAX_STEPS = 4, 10
CONVERGED = 1e-5
"""Length of a refinement step [m], rotations at 5 cm, below which it ends."""

MAX_SHIFT, MAX_TURN = 0.02, 0.3
"""Longest step [m, rad]; the profiles say nothing on what lies farther away."""


class Refiner:
    """Refines poses of one cuboid in the views of fixed cameras; holds the work space for that."""

    def __init__(self, box: Box, cameras: Sequence[Camera], label_table: Array) -> None:
        self.box, self.label_table = box, label_table
        self.radius = float(np.linalg.norm(box.half))
        self.lenses = stack_lenses(cameras)
        self.calibration = np.array([calibration_covariance(camera) for camera in cameras])
        middle = [c.resized(*reduced_size(c.width, c.height, ALIGN_SIZE)) for c in cameras]
        self.middle = stack_lenses(middle)
        self.scales = np.array([camera.matrix[0, 0] / REFERENCE_FOCAL for camera in cameras])
        shape = (len(cameras), max(c.height for c in middle), max(c.width for c in middle))
        self.labels: Array = np.zeros(shape, np.uint8)
        self._work = contour.workspace()

    def refine(
        self, views: Sequence[Evidence | None], used: Array, rotation: FloatArray, position: FloatArray
    ) -> Fit:
        """The pose (3, 3), (3,) [m] that fits the contours best near the one given.

        Gauss-Newton on the pose and on an offset η_c of each camera, which sees the object at the pose
        moved by η_c; the offsets' size is bound by what the calibration states of its errors.
        """
        rotation, position = rotation.copy(), position.copy()
        self._align(views, used, rotation, position)
        cameras = len(views)
        stated = offset_covariance(self.calibration, position)
        weights: FloatArray = np.asarray(np.linalg.inv(stated), dtype=np.float64)
        offsets, gradient = np.zeros((cameras, 6)), np.zeros((cameras, 6))
        information, summary = np.zeros((cameras, 6, 6)), np.zeros((cameras, 6))
        blurs = START_BLUR * np.sqrt(np.maximum(1.0, self.scales))
        known: FloatArray = np.diag(PRIOR)
        spread, converged = 1.0, False
        for step in range(MAX_STEPS):
            residuals = []
            for c, view in enumerate(views):
                if view is None:
                    continue
                seen_rotation, seen_position = rotation.copy(), position.copy()
                apply_update(seen_rotation, seen_position, offsets[c])
                scale = float(self.scales[c])
                contour.refine_view(
                    self.lenses, c, view, self.label_table, self.box, seen_rotation, seen_position,
                    _window(scale, step, spread, float(blurs[c])), self._work,
                    information[c], gradient[c], summary[c],
                )  # fmt: skip
                residuals.append(self._work.residuals(int(summary[c, contour.EXPECTED])) / scale)
                if step >= 2 and summary[c, contour.BLURS] >= MIN_BLURS:
                    blur = summary[c, contour.BLUR_SUM] / summary[c, contour.BLURS]
                    blurs[c] = min(max(blur, MIN_BLUR), MAX_BLUR * scale)
            usable = np.concatenate(residuals)
            if step < FREEZE_SPREAD and usable.size:
                # The median of all, unlike the inliers' mean square, does not shrink by leaving out
                # what disagrees.
                spread = 1.4826 * float(np.median(usable))
            trust = 1.0 / (CORRELATION * max(spread / ASSUMED_SPREAD, 1.0)) ** 2
            solved = solve_step(trust * information, trust * gradient, offsets, weights)
            if solved is None:
                break
            known = solved.information
            shift, turn = math.hypot(*solved.pose[:3]), math.hypot(*solved.pose[3:])
            limit = max(shift / MAX_SHIFT, turn / MAX_TURN, 1.0)
            apply_update(rotation, position, solved.pose / limit)
            offsets += solved.offsets / limit
            if step >= MIN_STEPS and shift + 0.05 * turn < CONVERGED:
                converged = True
                break
        summary[:, contour.SQUARES] /= self.scales**2
        counts = np.empty((cameras, 5), np.int64)
        align.explain(
            self.middle, self.labels, used, self.box.half, self.box.face_labels, rotation, position, 2, counts
        )  # fmt: skip
        return Fit(position, rotation, pose_covariance(known), counts, summary, converged)

    def _align(
        self, views: Sequence[Evidence | None], used: Array, rotation: FloatArray, position: FloatArray
    ) -> None:
        """Move the pose in place to the label transitions of finer label maps, and keep these."""
        for c, view in enumerate(views):
            if view is not None:
                align.label_around(
                    self.middle, c, view.image, view.channels, self.label_table, position,
                    LABELLED * self.radius, self.labels[c],
                )  # fmt: skip
        align.align(
            self.middle, self.labels, used, self.box.half, self.box.face_labels, rotation, position,
            FINE_REACHES, self._work.samples,
        )  # fmt: skip


def _window(scale: float, step: int, spread: float, blur: float) -> contour.Window:
    reach = REACHES[min(step, len(REACHES) - 1)]
    tukey = reach if step < len(REACHES) - 1 else min(reach, max(MIN_TUKEY, TUKEY * spread))
    return contour.Window(
        reach=max(3, min(MAX_REACH, round(reach * scale))),
        blur=blur,
        tukey=scale * tukey,
        floor=(ASSUMED_SPREAD * scale) ** 2,
        spacing=2.0 * scale,
        margin=3.0 * scale,
    )
