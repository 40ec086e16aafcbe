"""Poses in, fits out: the refinement and its workspace."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.calibration.deviations import calibration_covariance
from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.pose.edge_fit import OFFSET
from tracker.pose.edge_model import scratch
from tracker.pose.fit import LIKELY, SEEN, Fit, Lag, OwnViews, Start
from tracker.pose.refine import refine
from tracker.pose.schedule import MEASURING, SCHEDULE, Schedule
from tracker.pose.solution import CAMERA, EXPONENT, MOVING, RIM, SOLUTION, UNKNOWNS
from tracker.pose.strips import MAX_STRIPS, PIXELS, STRIP
from tracker.pose.support import NO_TABLE, Table

SHOWN_RIM_STD = 1e-4
"""Smallest standard deviation of a rim estimated from images [m]: the rim differs from side to side."""


class Model(NamedTuple):
    """What stays constant while fixed cameras follow an object."""

    half: FloatArray
    """(3,) half edge lengths of the object [m]."""
    face_labels: Array
    """(6,) uint8."""
    lenses: Array
    """(C,) of LENS."""
    calibration: FloatArray
    """(C, 6, 6) inverse of `calibration.deviations.calibration_covariance`."""
    colors: Array
    """(64³,) uint8: the label of each colour cell."""
    table: Table
    """The table that the object may stand on."""


class Workspace(NamedTuple):
    """Arrays of the refinement, for one thread."""

    strips: Array
    """(C, MAX_STRIPS) of STRIP."""
    found: Array
    """(C, MAX_STRIPS) of OFFSET."""
    distance: FloatArray
    """(C, PIXELS) from the edges [px], when they were collected."""
    values: FloatArray
    """(C, 3, PIXELS) colours."""
    residuals: FloatArray
    """(C · MAX_STRIPS,)"""
    widths: FloatArray
    """(MAX_STRIPS,)"""
    scratch: Array
    """(1,) of `edge_fit.SCRATCH`."""


def workspace(cameras: int) -> Workspace:
    """Return a new workspace."""
    return Workspace(
        np.zeros((cameras, MAX_STRIPS), STRIP),
        np.zeros((cameras, MAX_STRIPS), OFFSET),
        np.empty((cameras, PIXELS)),
        np.empty((cameras, 3, PIXELS)),
        np.empty(cameras * MAX_STRIPS),
        np.empty(MAX_STRIPS),
        scratch(),
    )


class LocalSpace(threading.local):
    """One workspace per thread."""

    def __init__(self, cameras: int) -> None:
        self.cameras = cameras
        self.work = workspace(cameras)

    def __reduce__(self) -> tuple[type, tuple[int]]:
        # A copy of a tracker, in this process or another, has a workspace of its own.
        return type(self), (self.cameras,)


class Refiner:
    """Refine poses of one cuboid in images of fixed cameras; thread-safe."""

    def __init__(
        self, box: Box, cameras: Sequence[Camera], label_table: Array, table: Table = NO_TABLE
    ) -> None:
        known = np.linalg.inv(np.array([calibration_covariance(camera) for camera in cameras]))
        self.model = Model(box.half, box.face_labels, stack_lenses(cameras), known, label_table, table)
        self.likely = LIKELY._replace(rim=box.rim[0], rim_std=box.rim[1])
        self._local = LocalSpace(len(cameras))

    def begun(
        self, rotation: FloatArray, position: FloatArray, lag: Lag | None = None
    ) -> tuple[Array, Array]:
        """Return a solution (1,) and cameras (C,) at a pose (3, 3), (3,) [m], before anything is measured."""
        solution, cameras = np.zeros(1, SOLUTION), np.zeros(len(self.model.lenses), CAMERA)
        solution["size"] = UNKNOWNS if lag is None else MOVING
        solution["rotation"], solution["position"], solution["covariance"] = rotation, position, np.nan
        if lag is not None:
            cameras["delay"], cameras["lag"] = lag.delays, lag.moved
            solution["prior"][0, UNKNOWNS:, UNKNOWNS:] = np.linalg.inv(lag.covariance)
        return solution, cameras

    def __call__(
        self,
        pictures: Array,
        rotation: FloatArray,
        position: FloatArray,
        schedule: Schedule = SCHEDULE,
        start: Start | None = None,
        lag: Lag | None = None,
        *,
        ask: bool = False,
    ) -> Fit:
        """Return the fit to pictures (C,) of PICTURE nearest to a pose (3, 3), (3,) [m].

        ask: whether to estimate the pose that each camera sees by itself. Label maps are not counted here.
        """
        solution, cameras = self.begun(rotation, position, lag)
        start = start or self.likely
        seen, own = self._run(pictures, schedule, start, solution, cameras, len(cameras) if ask else 0)
        end, one = start, solution[0]
        if one["converged"]:
            rim_std = max(math.sqrt(one["rim"]), SHOWN_RIM_STD)
            shared = one["shared"]
            end = Start(float(one["blur"]), float(shared[EXPONENT]), float(shared[RIM]), rim_std)
        return Fit(
            one["position"],
            one["rotation"],
            one["covariance"],
            seen,
            bool(one["converged"]),
            iterations=int(one["steps"]),
            end=end,
            stands=float(one["stands"]),
            offsets=cameras["offset"][:, :6].copy(),
            lags=None if lag is None else cameras["lag"].copy(),
            own=own if ask else None,
        )

    def _run(
        self, pictures: Array, schedule: Schedule, start: Start, solution: Array, cameras: Array, asked: int
    ) -> tuple[Array, OwnViews]:
        """Call `refine`; return what it fills besides the solution (1,) and cameras (C,)."""
        seen = np.zeros(len(cameras), SEEN)
        own = OwnViews(np.empty((asked, 6, 6)), np.empty((asked, 6)), np.empty(asked))
        refine(self.model, pictures, schedule, start, solution[0], cameras, seen, self._local.work, own)
        return seen, own

    def edges(
        self,
        pictures: Array,
        rotation: FloatArray,
        position: FloatArray,
        start: Start | None = None,
        offsets: FloatArray | None = None,
    ) -> tuple[Array, Array, Workspace]:
        """Measure the edges at a pose; return a solution, cameras (C,) and this thread's workspace.

        Args:
            pictures: (C,) of PICTURE.
            rotation: (3, 3) world_from_object.
            position: (3,) of the object's centre [m].
            start: blur of the images, and the exponent and rim with which the object is drawn.
            offsets: (C, 6) known displacements of the object in each camera's view [m, rad]; edges are
                measured there.
        """
        (solution, cameras), work = self.begun(rotation, position), self._local.work
        if offsets is not None:
            cameras["offset"][:, :6] = offsets
        self._run(pictures, MEASURING, start or self.likely, solution, cameras, 0)
        return solution[0], cameras, work
