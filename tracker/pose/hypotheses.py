"""Hypotheses from label maps: positions, rotations, alignment, and how well they explain the maps."""

import math
from collections.abc import Callable, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.objects.model import Box
from tracker.pose.align import IMPOSSIBLE, count_labels, try_hypotheses
from tracker.pose.evidence import NUMBERS, resized
from tracker.pose.fit import SEEN, Fit
from tracker.pose.rotations import likely_rotations, rotation_grid
from tracker.pose.sizes import FOOT_STD
from tracker.pose.views import Reader, Sight
from tracker.pose.votes import PositionSearch

REACHES = np.array([5, 4, 3])
"""Reach of the search for label transitions in each alignment step [px of the label map]."""

FAR_REACHES = np.array([8, *REACHES])
"""The same, starting from a predicted pose."""

AROUND = 6.0 * np.array([(math.cos(a), math.sin(a)) for a in np.arange(8) * math.pi / 4])
"""Displacements (8, 2) from which a camera's own search also starts [px of the label map]: alignment fails
for a narrow object placed where it does not overlap what the camera sees."""

ALIGNED = 10
"""Maximum number of hypotheses per round that are aligned to the end: the best after a first step."""

ENOUGH = 2
"""Minimum number of cameras that must support a pose found with another camera left out."""

SAME_POSE = 0.12
"""Hypotheses closer than this in position [radii of the object] and rotation [rad] are the same pose."""


class Round(NamedTuple):
    """How many hypotheses have been started by the end of a round."""

    places: int
    """Number of positions, the likeliest ones."""
    rotations: int
    """Number of rotations at each of them."""
    without: bool = False
    """Whether the likeliest position that is found with each camera left out in turn counts, too."""


LIKELIEST, NEARBY, EVERYWHERE, TURNS = Round(1, 1), Round(4, 2), Round(7, 6, True), Round(1, 10)
"""Of 391 scenes that the first hypothesis did not settle, 3 % reached the right pose only from a position
found without one camera, none from a position beyond the seventh."""


class Hypothesis(NamedTuple):
    """A possible pose."""

    score: float
    """How well it explains the label maps."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    position: FloatArray
    """(3,) [m]."""
    left_out: tuple[int, ...] = ()
    """Cameras that were left out when it was found."""


def apart(one: Fit | Hypothesis, other: Fit | Hypothesis, radius: float) -> bool:
    """Whether two poses differ by more than the error alignment leaves; radius: of the object [m]."""
    # The trace of R R2ᵀ is 1 + 2 cos of the angle between them.
    if np.vdot(one.rotation, other.rotation) < 1 + 2 * math.cos(SAME_POSE):
        return True
    moved = one.position - other.position
    return math.sqrt(moved @ moved) > SAME_POSE * radius


class Search:
    """Search for an object in label maps alone, those of images that `reader` reads; without memory."""

    def __init__(self, box: Box, rig: CameraRig, reader: Reader) -> None:
        self.lenses = reader.lenses
        self.positions = PositionSearch(reader.label_cameras(rig), box, rig.arena)
        self.grid, self.faces = rotation_grid(), (box.half, box.face_labels)
        self._radius, self._still = box.radius, np.zeros((len(rig), 6))
        self._box, self._table = box, -math.inf if rig.arena.table is None else rig.arena.table

    def counted(
        self, sight: Sight, rotation: FloatArray, position: FloatArray, shifts: FloatArray | None = None
    ) -> Array:
        """Count what the label maps show of a pose (3, 3), (3,) [m]: (C,) of SEEN; shifts: as of a Fit."""
        seen, shifts = np.zeros(len(self._still), SEEN), self._still if shifts is None else shifts
        count_labels(self.lenses, sight.labels, sight.pictures, self.faces, rotation, position, shifts, seen)
        return seen

    def resized(self, sight: Sight, fit: Fit) -> float:
        """Log odds of a body with one edge shorter or longer than the object of a fit."""
        place = fit.rotation, fit.position, self._still if fit.shifts is None else fit.shifts
        maps = self.lenses, sight.labels, sight.pictures
        # As far below as colours may end above the table.
        room = max(self._box.lowest(fit.position, fit.rotation) - self._table, 0.0) + FOOT_STD
        return float(resized(*maps, self.faces, place, room, fit.cameras, NUMBERS))

    def begun(
        self, sight: Sight, place: FloatArray, which: range, left_out: tuple[int, ...] = ()
    ) -> list[Hypothesis]:
        """Return hypotheses at a place (3,) [m], not aligned yet; which: ranks of its likeliest rotations."""
        pictures, turns = sight.without(*left_out).pictures, np.empty((which.stop, 3, 3))
        likely_rotations(self.lenses, sight.labels, pictures, self.faces, place, self.grid, turns)
        return [Hypothesis(0.0, turns[k], place, left_out) for k in which]

    def rounds(self, sight: Sight) -> Callable[[Round], list[Hypothesis]]:
        """Return a function that gives the new hypotheses of a round, best first."""
        floods = self.positions.floods(sight.labels, sight.pictures)
        if floods:
            sight = sight._replace(labels=sight.labels.copy())
        for c, color in floods:
            sight.labels[c][sight.labels[c] == color] = 0
        views = self.positions.views(sight.labels, sight.pictures)
        likeliest = self.positions(views, sight.labels, sight.pictures, EVERYWHERE.places)
        places, tried = list[FloatArray](), list[int]()

        def next_of(wide: Round) -> list[Hypothesis]:
            places.extend(islice(likeliest, max(wide.places - len(places), 0)))
            tried.extend([0] * (len(places) - len(tried)))
            found: list[Hypothesis] = []
            for k, place in enumerate(places[: wide.places]):
                found += self.begun(sight, place, range(tried[k], wide.rotations))
                tried[k] = wide.rotations
            used = sight.used if wide.without else []
            for c in used if len(used) > ENOUGH else ():
                for place in self.positions(views, sight.labels, sight.without(c).pictures, 1):
                    found += self.begun(sight, place, range(wide.rotations), (c,))
            if len(found) <= ALIGNED:
                return self._aligned(sight, found, REACHES)
            return self._aligned(sight, self._aligned(sight, found, REACHES[:1])[:ALIGNED], REACHES[1:])

        return next_of

    def alone(self, sight: Sight, c: int, rotation: FloatArray, position: FloatArray) -> Hypothesis | None:
        """Return the best hypothesis near a pose (3, 3), (3,) [m] for camera c, the only one of `sight`."""
        lens = self.lenses[c]
        size = float(np.linalg.norm(lens["position"] - position) / lens["focal"][0])
        beside = position + size * (AROUND @ lens["rotation"][:2])
        return next(iter(self.near(sight, [(rotation, place) for place in (position, *beside)])), None)

    def near(
        self, sight: Sight, poses: Sequence[tuple[FloatArray, FloatArray]], *, still: bool = False
    ) -> list[Hypothesis]:
        """Hypotheses reached from poses (3, 3), (3,) [m] that may be off by 3 cm and 30°, best first.

        still: whether to score them as they are, without alignment.
        """
        reaches = FAR_REACHES[:0] if still else FAR_REACHES
        return self._aligned(sight, [Hypothesis(0.0, *pose) for pose in poses], reaches)

    def _aligned(self, sight: Sight, tried: Sequence[Hypothesis], reaches: Array) -> list[Hypothesis]:
        """Align hypotheses in steps with these reaches; return those whose edges are found, best first.

        All cameras score a hypothesis, even those left out when it was found.
        """
        found = []
        for left_out in dict.fromkeys(one.left_out for one in tried):
            alike = [one for one in tried if one.left_out == left_out]
            rotations = np.array([one.rotation for one in alike])
            positions, scores = np.array([one.position for one in alike]), np.empty(len(alike))
            try_hypotheses(
                self.lenses, sight.labels, sight.without(*left_out).pictures, sight.pictures, self.faces,
                rotations, positions, reaches, scores,
            )  # fmt: skip
            found += [
                Hypothesis(score, rotations[k], positions[k], left_out)
                for k, score in enumerate(scores.tolist())
                if score > IMPOSSIBLE / 2
            ]
        return sorted(found, key=lambda one: -one.score)
