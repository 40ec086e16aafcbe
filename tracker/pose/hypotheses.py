"""Where the object may be, as the label maps have it: places, turns, alignment, and what they explain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.pose.align import IMPOSSIBLE, try_hypotheses
from tracker.pose.evidence import evidence_at, resized_at
from tracker.pose.fit import SEEN, Evidence, Fit
from tracker.pose.rotations import likely_rotations, rotation_grid
from tracker.pose.scale import window
from tracker.pose.views import Reader, Sight, reader_of
from tracker.pose.votes import PositionSearch
from tracker.segmentation.color_model import ColorModel

REACHES = np.array([5, 4, 3])
"""Reach of the label transitions' search in each alignment step [px of the label map]."""

FAR_REACHES = np.array([8, 6, 4, 3])
"""The same from a prediction."""

ALIGNED = 10
"""Hypotheses of a round that are aligned to the end, at most: the best after a first step."""

ENOUGH = 2
"""Cameras that must support a pose that was found without another one."""

SAME_POSITION, SAME_ROTATION = 0.12, 0.15
"""Two hypotheses nearer than this [radii of the object, rad] are the same pose."""

WINDOW_RIM = 12.0
"""Beyond an object where it is expected, for where it may be instead [px of the label map]."""


class Round(NamedTuple):
    """How many hypotheses are begun by the end of a round."""

    places: int
    """Likeliest places."""
    first: int
    """Turns at the likeliest one."""
    others: int
    """Turns at each other one."""
    without: int = 0
    """Turns at the likeliest place as it is without each of the cameras."""


LIKELIEST, NEARBY, EVERYWHERE, TURNS = Round(1, 1, 0), Round(4, 4, 1), Round(7, 10, 5, 5), Round(1, 10, 0)
"""Of 391 scenes that the likeliest turn at the likeliest place did not settle, 72 % came to the right pose
from what NEARBY begins, 3 % only from a place without a camera, none from beyond the seventh place."""


class Hypothesis(NamedTuple):
    """Where the object may be, as the label maps have it."""

    score: float
    """How well it explains them."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    position: FloatArray
    """(3,) [m]."""
    left_out: tuple[int, ...] = ()
    """Cameras without which it was found."""


def apart(one: Fit | Hypothesis, other: Fit | Hypothesis, radius: float) -> bool:
    """Whether two poses differ by more than alignment on label maps leaves open; radius: of the box [m]."""
    # The trace of R R2ᵀ is 1 + 2 cos of the angle between them.
    if np.vdot(one.rotation, other.rotation) < 1 + 2 * math.cos(SAME_ROTATION):
        return True
    moved = one.position - other.position
    return math.sqrt(moved @ moved) > SAME_POSITION * radius


class Search:
    """Finds where an object may be, in label maps alone; has no memory.

    Args:
        box: the object.
        rig: the cameras.
        colors: by which pictures are read.
    """

    def __init__(self, box: Box, rig: CameraRig, colors: ColorModel) -> None:
        self.reader: Reader
        self.reader, small = reader_of(box, rig, colors)
        self.lenses = stack_lenses(small)
        self.positions = PositionSearch(small, box, rig.arena)
        self.grid, self.faces = rotation_grid(), (box.half, box.face_labels)
        self._radius, self._still = box.radius, np.zeros((len(small), 6))

    def window(self, c: int, position: FloatArray) -> tuple[int, int, int, int]:
        """Left, top, right, bottom of what an object there fills of camera c's label map, and some more."""
        left, top, right, bottom = window(self.lenses, c, position, self._radius, WINDOW_RIM)
        return left, top, right, bottom

    def judged(
        self,
        sight: Sight,
        rotation: FloatArray,
        position: FloatArray,
        fit: Fit | None = None,
        left_out: Sequence[int] = (),
    ) -> tuple[Array, Evidence]:
        """What the label maps show of a pose (3, 3), (3,) [m], (C,) of SEEN, and what this is evidence of.

        Args:
            sight: the label maps.
            rotation: world_from_object.
            position: of the object's centre.
            fit: what else is known of the pose; None: nothing.
            left_out: cameras that are witnesses only.
        """
        seen, lags, stands = np.zeros(len(self._still), SEEN), self._still, 0.0
        if fit is not None:
            seen, stands = fit.cameras.copy(), fit.stands
            lags = self._still if fit.lags is None else fit.lags
        witnesses = np.zeros(len(seen), bool)
        witnesses[list(left_out)] = True
        evidence = evidence_at(
            self.lenses, sight.labels, sight.pictures, self.faces, (rotation, position, lags),
            stands=stands, left_out=witnesses, seen=seen,
        )  # fmt: skip
        return seen, evidence

    def resized(self, sight: Sight, fit: Fit) -> float:
        """Log odds of a body of which an edge is shorter or longer, over the object as a fit has it."""
        place = fit.rotation, fit.position, self._still if fit.lags is None else fit.lags
        return resized_at(self.lenses, sight.labels, sight.pictures, self.faces, place, seen=fit.cameras)

    def begun(
        self, sight: Sight, place: FloatArray, which: range, left_out: tuple[int, ...] = ()
    ) -> list[Hypothesis]:
        """Hypotheses at a place (3,) [m] after a first step of alignment; which: of its likeliest turns."""
        if not which:
            return []
        pictures, turns = sight.without(*left_out).pictures, np.empty((which.stop, 3, 3))
        likely_rotations(self.lenses, sight.labels, pictures, self.faces, place, self.grid, turns)
        tried = [Hypothesis(0.0, turns[k], place, left_out) for k in which]
        return self._aligned(sight, tried, REACHES[:1])

    def rounds(self, sight: Sight) -> Callable[[Round], list[Hypothesis]]:
        """A function that gives the hypotheses of a round that were not begun before, best first."""
        likeliest = self.positions(sight.labels, sight.pictures, EVERYWHERE.places)
        places, tried = list[FloatArray](), list[int]()

        def next_of(wide: Round) -> list[Hypothesis]:
            places.extend(islice(likeliest, max(wide.places - len(places), 0)))
            tried.extend([0] * (len(places) - len(tried)))
            found: list[Hypothesis] = []
            for k, place in enumerate(places[: wide.places]):
                most = wide.others if k else wide.first
                found += self.begun(sight, place, range(tried[k], most))
                tried[k] = max(tried[k], most)
            used = np.flatnonzero(sight.used).tolist()
            for c in used if wide.without and len(used) > ENOUGH else ():
                for place in self.positions(sight.labels, sight.without(c).pictures, 1):
                    found += self.begun(sight, place, range(wide.without), (c,))
            best = sorted(found, key=lambda one: -one.score)[:ALIGNED]
            aligned = [hypothesis for one in best for hypothesis in self._aligned(sight, [one], REACHES[1:])]
            return sorted(aligned, key=lambda one: -one.score)

        return next_of

    def near(self, sight: Sight, poses: Sequence[tuple[FloatArray, FloatArray]]) -> Hypothesis | None:
        """What poses (3, 3), (3,) [m] that may be off by 3 cm and 30° lead to, at best."""
        tried = [Hypothesis(0.0, rotation, position) for rotation, position in poses]
        return max(self._aligned(sight, tried, FAR_REACHES), key=lambda one: one.score, default=None)

    def _aligned(self, sight: Sight, tried: Sequence[Hypothesis], reaches: Array) -> list[Hypothesis]:
        """Those hypotheses, aligned by steps of these reaches, whose edges are to be seen.

        They were found without the same cameras, and all judge them.
        """
        if not tried:
            return []
        rotations = np.array([one.rotation for one in tried])
        positions, scores = np.array([one.position for one in tried]), np.empty(len(tried))
        try_hypotheses(
            self.lenses, sight.labels, sight.without(*tried[0].left_out).pictures, sight.pictures, self.faces,
            rotations, positions, reaches, scores,
        )  # fmt: skip
        return [
            one._replace(score=score, rotation=rotations[k], position=positions[k])
            for k, (one, score) in enumerate(zip(tried, scores.tolist(), strict=True))
            if score > IMPOSSIBLE / 2
        ]
