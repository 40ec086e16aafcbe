"""Refine a hypothesis on the images' contours, with an offset for each camera's calibration error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.pose import contour
from tracker.pose.covariance import PRIOR, calibration_covariance, offset_covariance, pose_covariance
from tracker.pose.views import Box, Evidence, stack_lenses

REFERENCE_FOCAL = 295.0
"""Focal length [px] at which lengths in the refinement are stated: the platform's at 270×270."""

FINE = 1.5
"""Focal length over the reference from which a mosaic does not matter: strips along edges have so many pixels
that errors of interpolation average out (recorded pictures of 540×540 fit no better with it)."""

SCHEDULE = contour.Schedule(
    blur=np.array([1.2] + [0.0] * 8),
    piece=np.array([6.0] + [5.0] * 8),
    tukey=np.array([4.0, 2.0, 1.0] + [0.5] * 6),
    every=np.ones(9, np.int64),
    least=3,
    # Where few pixels decide, pieces come and go from step to step, and the pose stays restless.
    negligible=np.array([0.2] * 5 + [0.4, 0.6, 0.8, 1.0]),
)

FOLLOWING = contour.Schedule(
    blur=np.zeros(5),
    piece=np.array([6.0] * 5),
    tukey=np.array([1.0] + [0.5] * 4),
    every=np.array([2] + [1] * 4),
    least=1,
    negligible=np.full(5, 0.5),
)
"""From a pose that was predicted, with a blur that is known."""

TUNING = contour.Tuning(
    reach=(1.2, 2.0),
    margin=(0.4, 1.5),
    floor=0.06,
    tukey=4.685,
    correlation=1.1,
    start_blur=0.9,
    least_blur=0.35,
    largest_blur=3.0,
    longest=0.02,
    largest=0.3,
)


class Refiner:
    """Refines poses of one cuboid in the views of fixed cameras; holds the work space for that."""

    def __init__(self, box: Box, cameras: Sequence[Camera], label_table: Array) -> None:
        self.box, self.label_table = box, label_table
        self.lenses = stack_lenses(cameras)
        self.calibration = np.array([calibration_covariance(camera) for camera in cameras])
        self.scales = np.array([camera.matrix[0, 0] / REFERENCE_FOCAL for camera in cameras])
        self._work = contour.workspace(len(cameras))
        height, width = max(c.height for c in cameras), max(c.width for c in cameras)
        self.images: Array = np.zeros((len(cameras), height, width, 3), np.uint8)
        self.channels: Array = np.zeros((len(cameras), 3, 256), np.int32)
        self.mosaics: Array = np.full(len(cameras), -1)

    def show(self, views: Sequence[Evidence | None]) -> None:
        """Take the images in which the poses that follow are refined."""
        for c, view in enumerate(views):
            if view is not None:
                self.images[c, : view.image.shape[0], : view.image.shape[1]] = view.image
                self.channels[c] = view.channels
                self.mosaics[c] = view.mosaic if self.scales[c] < FINE else -1

    def refine(
        self,
        used: Array,
        rotation: FloatArray,
        position: FloatArray,
        schedule: contour.Schedule = SCHEDULE,
        blur: float = TUNING.start_blur,
    ) -> tuple[FloatArray, FloatArray, FloatArray, Array, bool]:
        """The pose (3, 3), (3,) [m] that fits the contours best near the one given.

        Gauss-Newton on the pose and on an offset η_c of each camera, which sees the object at the pose
        moved by η_c; the offsets' size is bound by what the calibration states of its errors. `blur` is
        that of the images to begin with [px at the reference focal length].

        Returns rotation, position, covariance (6, 6), summary (C, 5) of the pieces of edges (see
        `contour.EXPECTED` …), and whether the last step was negligible.
        """
        rotation, position = np.array(rotation, dtype=np.float64), np.array(position, dtype=np.float64)
        stated = offset_covariance(self.calibration, position)
        weights: FloatArray = np.asarray(np.linalg.inv(stated), dtype=np.float64)
        known, summary = np.zeros((6, 6)), np.zeros((len(used), contour.SUMMARY))
        converged = contour.refine(
            self.images, self.mosaics, self.lenses, self.scales, used, self.channels, self.label_table,
            self.box, weights, PRIOR, schedule, TUNING._replace(start_blur=blur), rotation, position,
            self._work, known, summary,
        )  # fmt: skip
        summary[:, contour.SQUARES] /= self.scales**2
        return rotation, position, pose_covariance(known), summary, converged
