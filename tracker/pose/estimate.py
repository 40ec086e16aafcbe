"""The way from pictures to a pose: search, align, contest, refine, choose. Nothing is remembered."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.pose.agreement import disagreement
from tracker.pose.align import IMPOSSIBLE, explanation_score, hear, try_hypotheses
from tracker.pose.fit import LIKELY, SEEN, Fit, Lag, OwnViews, Start
from tracker.pose.judge import (
    EXPECTED,
    MIN_TRUST,
    alone,
    confidence,
    possible,
    rank,
    refusal,
    settled,
    supporters,
    trust,
    unanimous,
)
from tracker.pose.refine import FOLLOWING, FROM_THERE, ROUGH, SCHEDULE, Refiner, Schedule
from tracker.pose.result import Status
from tracker.pose.rivals import reversed_in_depth, turned_about_face
from tracker.pose.rotations import likely_rotations, rotation_grid
from tracker.pose.scale import label_camera, label_factors, window
from tracker.pose.support import table_of
from tracker.pose.views import Reader, Sight
from tracker.pose.votes import PositionSearch
from tracker.segmentation.color_model import ColorModel

REACHES = np.array([5, 4, 3])
"""Reach of the label transitions' search in each alignment step [px of the label map]."""

FAR_REACHES = np.array([8, 6, 4, 3])
"""The same from a prediction."""

TURNS, FEW = 10, 5
"""Turns that are tried at the likeliest place, and at each other one."""

POSITIONS = 8
"""Positions that are tried, at most."""

REFINED = 3
"""Poses that are refined, at most."""

MIN_PIXELS = 20
"""Face-coloured pixels in all label maps below which there is no object."""

ALIGNED = 12
"""Hypotheses that are aligned to the end, at most: the best after a first step."""

CLOSE = 0.85
"""Least explanation of the label maps, of the best fit's, for a hypothesis to be refined."""

CLEAR = 0.5
"""Probability that a fit sits on the object, where all cameras see it, from which no other place is tried."""

COMPETING, BEHIND = 4, 3.5
"""Hypotheses that compete, and rank by which one may be behind the best after a rough step and still win."""

ENOUGH = 2
"""Cameras that must support a pose that was found without another one."""

RECONCILABLE = 16.8
"""Squared distance of two fits of one pose, in standard deviations: 99 % are nearer (χ² of 6)."""

SAME_POSITION, SAME_ROTATION = 0.12, 0.15
"""Two hypotheses nearer than this [radii of the object, rad] are the same pose."""

WINDOW_RIM = 12.0
"""Beyond an object where it is expected, for where it may be instead [px of the label map]."""

ODD, FEW_ODD = 1.2, 0.6
"""Pixels of the label map in the object's colours beside or on the wrong face, over the pieces of its edges,
from which a camera may see it elsewhere; and from which one may that can use few edges."""

USED = 8.0
"""Weight of the pieces of edges on which a camera's own view must rest."""

SHOWN = 30, 0.15
"""Least number of pixels in the object's colours, and least share of those expected, for a camera that can
use few edges to be asked."""

BETTER = 20, 0.1
"""By how many pixels, and by which share of those expected, its own pose must explain the label map better:
a camera alone has many poses that do so a little."""

TURNED = math.radians(12)
"""Turn beyond which its own pose is another optimum."""


class Hypothesis(NamedTuple):
    """Where the object may be, as the label maps have it."""

    score: float
    """How well it explains them."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    position: FloatArray
    """(3,) [m]."""
    sight: Sight
    """In which light it was found."""
    left_out: tuple[int, ...] = ()
    """Cameras without which it was found."""


class Found(NamedTuple):
    """A fit, and what it was found in."""

    fit: Fit
    sight: Sight


def _ranked(one: Found) -> float:
    return rank(one.fit)


def _clear(fit: Fit) -> bool:
    """Whether it leaves no doubt as to where the object is, only as to how it is turned."""
    return unanimous(fit) and trust(fit) > CLEAR


def apart(one: Fit | Hypothesis, other: Fit | Hypothesis, radius: float) -> bool:
    """Whether two poses differ by more than alignment on label maps leaves open; radius: of the box [m]."""
    # The trace of R R2ᵀ is 1 + 2 cos of the angle between them.
    if np.vdot(one.rotation, other.rotation) < 1 + 2 * math.cos(SAME_ROTATION):
        return True
    moved = one.position - other.position
    return math.sqrt(moved @ moved) > SAME_POSITION * radius


def reconcilable(one: Fit, other: Fit) -> bool:
    """Whether two fits may be of one pose, as their covariances have it: then they are no rivals."""
    apart = np.concatenate([one.position - other.position, so3.log(one.rotation @ other.rotation.T)])
    covariance = one.covariance + other.covariance
    return bool(np.isfinite(covariance).all() and apart @ np.linalg.solve(covariance, apart) < RECONCILABLE)


def lead(best: Fit, fits: Sequence[Fit], radius: float) -> float:
    """Log odds of the best fit over all clearly different ones together; infinite where there are none.

    fits: best first; radius: of the object [m].
    """
    different = [best]
    for fit in fits:
        if all(apart(fit, other, radius) for other in different) and not reconcilable(best, fit):
            different.append(fit)
    if len(different) == 1:
        return math.inf
    behind = [rank(best) - rank(rival) for rival in different[1:]]
    least = min(behind)
    return least - math.log(sum(math.exp(least - one) for one in behind))


def reader_of(box: Box, rig: CameraRig, colors: ColorModel) -> tuple[Reader, list[Camera]]:
    """What reads a rig's pictures of an object, and the cameras of its label maps."""
    factors = label_factors(rig.cameras, box, rig.arena)
    small = [label_camera(camera, factor) for camera, factor in zip(rig.cameras, factors, strict=True)]
    shape = (len(small), max(c.height for c in small), max(c.width for c in small))
    return Reader(colors, factors, shape), small


class PoseEstimator:
    """Finds one cuboid in the pictures of fixed cameras; any number of threads may use it at once."""

    def __init__(self, box: Box, rig: CameraRig, colors: ColorModel, support: bool = True) -> None:
        cameras = rig.cameras
        self.box, self.arena = box, rig.arena
        self.reader, small = reader_of(box, rig, colors)
        self.small = stack_lenses(small)
        self.positions = PositionSearch(small, box, rig.arena)
        self.refiner = Refiner(box, cameras, colors.label_table, table_of(rig.arena, support))
        self._grid = rotation_grid()
        self._faces = box.half, box.face_labels
        self._still = np.zeros((len(cameras), 6))

    def window(self, c: int, position: FloatArray) -> tuple[int, int, int, int]:
        """Left, top, right, bottom of what an object there fills of camera c's label map, and some more."""
        left, top, right, bottom = window(self.small, c, position, self.box.radius, WINDOW_RIM)
        return left, top, right, bottom

    def find(
        self,
        images: Sequence[Image | None],
        timing: dict[str, float],
        *,
        thorough: bool = True,
        lag: Lag | None = None,
    ) -> Fit | Status:
        """The surest pose in pictures (H, W, 3), None where a camera gave none, or why there is none.

        Most pictures are settled by the first hypothesis. Where its fit is not sure, others enter a contest:
        at other places and turns, in the light of the grey world, without each of the cameras, of which one
        that is tinted, mirrored or of another moment spoils what the others see. How well they explain the
        label maps decides which few are refined.

        Args:
            images: one for each camera.
            timing: gains the milliseconds of each stage.
            thorough: whether there is a contest.
            lag: how far the pictures lag behind, None where they were taken at once.
        """
        laps = [time.perf_counter()]
        pictures = self.reader.lit(images)
        laps.append(time.perf_counter())
        sight = self.reader.labelled(images, pictures)
        laps.append(time.perf_counter())
        found = self._found(sight, thorough, lag)
        laps.append(time.perf_counter())
        for k, stage in enumerate(("light", "segmentation", "pose")):
            timing[stage] = timing.get(stage, 0.0) + 1e3 * (laps[k + 1] - laps[k])
        return found

    def _found(self, sight: Sight, thorough: bool, lag: Lag | None) -> Fit | Status:
        """The surest pose that the pictures show, or why there is none; arguments as of `find`."""
        if sight.pictures["colored"].sum() < MIN_PIXELS:
            return Status.NO_OBJECT_COLORS
        found: list[Found] = []
        reason = Status.TOO_FEW_PIXELS
        for hypotheses in self._hypotheses(sight, found, thorough):
            reason = Status.INCONSISTENT_VIEWS
            self._contest(hypotheses, found, lag)
            if found and settled(max(found, key=_ranked).fit):
                break
        if not found:
            return reason
        best = max(found, key=_ranked)
        if thorough and not settled(best.fit):
            found.append(best._replace(fit=self.without_worst(best.sight, best.fit, lag)))
        if alone(best.fit):
            rivals = self._rivals(best.sight, best.fit, LIKELY, lag, reversed_in_depth, turned_about_face)
            found += [Found(rival, best.sight) for rival in rivals]
        return self._best(found, lag)

    def _best(self, found: list[Found], lag: Lag | None) -> Fit | Status:
        """The likeliest fit, if it is accepted, or why it is not."""
        found.sort(key=_ranked, reverse=True)
        fits = [one.fit for one in found]
        reason = None
        # A pose beyond the arena is none, but what looks like one more than like the best is doubtful.
        for best, sight in sorted(found, key=lambda one: not possible(one.fit)):
            fit = replace(best, lead=lead(best, fits, self.box.radius))
            if fit.left_out and (supporters(fit) < ENOUGH or trust(fit) < MIN_TRUST):
                continue
            refused = refusal(fit)
            if refused is None:
                return self.examined(sight, fit, lag)
            reason = reason or refused
            if refused is not Status.AMBIGUOUS:
                break
        return reason or Status.INCONSISTENT_VIEWS

    def _hypotheses(self, sight: Sight, found: list[Found], thorough: bool) -> Iterator[list[Hypothesis]]:
        """Hypotheses in the order in which they are worth a try, each lot worked out when it is asked for.

        At the likeliest place the likeliest turn, then others. Where these leave doubt: other places, what is
        seen without each of the cameras, and what is seen in the light of the grey world.

        Args:
            sight: of the pictures.
            found: what the hypotheses given so far have led to.
            thorough: whether more than the first is wanted.
        """
        places = self.positions(sight.labels, sight.pictures, POSITIONS)
        first = next(places, None)
        if first is None:
            return
        yield self._likeliest(self._begun(sight, [first], slice(1)))
        if not thorough:
            return
        hypotheses = self._begun(sight, [first], slice(1, TURNS))
        if found and _clear(found[0].fit):
            yield self._likeliest(hypotheses)
            return
        hypotheses += self._begun(sight, places, slice(FEW))
        used = np.flatnonzero(sight.used).tolist()
        for c in used if len(used) > ENOUGH else ():
            rest = sight.without(c).pictures
            hypotheses += self._begun(sight, self.positions(sight.labels, rest, 1), slice(FEW), (c,))
        if self.reader.colors.normalise:
            grey = self.reader.in_grey_world(sight)
            hypotheses += self._begun(grey, self.positions(grey.labels, grey.pictures, 1), slice(FEW))
        yield self._likeliest(hypotheses)

    def _contest(self, hypotheses: list[Hypothesis], found: list[Found], lag: Lag | None) -> None:
        """Refine the best of hypotheses that explain the label maps about as well as the best fit, or better.

        A rough step of the refinement tells which are clearly behind, or the same as better ones.
        """
        chosen: list[Hypothesis] = []
        known: list[Fit | Hypothesis] = [one.fit for one in found]
        least = CLOSE * max((explanation_score(one.fit.cameras) for one in found), default=0.0)
        for one in hypotheses:
            if len(chosen) == COMPETING or (one.score < least and np.count_nonzero(one.sight.used) > 1):
                break
            if all(apart(one, other, self.box.radius) for other in (*known, *chosen)):
                chosen.append(one)
        if len(chosen) < 2:
            found += [self._refined(one, SCHEDULE, lag) for one in chosen]
            return
        rough = [(self._refined(one, ROUGH, lag).fit, one) for one in chosen]
        rough.sort(key=lambda pair: -rank(pair[0]))
        for fit, one in rough:
            if len(found) == REFINED or rank(fit) < rank(rough[0][0]) - BEHIND:
                return
            if all(apart(fit, other, self.box.radius) for other in known):
                begun = one._replace(rotation=fit.rotation, position=fit.position)
                found.append(self._refined(begun, FROM_THERE, lag))
                known += [fit, found[-1].fit]
                if settled(found[-1].fit):
                    return

    def _refined(self, one: Hypothesis, schedule: Schedule, lag: Lag | None) -> Found:
        """The fit of a hypothesis by a schedule."""
        sight = one.sight.without(*one.left_out)
        fit = self.refine(sight, one.rotation, one.position, schedule, lag=lag, ask=schedule is not ROUGH)
        return Found(self.heard(one.sight, fit, one.left_out) if one.left_out else fit, one.sight)

    def heard(self, sight: Sight, fit: Fit, left_out: Sequence[int]) -> Fit:
        """A fit with what all cameras of a sight say of it, also those that were left out when it was made.

        Those are witnesses only: colours beside the object count as seen elsewhere, since a picture that is
        noisy or flooded shows them all over.
        """
        cameras = self._heard(sight, fit.rotation, fit.position, fit.lags, fit.cameras)
        which = list(left_out)
        cameras["elsewhere"][which] += cameras["extra"][which]
        cameras["extra"][which] = 0
        return replace(fit, cameras=cameras, left_out=tuple(which))

    def without_worst(self, sight: Sight, fit: Fit, lag: Lag | None = None) -> Fit:
        """The fit, or that without the camera which agrees least, where this leaves less doubt."""
        used = [c for c in np.flatnonzero(sight.used).tolist() if c not in fit.left_out]
        if len(used) <= ENOUGH:
            return fit
        seen = fit.cameras
        against = seen["wrong"] + seen["extra"] + seen["elsewhere"] - seen["agree"]
        left_out = (*fit.left_out, max(used, key=lambda c: float(against[c])))
        rest = sight.without(*left_out)
        other = self.refine(rest, fit.rotation, fit.position, FOLLOWING, fit.end, lag, ask=True)
        other = self.heard(sight, other, left_out)
        better = supporters(other) >= max(ENOUGH, supporters(fit)) and confidence(other) > confidence(fit)
        return other if better else fit

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
        self, sight: Sight, poses: Sequence[tuple[FloatArray, FloatArray]], lag: Lag | None = None
    ) -> Fit | None:
        """As `follow`, from the best of poses that may be off by 3 cm and 30°."""
        rotations = np.array([rotation for rotation, _ in poses])
        positions, scores = np.array([position for _, position in poses]), np.empty(len(poses))
        self._align(sight, sight.pictures, rotations, positions, FAR_REACHES, scores)
        best = int(np.argmax(scores))
        if scores[best] < IMPOSSIBLE / 2:
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
        fit = self.refiner(sight.pictures, rotation, position, schedule, start, lag, ask=ask)
        cameras = self._heard(sight, fit.rotation, fit.position, fit.lags, fit.cameras)
        lowest = float(fit.position[2] - np.abs(fit.rotation[2]) @ self.box.half)
        height = float(fit.covariance[2, 2])
        std = math.sqrt(max(height, 0.0)) if math.isfinite(height) else 0.0
        return replace(fit, cameras=cameras, inside=self.arena.holds(fit.position, lowest, std))

    def _rivals(
        self,
        sight: Sight,
        fit: Fit,
        start: Start,
        lag: Lag | None,
        *kinds: Callable[..., Iterator[tuple[FloatArray, FloatArray]]],
    ) -> list[Fit]:
        """What else the one camera that sees the object may see; `start` and `lag` as of `refine`."""
        camera = self.small["position"][int(np.argmax(fit.cameras["inliers"]))]
        least = CLOSE * explanation_score(fit.cameras)
        return [
            self.refine(sight, *rival, FOLLOWING, start, lag)
            for kind in kinds
            for rival in kind(fit.rotation, fit.position, self.box.half, camera)
            if explanation_score(self._heard(sight, *rival, fit.lags)) > least
        ]

    def _heard(
        self,
        sight: Sight,
        rotation: FloatArray,
        position: FloatArray,
        lags: FloatArray | None = None,
        seen: Array | None = None,
    ) -> Array:
        """What the label maps show of a pose (3, 3), (3,) [m], put into a copy of `seen` (C,) of SEEN.

        lags: (C, 6) by which cameras saw the object moved [m, rad]; None: they did not.
        """
        seen = np.zeros(len(self._still), SEEN) if seen is None else seen.copy()
        lags = self._still if lags is None else lags
        hear(self.small, sight.labels, sight.pictures, self._faces, rotation, position, lags, seen)
        return seen

    def _align(
        self,
        sight: Sight,
        pictures: Array,
        rotations: FloatArray,
        positions: FloatArray,
        reaches: Array,
        scores: FloatArray,
    ) -> None:
        """Align poses (n, 3, 3), (n, 3) in place on pictures (C,); all of the sight's judge them."""
        try_hypotheses(
            self.small, sight.labels, pictures, sight.pictures, self._faces, rotations, positions, reaches,
            scores,
        )  # fmt: skip

    def _begun(
        self, sight: Sight, places: Iterable[FloatArray], which: slice, left_out: tuple[int, ...] = ()
    ) -> list[Hypothesis]:
        """Hypotheses after a first step of alignment; which: of the likeliest turns at each place."""
        pictures = sight.without(*left_out).pictures
        turns = np.empty((which.stop, 3, 3))
        tried: list[tuple[FloatArray, FloatArray]] = []
        for place in places:
            likely_rotations(self.small, sight.labels, pictures, self._faces, place, self._grid, turns)
            tried += [(turn.copy(), place) for turn in turns[which]]
        if not tried:
            return []
        rotations, positions = (np.array(column) for column in zip(*tried, strict=True))
        scores = np.empty(len(tried))
        self._align(sight, pictures, rotations, positions, REACHES[:1], scores)
        return [
            Hypothesis(score, rotation, position, sight, left_out)
            for score, rotation, position in zip(scores.tolist(), rotations, positions, strict=True)
        ]

    def _likeliest(self, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """The best of hypotheses that have been begun, best first, aligned to the end."""
        hypotheses.sort(key=lambda one: -one.score)
        result = []
        for one in hypotheses[:ALIGNED]:
            rotations, positions, scores = one.rotation[None], one.position[None], np.empty(1)
            pictures = one.sight.without(*one.left_out).pictures
            self._align(one.sight, pictures, rotations, positions, REACHES[1:], scores)
            if scores[0] > IMPOSSIBLE / 2:
                result.append(one._replace(score=float(scores[0])))
        return sorted(result, key=lambda one: -one.score)

    def examined(self, sight: Sight, fit: Fit, lag: Lag | None = None) -> Fit:
        """The fit with a judgement of the calibration, or without where fewer than two cameras see it.

        Cameras whose label maps show the object beside the pose are asked by a search of their own, since
        their edges lie beyond the strips.
        """
        own = fit.own
        if own is None:
            used = sight.without(*fit.left_out)
            own = self.refine(used, fit.rotation, fit.position, FOLLOWING, fit.end, lag, ask=True).own
        assert own is not None
        views = OwnViews(*(column.copy() for column in own))
        for c in _astray(sight, fit, own):
            other = self._own_search(sight, fit, c, lag)
            if other is not None:
                views.information[c], views.moved[c], views.inliers[c] = other
        if np.count_nonzero(views.information[:, 0, 0] > 0.0) < 2:
            return replace(fit, own=views)
        found = disagreement(
            views, self.small["rotation"], self.small["position"], fit.position, self.box.radius
        )
        return replace(fit, own=views, disagreement=found)

    def _own_search(
        self, sight: Sight, fit: Fit, c: int, lag: Lag | None
    ) -> tuple[FloatArray, FloatArray, float] | None:
        """One camera's part of OwnViews, as it is found by itself near the pose, if it is."""
        only = sight.without(*(k for k in range(len(sight.used)) if k != c))
        rotations, positions = fit.rotation[None].copy(), fit.position[None].copy()
        self._align(only, only.pictures, rotations, positions, FAR_REACHES, np.empty(1))
        seen = self._heard(only, rotations[0], positions[0], seen=fit.cameras)
        if not self._explains_better(seen[c], fit, c):
            return None
        other = self.refine(only, rotations[0], positions[0], start=fit.end, lag=lag, ask=True)
        turned = so3.log(other.rotation @ fit.rotation.T)
        if other.own is None or other.own.inliers[c] < USED or np.linalg.norm(turned) > TURNED:
            return None
        if not self._explains_better(other.cameras[c], fit, c):
            return None
        moved = other.own.moved[c] + np.concatenate([other.position - fit.position, turned])
        return other.own.information[c], moved, float(other.own.inliers[c])

    @staticmethod
    def _explains_better(seen: Any, fit: Fit, c: int) -> bool:
        """Whether what a camera shows of another pose, a record of SEEN, explains it clearly better."""
        before = fit.cameras[c]
        gain = sum(sign * (int(seen[k]) - int(before[k])) for k, sign in _FOR_AND_AGAINST)
        return bool(gain > max(BETTER[0], BETTER[1] * before["predicted"]))


_FOR_AND_AGAINST = ("agree", 1), ("extra", -1), ("wrong", -1)


def _astray(sight: Sight, fit: Fit, own: OwnViews) -> list[int]:
    """Cameras that may see the object elsewhere."""
    result = []
    for c in np.flatnonzero(sight.used).tolist():
        seen = fit.cameras[c]
        if seen["predicted"] < EXPECTED:
            continue
        odd = int(seen["extra"]) + int(seen["wrong"])
        shown = odd + int(seen["agree"]) > max(SHOWN[0], SHOWN[1] * seen["predicted"])
        few = own.inliers[c] < USED and shown
        if c in fit.left_out or odd > (FEW_ODD if few else ODD) * seen["expected"]:
            result.append(c)
    return result
