"""The way from views to a pose: search, align, refine, choose. Nothing is remembered."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.pose.contest import FROM_AFAR, REVERSED, Stage, apart, contest, lead
from tracker.pose.evidence import View
from tracker.pose.fit import Fit
from tracker.pose.hypotheses import align
from tracker.pose.hypotheses.positions import PositionSearch
from tracker.pose.hypotheses.rivals import reversed_in_depth, turned_about_face
from tracker.pose.hypotheses.rotations import RotationSearch
from tracker.pose.judge import alone, possible, rank, settled, sure
from tracker.pose.result import Status
from tracker.pose.scale import label_camera, label_factors, window
from tracker.pose.sight import Sight
from tracker.pose.solve.refiner import Attempt, Refiner
from tracker.pose.solve.schedule import FOLLOWING, SCHEDULE, Schedule
from tracker.pose.solve.support import table_of
from tracker.pose.start import LIKELY, Lag, Start

ALIGN_REACHES = np.array([5, 4, 3])
"""Reach of the label transitions' search in each alignment step [px of the label map]."""

FAR_REACHES = np.array([8, 6, 4, 3])
"""The same from a prediction."""

FEW, MANY = 2, 10
"""Rotations that are tried at the best position, and at each where that did not settle it."""

POSITIONS = 4
"""Positions that are tried, at most."""

REFINED = 5
"""Different hypotheses that are refined in each of the two rounds, at most."""

MIN_PIXELS = 20
"""Face-coloured pixels in all label maps below which there is no object."""

LONELY_MANY, LONELY_REFINED = 8, 3
"""The same two where one camera alone sees the object, in each of two rounds: most lead to the same poses."""

CLOSE = 0.7
"""Least explanation of what one camera sees, of the best one's, for a hypothesis to be refined."""

WINDOW_RIM = 12.0
"""Beyond an object where it is expected, for where it may be instead [px of the label map]."""

Hypothesis = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and position (3,) [m]."""


class PoseEstimator:
    """Finds one cuboid in the views of fixed cameras; any number of threads may use it at once."""

    def __init__(self, box: Box, rig: CameraRig, label_table: Array, support: bool = True) -> None:
        cameras = rig.cameras
        self.box, self.arena = box, rig.arena
        self.factors = label_factors(cameras, box, rig.arena)
        small = [label_camera(camera, factor) for camera, factor in zip(cameras, self.factors, strict=True)]
        self.small = stack_lenses(small)
        self.positions = PositionSearch(self.small, box, rig.arena)
        self.rotations = RotationSearch(self.small, box)
        self.refiner = Refiner(box, cameras, label_table, table_of(rig.arena, support))
        self._shape = (len(cameras), max(c.height for c in small), max(c.width for c in small))

    def sight(self, views: Sequence[View | None]) -> Sight:
        """The views of the cameras, in their order; None where there is no picture."""
        return Sight.of(views, self._shape)

    def heard(self, sight: Sight, fit: Fit, left_out: Sequence[int], lag: Lag | None = None) -> Fit:
        """A fit with what all cameras of a sight say of it, also those that were left out when it was made.

        Those are witnesses only: colours beside the object count as seen elsewhere, since a picture that is
        noisy or flooded shows them all over.
        """
        cameras, which = fit.cameras.copy(), list(left_out)
        lags = np.zeros((len(cameras), 6)) if lag is None else lag.moved
        sight.hear(self.small, self.box, fit.rotation, fit.position, lags, cameras)
        cameras["elsewhere"][which] += cameras["extra"][which]
        cameras["extra"][which] = 0
        return replace(fit, cameras=cameras, left_out=tuple(which))

    def window(self, c: int, position: FloatArray) -> tuple[int, int, int, int]:
        """Left, top, right, bottom of what an object there fills of camera c's label map, and some more."""
        left, top, right, bottom = window(self.small, c, position, self.box.radius, WINDOW_RIM)
        return left, top, right, bottom

    def estimate(self, sight: Sight, *, thorough: bool = True, lag: Lag | None = None) -> Fit | Status:
        """The best pose for what is seen.

        Most images are settled by the first hypothesis. Where its fit is not sure, more are aligned
        and refined, and a different pose that fits nearly as well counts against the best; unless a
        search that is not thorough will do.
        """
        integrals, pixels = self.positions.integrals(sight.labels, sight.used)
        if pixels < MIN_PIXELS:
            return Status.NO_OBJECT_COLORS
        positions = self.positions.positions(sight.labels, integrals, sight.used, POSITIONS)
        first = next(positions, None)
        if first is None:
            return Status.TOO_FEW_PIXELS
        fits: list[Fit] = []
        # One camera alone may see a single face, which fits at four turns: it never settles the matter.
        lonely = thorough and np.count_nonzero(sight.used) == 1
        if not lonely:
            fits = self._refined(sight, self._align(sight, [first], FEW), lag)
        if thorough and not (fits and settled(fits[-1])):
            lonely = lonely or bool(fits and alone(max(fits, key=rank)))
            fits.extend(
                self._lonely(sight, first, positions, lag)
                if lonely
                else self._refined(sight, self._align(sight, chain([first], positions), MANY), lag)
            )
        if not fits:
            return Status.INCONSISTENT_VIEWS
        best = max(fits, key=rank)
        if alone(best):
            fits.extend(self._rivals(sight, best, LIKELY, lag, reversed_in_depth, turned_about_face))
        fits.sort(key=rank, reverse=True)
        # A pose beyond the arena is none, but what looks like one more than like the best is doubtful.
        best = next(filter(possible, fits), fits[0])
        return replace(best, lead=lead(best, fits, self.box.radius))

    def _refined(self, sight: Sight, hypotheses: Iterable[Hypothesis], lag: Lag | None) -> list[Fit]:
        """Fits of hypotheses, up to the first that settles the matter."""
        fits: list[Fit] = []
        for hypothesis in hypotheses:
            fits.append(self.refine(sight, *hypothesis, lag=lag, ask=True))
            if settled(fits[-1]):
                break
        return fits

    def _lonely(
        self, sight: Sight, first: FloatArray, others: Iterable[FloatArray], lag: Lag | None
    ) -> list[Fit]:
        """The best fits near the first position, and unless one is sure near others: one camera sees it."""
        fits: list[Fit] = []
        for candidates in ([first], others):
            hypotheses = self._align(sight, candidates, LONELY_MANY, LONELY_REFINED, CLOSE)
            fits.extend(self._contest(sight, hypotheses, SCHEDULE, FROM_AFAR, LIKELY, lag))
            if any(map(sure, fits)):
                break
        return fits

    def _contest(
        self,
        sight: Sight,
        hypotheses: Iterable[Hypothesis],
        schedule: Schedule,
        stages: Sequence[Stage],
        start: Start,
        lag: Lag | None,
        best: Fit | None = None,
    ) -> list[Fit]:
        """Different fits of those hypotheses that may be the best; see `contest`."""
        refiner = self.refiner
        attempts = [refiner.begin(sight.views, *hypothesis, start, lag) for hypothesis in hypotheses]

        def advance(attempt: Attempt, until: int | None) -> Fit:
            refiner.advance(attempt, schedule, until)
            return self._fit(sight, attempt)

        return contest(attempts, advance, stages, self.box.radius, best)

    def look_again(self, sight: Sight, fit: Fit, lag: Lag | None = None) -> Fit:
        """A fit refined once more, on views whose colours were read in another way."""
        again = self.refine(sight, fit.rotation, fit.position, FOLLOWING, fit.end, lag)
        return replace(again, lead=fit.lead)

    def follow(
        self,
        sight: Sight,
        rotation: FloatArray,
        position: FloatArray,
        start: Start,
        lag: Lag | None = None,
        *,
        ask: bool = False,
    ) -> Fit:
        """The fit nearest to a predicted pose (3, 3), (3,) [m]; a prediction off by a few pixels will do.

        `start`: what the unknowns beside the pose were a moment ago; `lag`: how far the pictures lag behind,
        None where they were taken at once; `ask` as of `refine`.
        """
        fit = self.refine(sight, rotation, position, FOLLOWING, start, lag, ask=ask)
        if alone(fit):
            fit = max([fit, *self._rivals(sight, fit, start, lag, reversed_in_depth)], key=rank)
        return fit

    def follow_far(
        self, sight: Sight, hypotheses: Sequence[Hypothesis], lag: Lag | None = None
    ) -> Fit | None:
        """As `follow`, from the best of poses that may be off by 3 cm and 30°."""
        rotations = np.array([rotation for rotation, _ in hypotheses])
        positions, scores = np.array([position for _, position in hypotheses]), np.empty(len(hypotheses))
        align.try_hypotheses(
            self.small, sight.labels, sight.used, self.box.half, self.box.face_labels,
            rotations, positions, FAR_REACHES, scores,
        )  # fmt: skip
        best = int(np.argmax(scores))
        if scores[best] < align.IMPOSSIBLE / 2:
            return None
        return self.refine(sight, rotations[best], positions[best], lag=lag)

    def refine(
        self,
        sight: Sight,
        rotation: FloatArray,
        position: FloatArray,
        schedule: Schedule = SCHEDULE,
        start: Start = LIKELY,
        lag: Lag | None = None,
        *,
        ask: bool = False,
    ) -> Fit:
        """The fit nearest to a hypothesis (3, 3), (3,) [m]; `ask`: with what each camera by itself sees."""
        attempt = self.refiner.begin(sight.views, rotation, position, start, lag)
        self.refiner.advance(attempt, schedule)
        own = self.refiner.alone(attempt) if ask else None
        return replace(self._fit(sight, attempt), own=own)

    def _fit(self, sight: Sight, attempt: Attempt) -> Fit:
        """Where a refinement stands, with what the label maps say of it."""
        end = self.refiner.end(attempt)
        sight.hear(self.small, self.box, end.rotation, end.position, end.lags, end.cameras)
        lowest = float(end.position[2] - np.abs(end.rotation[2]) @ self.box.half)
        height_std = math.sqrt(max(end.covariance[2, 2], 0.0)) if np.isfinite(end.covariance[2, 2]) else 0.0
        inside = self.arena.holds(end.position, lowest, height_std)
        return Fit(
            end.position, end.rotation, end.covariance, end.cameras, end.converged, end.iterations, end.end,
            inside, end.stands,
        )  # fmt: skip

    def _rivals(
        self,
        sight: Sight,
        fit: Fit,
        start: Start,
        lag: Lag | None,
        *kinds: Callable[..., Iterator[Hypothesis]],
    ) -> list[Fit]:
        """What else the one camera that sees the object may see; `start` and `lag` as of `refine`."""
        camera = self.small["position"][int(np.argmax(fit.cameras["inliers"]))]
        rivals = [
            rival for kind in kinds for rival in kind(fit.rotation, fit.position, self.box.half, camera)
        ]
        return self._contest(sight, rivals, FOLLOWING, REVERSED, start, lag, fit)

    def _align(
        self,
        sight: Sight,
        candidates: Iterable[FloatArray],
        count: int,
        most: int = REFINED,
        close: float = 0.0,
    ) -> Iterator[Hypothesis]:
        """Different hypotheses after alignment on the label maps, best first; worked out when asked for.

        count: rotations that are tried at each position; most: hypotheses that are wanted; close: least
        score, of the best one's.
        """
        rotations: list[FloatArray] = []
        positions: list[FloatArray] = []
        scores: list[float] = []
        for position in candidates:
            turned, _ = self.rotations(sight.labels, sight.used, position, count)
            moved = np.repeat(position[None], count, axis=0)
            score = np.empty(count)
            align.try_hypotheses(
                self.small, sight.labels, sight.used, self.box.half, self.box.face_labels,
                turned, moved, ALIGN_REACHES, score,
            )  # fmt: skip
            rotations.extend(turned)
            positions.extend(moved)
            scores.extend(score)
        chosen: list[Hypothesis] = []
        for k in np.argsort(-np.array(scores), kind="stable"):
            if scores[k] < align.IMPOSSIBLE / 2 or len(chosen) == most:
                break
            if chosen and scores[k] < close * max(scores):
                break
            if all(apart(rotations[k], positions[k], *other, self.box.radius) for other in chosen):
                chosen.append((rotations[k], positions[k]))
                yield chosen[-1]
