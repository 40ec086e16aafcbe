"""Refines hypotheses on the pictures' edges, with an offset for each camera's calibration error."""

from __future__ import annotations

import statistics
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.calibration.deviations import calibration_covariance
from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.pose.edges.lay import lay_strips
from tracker.pose.evidence import View
from tracker.pose.fit import SEEN, OwnViews
from tracker.pose.scale import relative_sizes
from tracker.pose.solve.covariance import (
    PRIOR,
    offset_weights,
    with_model_errors,
)
from tracker.pose.solve.own_view import see_alone
from tracker.pose.solve.refine import settle
from tracker.pose.solve.schedule import SCHEDULE, TUNING, Schedule
from tracker.pose.solve.state import Cameras, Unknowns, Workspace, workspace
from tracker.pose.solve.step import EXPONENT, MOVING, OWN, RIM, UNKNOWNS
from tracker.pose.solve.support import NO_TABLE, Table
from tracker.pose.start import LIKELY, Lag, Start
from tracker.segmentation import mosaic

FINE = 1.5
"""Size of the object over the reference from which a mosaic does not matter: strips along edges have so many
pixels that errors of interpolation average out (recorded pictures of 540×540 fit no better with it)."""


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
    end: Start
    """What the unknowns beside the pose turned out to be."""
    lags: FloatArray
    """(C, 6) by which the cameras saw the object moved, since their pictures are older [m, rad]."""
    stands: float
    """How well it stands on the table: log odds over an object that may be anywhere."""
    offsets: FloatArray
    """(C, 6) by which they saw it moved beside that, since their calibration is not quite right [m, rad]."""


@dataclass(eq=False)
class Attempt:
    """A refinement under way."""

    views: Sequence[View | None]
    cameras: Cameras
    unknowns: Unknowns
    marginal: FloatArray
    """(6, 6) covariance of the pose; NaN before the first step."""
    seen: Array
    """(C,) of SEEN."""
    step: int = 0
    converged: bool = False
    stands: float = 0.0


class _Local(threading.local):
    """A work space of each thread."""

    def __init__(self, cameras: int) -> None:
        self.cameras = cameras
        self.space = workspace(cameras)

    def __reduce__(self) -> tuple[type, tuple[int]]:
        # A copy of a tracker, in this process or in another one, works in arrays of its own.
        return type(self), (self.cameras,)


class Refiner:
    """Refines poses of one cuboid in the pictures of fixed cameras; any number of threads may use it."""

    def __init__(
        self, box: Box, cameras: Sequence[Camera], label_table: Array, table: Table = NO_TABLE
    ) -> None:
        self.box, self.label_table, self.table = box, label_table, table
        self.lenses = stack_lenses(cameras)
        calibration = np.array([calibration_covariance(camera) for camera in cameras])
        self._known = np.asarray(np.linalg.inv(calibration), dtype=np.float64)
        self._units = np.repeat([box.radius**2, 1.0], 3)
        self._local = _Local(len(cameras))

    def refine(
        self,
        views: Sequence[View | None],
        rotation: FloatArray,
        position: FloatArray,
        schedule: Schedule = SCHEDULE,
        start: Start = LIKELY,
        lag: Lag | None = None,
    ) -> Refined:
        """The pose (3, 3), (3,) [m] that fits the views' edges best near the one given.

        Gauss-Newton on the pose and on an offset η_c of each camera, which sees the object at the pose
        moved by η_c; the offsets' size is bound by what the calibration states of its errors.
        """
        attempt = self.begin(views, rotation, position, start, lag)
        self.advance(attempt, schedule)
        return self.end(attempt)

    def begin(
        self,
        views: Sequence[View | None],
        rotation: FloatArray,
        position: FloatArray,
        start: Start = LIKELY,
        lag: Lag | None = None,
    ) -> Attempt:
        """A refinement that is to be advanced step by step; arguments as of `refine`."""
        count = len(self.lenses)
        cameras = self._cameras(views, np.asarray(position, dtype=np.float64), start.blur, lag)
        unknowns = Unknowns(
            np.array(rotation, dtype=np.float64),
            np.array(position, dtype=np.float64),
            np.zeros(UNKNOWNS if lag is None else MOVING),
            np.zeros((count, OWN)),
            start.blur * cameras.scales,
            np.array([TUNING.own**2]),
        )
        unknowns.shared[EXPONENT], unknowns.shared[RIM] = start.exponent, start.rim
        return Attempt(views, cameras, unknowns, np.full((6, 6), np.nan), np.zeros(count, SEEN))

    def advance(self, attempt: Attempt, schedule: Schedule, until: int | None = None) -> None:
        """Do an attempt's further steps of a schedule: all, or those before step `until`."""
        work, part = self._local.space, Schedule(*(column[:until] for column in schedule))
        while attempt.step < len(part.blur) and not attempt.converged:
            self._collect(attempt.views, attempt.cameras, attempt.unknowns, part, attempt.step, work)
            attempt.converged, attempt.step, attempt.stands = settle(
                attempt.cameras, self.table, PRIOR / self._units, self.box, self.box.radius, part, TUNING,
                attempt.step, attempt.unknowns, work, attempt.marginal, attempt.seen,
            )  # fmt: skip

    def laid(self, attempt: Attempt, schedule: Schedule, step: int) -> Workspace:
        """This thread's work space, with the strips of a step of the schedule at the pose of an attempt."""
        work = self._local.space
        self._collect(attempt.views, attempt.cameras, attempt.unknowns, schedule, step, work)
        return work

    def alone(self, attempt: Attempt) -> OwnViews:
        """Where each camera by itself sees the object, by the offsets of the attempt's last step.

        To be asked before another attempt is advanced in this thread.
        """
        work, count = self._local.space, len(self.lenses)
        views = OwnViews(np.empty((count, 6, 6)), np.empty((count, 6)), np.zeros(count))
        seen = np.zeros(count, SEEN)
        see_alone(
            attempt.cameras, attempt.unknowns, TUNING, PRIOR / self._units, work, seen, views.information,
            views.moved,
        )  # fmt: skip
        return views._replace(inliers=seen["inliers"].copy())

    def end(self, attempt: Attempt) -> Refined:
        """Where an attempt stands."""
        cameras, unknowns, seen = attempt.cameras, attempt.unknowns, attempt.seen.copy()
        seen["squares"] /= cameras.scales**2
        covariance = with_model_errors(attempt.marginal, self.box.radius)
        end = LIKELY
        if attempt.converged:
            blur = statistics.median((unknowns.blurs / cameras.scales)[cameras.used].tolist())
            end = Start(blur, unknowns.shared[EXPONENT], unknowns.shared[RIM])
        return Refined(
            unknowns.rotation.copy(), unknowns.position.copy(), covariance, seen, attempt.converged,
            attempt.step, end, cameras.lags, attempt.stands, unknowns.offsets[:, :6].copy(),
        )  # fmt: skip

    def _cameras(
        self, views: Sequence[View | None], position: FloatArray, blur: float, lag: Lag | None
    ) -> Cameras:
        """What is known of the cameras for an object at a position (3,) [m]."""
        count = len(views)
        parts, channels = np.ones(count, np.int64), np.zeros((count, 3, 256), np.int32)
        scales = relative_sizes(self.lenses, self.box, position)
        for c, view in enumerate(views):
            if view is not None:
                channels[c] = view.channels
                parts[c] = 3 if view.mosaic != mosaic.NONE and scales[c] < FINE else 1
        weights = offset_weights(self._known, position)
        used = np.array([view is not None for view in views])
        lags, delays, calm = np.zeros((count, 6)), np.zeros(count), np.zeros((6, 6))
        if lag is not None:
            lags, delays = lag.moved, lag.delays
            calm = np.asarray(np.linalg.inv(lag.covariance), dtype=np.float64)
        return Cameras(used, scales, parts, channels, self.label_table, weights, blur, lags, delays, calm)

    def _collect(
        self,
        views: Sequence[View | None],
        cameras: Cameras,
        unknowns: Unknowns,
        schedule: Schedule,
        step: int,
        work: Workspace,
    ) -> None:
        """Lay strips along the edges at the present pose, and collect their pixels."""
        work.motion[:] = 0.0
        work.counts[:] = 0
        # After a rough step strips are laid anew.
        rough = schedule.blur[step] > 0.0
        every = schedule.every[step] if rough else 1
        for c, view in enumerate(views):
            if view is not None:
                scale = cameras.scales[c]
                blur = schedule.blur[step] * scale if rough else unknowns.blurs[c]
                reach = max(TUNING.least_reach, TUNING.reach[0] * scale + TUNING.reach[1] * blur)
                work.reaches[c] = reach
                red = view.mosaic if cameras.parts[c] > 1 else mosaic.NONE
                work.counts[c] = lay_strips(
                    view.image, view.tilt, red, self.lenses, c, self.box, unknowns.rotation,
                    unknowns.position, unknowns.offsets[c, :6] + cameras.lags[c],
                    schedule.piece[step] * scale, TUNING.margin[0] * scale + TUNING.margin[1] * blur, reach,
                    scale, every, work.strips[c], work.distance[c], work.values[c],
                )  # fmt: skip
