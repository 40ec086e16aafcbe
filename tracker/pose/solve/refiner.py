"""Refines hypotheses on the pictures' edges, with an offset for each camera's calibration error."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.pose.evidence import View
from tracker.pose.fit import SEEN
from tracker.pose.solve.covariance import PRIOR, calibration_covariance, offset_covariance, pose_covariance
from tracker.pose.solve.refine import LIKELY_EXPONENT, Pictures, Unknowns, refine, workspace
from tracker.pose.solve.schedule import SCHEDULE, TUNING, Schedule
from tracker.pose.solve.step import EXPONENT, UNKNOWNS
from tracker.segmentation import mosaic

REFERENCE_FOCAL = 295.0
"""Focal length [px] at which lengths in the refinement are stated: the platform's at 270×270."""

FINE = 1.5
"""Focal length over the reference from which a mosaic does not matter: strips along edges have so many pixels
that errors of interpolation average out (recorded pictures of 540×540 fit no better with it)."""


class Refined(NamedTuple):
    """Where a refinement ended."""

    rotation: FloatArray
    """(3, 3) world_from_object."""
    position: FloatArray
    """(3,) [m]."""
    covariance: FloatArray
    """(6, 6) [m, rad]."""
    cameras: Array
    """(C,) of SEEN."""
    converged: bool
    """Whether the last step was negligible."""
    iterations: int


class _Local(threading.local):
    """A work space of each thread."""

    def __init__(self, cameras: int) -> None:
        self.space = workspace(cameras)


class Refiner:
    """Refines poses of one cuboid in the pictures of fixed cameras; any number of threads may use it."""

    def __init__(self, box: Box, cameras: Sequence[Camera], label_table: Array) -> None:
        self.box, self.label_table = box, label_table
        self.lenses = stack_lenses(cameras)
        self.calibration = np.array([calibration_covariance(camera) for camera in cameras])
        self.scales = np.array([camera.matrix[0, 0] / REFERENCE_FOCAL for camera in cameras])
        self._shape = (max(c.height for c in cameras), max(c.width for c in cameras), 3)
        self._local = _Local(len(cameras))

    def pictures(self, views: Sequence[View | None]) -> Pictures:
        """What the compiled refinement looks at."""
        count = len(views)
        images: Array = np.zeros((count, *self._shape), np.uint8)
        mosaics, channels = np.full(count, mosaic.NONE), np.zeros((count, 3, 256), np.int32)
        for c, view in enumerate(views):
            if view is not None:
                images[c, : view.image.shape[0], : view.image.shape[1]] = view.image
                channels[c] = view.channels
                mosaics[c] = view.mosaic if self.scales[c] < FINE else mosaic.NONE
        used = np.array([view is not None for view in views])
        return Pictures(images, mosaics, channels, self.label_table, self.lenses, self.scales, used)

    def refine(
        self,
        pictures: Pictures,
        rotation: FloatArray,
        position: FloatArray,
        schedule: Schedule = SCHEDULE,
        blur: float = TUNING.start_blur,
    ) -> Refined:
        """The pose (3, 3), (3,) [m] that fits the contours best near the one given.

        Gauss-Newton on the pose and on an offset η_c of each camera, which sees the object at the pose
        moved by η_c; the offsets' size is bound by what the calibration states of its errors. `blur` is
        that of the pictures to begin with [px at the reference focal length].
        """
        count = len(self.lenses)
        unknowns = Unknowns(
            np.array(rotation, dtype=np.float64),
            np.array(position, dtype=np.float64),
            np.zeros(UNKNOWNS),
            np.zeros((count, 6)),
            blur * self.scales,
        )
        unknowns.shared[EXPONENT] = LIKELY_EXPONENT
        stated = offset_covariance(self.calibration, unknowns.position)
        weights: FloatArray = np.asarray(np.linalg.inv(stated), dtype=np.float64)
        information, cameras = np.zeros((6, 6)), np.zeros(count, SEEN)
        converged, iterations = refine(
            pictures, self.box, weights, PRIOR, schedule, TUNING, unknowns, self._local.space, information,
            cameras,
        )  # fmt: skip
        cameras["squares"] /= self.scales**2
        covariance = pose_covariance(information)
        return Refined(unknowns.rotation, unknowns.position, covariance, cameras, converged, iterations)
