"""Refine a hypothesis on the images' contours, with an offset for each camera's calibration error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.pose import align, contour
from tracker.pose.covariance import PRIOR, calibration_covariance, offset_covariance, pose_covariance
from tracker.pose.fit import Fit
from tracker.pose.views import ALIGN_SIZE, Box, Evidence, reduced_size, stack_lenses

FINE_REACHES = np.array([6, 6, 5, 4])
"""Reach of the label transitions' search in each alignment step [px of the finer label map]."""

LABELLED = 1.5
"""How far around the object its finer label map reaches, in its radii."""

REFERENCE_FOCAL = 295.0
"""Focal length [px] at which lengths in the refinement are stated: the platform's at 270×270."""

SCHEDULE = contour.Schedule(
    blur=np.array([1.2] + [0.0] * 8),
    piece=np.array([6.0] + [4.0] * 8),
    tukey=np.array([4.0, 2.0, 1.0] + [0.5] * 6),
)

TUNING = contour.Tuning(
    reach=(1.2, 2.0),
    margin=(0.4, 1.5),
    floor=0.06,
    tukey=4.685,
    start_blur=0.9,
    least_blur=0.35,
    largest_blur=3.0,
    correlation=1.4,
    negligible=0.04,
    longest=0.02,
    largest=0.3,
)


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
        self._work = contour.workspace(len(cameras))
        height, width = max(c.height for c in cameras), max(c.width for c in cameras)
        self.images: Array = np.zeros((len(cameras), height, width, 3), np.uint8)
        self.channels: Array = np.zeros((len(cameras), 3, 256), np.int32)

    def refine(
        self, views: Sequence[Evidence | None], used: Array, rotation: FloatArray, position: FloatArray
    ) -> Fit:
        """The pose (3, 3), (3,) [m] that fits the contours best near the one given.

        Gauss-Newton on the pose and on an offset η_c of each camera, which sees the object at the pose
        moved by η_c; the offsets' size is bound by what the calibration states of its errors.
        """
        rotation, position = np.array(rotation, dtype=np.float64), np.array(position, dtype=np.float64)
        self._align(views, used, rotation, position)
        cameras = len(views)
        for c, view in enumerate(views):
            if view is not None:
                self.images[c, : view.image.shape[0], : view.image.shape[1]] = view.image
                self.channels[c] = view.channels
        stated = offset_covariance(self.calibration, position)
        weights: FloatArray = np.asarray(np.linalg.inv(stated), dtype=np.float64)
        known, summary = np.zeros((6, 6)), np.zeros((cameras, contour.SUMMARY))
        converged = contour.refine(
            self.images, self.lenses, self.scales, used, self.channels, self.label_table, self.box, weights,
            PRIOR, SCHEDULE, TUNING, rotation, position, self._work, known, summary,
        )  # fmt: skip
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
            FINE_REACHES, self._work.samples[0],
        )  # fmt: skip

