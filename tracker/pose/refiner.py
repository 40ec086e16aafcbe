"""Poses in, fits out: the refinement, its workspace, and the evidence for its result."""

import math
import threading
from typing import NamedTuple

import numpy as np

from tracker.calibration.deviations import calibration_covariance, is_stated
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.geometry.lens import stack_lenses
from tracker.objects.model import Box
from tracker.pose.edge_fit import OFFSET
from tracker.pose.edge_model import SCRATCH
from tracker.pose.evidence import NUMBERS, judge
from tracker.pose.fit import LIKELY, SEEN, Evidence, Fit, Lag, OwnViews, Start
from tracker.pose.refine import refine
from tracker.pose.schedule import MEASURING, SCHEDULE, Schedule
from tracker.pose.solution import CAMERA, EXPONENT, MOVING, RIM, SOLUTION, UNKNOWNS
from tracker.pose.strips import MAX_STRIPS, PIXELS, STRIP
from tracker.pose.support import Table, table_of
from tracker.pose.views import Reader, Sight
from tracker.segmentation.color_model import SHADE

SHOWN_RIM_STD = 1e-4
"""Smallest standard deviation of a rim estimated from images [m], unless the object's file states a smaller
one: the rim differs from side to side."""

_NUMBERS = SOLUTION[["blur", "rim", "stands", "converged"]]


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
    stated: Array
    """(C,) whether the calibration states errors; if not, it counts as exact."""
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
    """(C, PIXELS) distances from the edges when they were collected [px]."""
    values: FloatArray
    """(C, 3, PIXELS) colours."""
    residuals: FloatArray
    """(C · MAX_STRIPS,)"""
    widths: FloatArray
    """(MAX_STRIPS,)"""
    scratch: Array
    """(1,) of `edge_model.SCRATCH`."""


class LocalSpace(threading.local):
    """One workspace per thread."""

    def __init__(self, cameras: int) -> None:
        self.cameras = cameras
        self.work = Workspace(
            np.zeros((cameras, MAX_STRIPS), STRIP),
            np.zeros((cameras, MAX_STRIPS), OFFSET),
            np.empty((cameras, PIXELS)),
            np.empty((cameras, 3, PIXELS)),
            np.empty(cameras * MAX_STRIPS),
            np.empty(MAX_STRIPS),
            np.zeros(1, SCRATCH),
        )

    def __reduce__(self) -> tuple[type, tuple[int]]:
        # A copy of a tracker, in this process or another, has a workspace of its own.
        return type(self), (self.cameras,)


class Refiner:
    """Refine poses of one cuboid in images of fixed cameras; thread-safe.

    Args:
        box: the object.
        rig: the cameras.
        reader: the one that read the images.
        support: whether the object is expected to rest on the arena's table.
    """

    def __init__(self, box: Box, rig: CameraRig, reader: Reader, support: bool) -> None:
        self._box, self._arena = box, rig.arena
        known = np.array([calibration_covariance(camera, -1) for camera in rig.cameras])
        stated = np.array([is_stated(camera) for camera in rig.cameras])
        colors, lenses = reader.colors.label_table, stack_lenses(rig.cameras)
        table = table_of(rig.arena, support)
        self.model = Model(box.half, box.face_labels, lenses, known, stated, colors, table)
        self._shaded = self.model._replace(colors=reader.colors.shade_table)
        self.likely = LIKELY._replace(rim=box.rim[0], rim_std=box.rim[1])
        self._maps, self._faces = stack_lenses(reader.label_cameras(rig)), (box.half, box.face_labels)
        self._local = LocalSpace(len(lenses))

    def __call__(
        self,
        sight: Sight,
        rotation: FloatArray,
        position: FloatArray,
        schedule: Schedule = SCHEDULE,
        start: Start | None = None,
        lag: Lag | None = None,
        resized: float = -math.inf,
        *,
        left_out: tuple[int, ...] = (),
        ask: bool = True,
    ) -> Fit:
        """Return the fit nearest to a pose (3, 3), (3,) [m].

        Args:
            sight: the images.
            rotation: initial world_from_object.
            position: initial position of the object's centre in the world.
            schedule: the steps; FOLLOWING suits a pose that is off by a few pixels.
            start: initial values of the other unknowns; None: the object's defaults.
            lag: how old the images are; None: all were taken at the same time.
            resized: see Fit, if known.
            left_out: cameras whose images do not move the pose, but are evidence for it or against it.
            ask: whether to estimate the pose that each camera sees on its own.
        """
        pictures, start = sight.without(*left_out).pictures, start or self.likely
        model, pose = self._shaded if sight.shaded else self.model, (rotation, position)
        solution, cameras, seen, own = self._run(model, pictures, pose, schedule, start, lag, ask)
        ((blur, rim, stands, converged),) = solution.view(_NUMBERS).tolist()
        rotation, position, covariance = (solution[key][0] for key in ("rotation", "position", "covariance"))
        if converged:
            exponent, width = solution["shared"][0, EXPONENT : RIM + 1].tolist()
            least = min(SHOWN_RIM_STD, self.likely.rim_std)
            start = Start(blur, exponent, width, max(math.sqrt(rim), least))
        place = rotation, position, cameras["offset"][:, :6] + cameras["lag"]
        body, nothing, ahead = judge(
            self._maps, sight.labels, sight.pictures, pictures, self._faces, place, stands, seen, NUMBERS
        )  # fmt: skip
        height, lowest = float(covariance[2, 2]), self._box.lowest(position, rotation)
        std = math.sqrt(max(height, 0.0)) if math.isfinite(height) else 0.0
        return Fit(
            position,
            rotation,
            covariance,
            seen,
            converged,
            Evidence(body + SHADE if sight.shaded else body, nothing, ahead),
            resized,
            end=start,
            inside=self._arena.holds(position, lowest, std),
            stands=stands,
            left_out=left_out,
            shaded=sight.shaded,
            shifts=place[2],
            own=own if ask else None,
        )

    def _run(
        self,
        model: Model,
        pictures: Array,
        pose: tuple[FloatArray, FloatArray],
        schedule: Schedule,
        start: Start,
        lag: Lag | None = None,
        ask: bool = False,
    ) -> tuple[Array, Array, Array, OwnViews]:
        """Call `refine` at a rotation and position; return the solution (1,) and everything else it fills."""
        solution, cameras = np.zeros(1, SOLUTION), np.zeros(len(pictures), CAMERA)
        solution["size"] = UNKNOWNS if lag is None else MOVING
        solution["rotation"], solution["position"] = pose
        if lag is not None:
            cameras["delay"], cameras["lag"] = lag.delays, lag.moved
            solution["velocity"] = lag.covariance
        seen, asked = np.zeros(len(cameras), SEEN), len(cameras) if ask else 0
        own = OwnViews(np.empty((asked, 6, 6)), np.empty((asked, 6)), np.empty(asked))
        refine(model, pictures, schedule, start, solution, cameras, seen, self._local.work, own)
        return solution, cameras, seen, own

    def edges(
        self, pictures: Array, rotation: FloatArray, position: FloatArray, start: Start | None = None
    ) -> tuple[Array, Array, Workspace]:
        """Measure the edges at a pose (3, 3), (3,) [m] in pictures (C,) of PICTURE.

        Return a solution, cameras (C,) and this thread's workspace. start: blur of the images, and the
        exponent and rim with which the object is drawn.
        """
        pose, start = (rotation, position), start or self.likely
        solution, cameras, _, _ = self._run(self.model, pictures, pose, MEASURING, start)
        return solution[0], cameras, self._local.work
