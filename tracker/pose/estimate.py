"""From one set of images to a pose, without memory: search, align, compete, refine, choose."""

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.objects.model import Box
from tracker.pose.agreement import disagreement
from tracker.pose.align import EXPECTED
from tracker.pose.fit import Fit, Lag, OwnViews
from tracker.pose.hypotheses import ENOUGH, EVERYWHERE, LIKELIEST, NEARBY, TURNS, Hypothesis, Search, apart
from tracker.pose.judge import (
    MIN_VIEW,
    alone,
    confidence,
    rank,
    refusal,
    settled,
    supporters,
    well_placed,
)
from tracker.pose.refiner import Refiner
from tracker.pose.result import Status
from tracker.pose.rivals import lead, shifted_along, turned_about_face
from tracker.pose.schedule import FIRST, FOLLOWING, FROM_THERE, SCHEDULE, Schedule
from tracker.pose.views import Hidden, Reader, Sight
from tracker.segmentation.color_model import ColorModel

REFINED = 3
"""Maximum number of hypotheses that compete, of poses refined, and of those that look like the best one."""

CLOSE = 0.95
"""A hypothesis is refined if it explains the label maps at least this well, relative to the best fit; so is a
pose that looks like that fit."""

PLAUSIBLE = 0.5
"""Explanation of the label maps per camera above which a hypothesis is refined before others are sought: 84 %
of 970 that led to the object scored higher, 94 % of 234 others lower."""

ODD = 1.2
"""Pixels of the label map in the object's colours beside it or on the wrong face, per expected piece of edge,
above which a camera may see the object elsewhere."""

BETTER = 0.1
"""Share of the expected pixels by which a camera's own pose must explain its label map better: many poses
explain a single label map slightly better."""

TURNED = math.radians(12)
"""A camera's own pose that is rotated by more than this is a different optimum [rad]."""


class PoseEstimator:
    """Find one cuboid in images of fixed cameras; thread-safe."""

    def __init__(self, box: Box, rig: CameraRig, colors: ColorModel, support: bool = True) -> None:
        self.box, self._radius = box, box.radius
        self.reader = Reader(box, rig, colors)
        self.search = Search(box, rig, self.reader)
        self.refiner = Refiner(box, rig, self.reader, support)
        # Whether any file states deviations; otherwise the calibration counts as exact.
        self.stated = bool(self.refiner.model.stated.any())

    def find(
        self,
        images: Sequence[Image | None],
        timing: dict[str, float],
        *,
        thorough: bool = True,
        lag: Lag | None = None,
        hidden: Hidden = None,
        as_they_are: bool = False,
    ) -> Fit | Status:
        """Return the most certain pose in images (H, W, 3), or why there is none.

        The first hypothesis settles most images. If its fit is in doubt, others compete: with other positions
        and rotations, and with each camera left out in turn, since one image that is tinted, mirrored or from
        another moment spoils the vote. The few that explain the label maps best are refined. If no pose is
        accepted although face colours are in view, a first hypothesis is tried in the images as they are: a
        white or black table is not as bright as the platform's greys, and a coloured one is not grey.

        Args:
            images: one for each camera; None for a missing one.
            timing: receives the duration of each stage [ms].
            thorough: whether further hypotheses compete.
            lag: how old the images are; None: all were taken at the same time.
            hidden: masks of pixels whose labels and edges count neither for nor against a pose.
            as_they_are: whether greys keep their colour and brightness.
        """
        laps = [time.perf_counter()]
        pictures = self.reader.lit(images, as_they_are=as_they_are)
        laps.append(time.perf_counter())
        sight = self.reader.labelled(images, pictures, hidden=hidden)
        laps.append(time.perf_counter())
        found: Fit | Status = Status.NO_OBJECT_COLORS
        if sum(sight.pictures["colored"].tolist()) >= EXPECTED:
            candidates = self.candidates(sight, thorough, lag)
            flooded = not candidates and self.search.positions.floods(sight.labels, sight.pictures)
            why = Status.OTHER_OBJECT if flooded else Status.TOO_FEW_PIXELS
            found = self._best(sight, candidates, lag) if candidates else why
        laps.append(time.perf_counter())
        for k, stage in enumerate(("light", "segmentation", "pose")):
            timing[stage] = timing.get(stage, 0.0) + 1e3 * (laps[k + 1] - laps[k])
        refused = isinstance(found, Status) and found is not Status.NO_OBJECT_COLORS
        if refused and thorough and self.reader.colors.normalise:
            other = self.find(images, timing, thorough=False, lag=lag, hidden=hidden, as_they_are=True)
            return found if isinstance(other, Status) else other.changed(as_they_are=True)
        return found

    def candidates(self, sight: Sight, thorough: bool = True, lag: Lag | None = None) -> list[Fit]:
        """Return the fits from which the best is chosen; arguments as in `find`.

        Hypotheses come in rounds until a fit is settled. If none explains the label maps well, those of the
        next round are added before any is refined.
        """
        fits, waiting = list[Fit](), list[Hypothesis]()
        next_of, wide = self.search.rounds(sight), LIKELIEST
        for most in range(1, REFINED + 1):
            waiting = sorted(waiting + next_of(wide), key=lambda one: -one.score)
            last = not thorough or wide in (EVERYWHERE, TURNS)
            if last or (waiting and waiting[0].score > PLAUSIBLE * len(sight.used)):
                fits += self._contest(sight, waiting, fits, lag, REFINED if last else most)
                waiting = []
            if last or any(map(settled, fits)):
                break
            best = max(fits, key=rank, default=None)
            # A single camera never settles it.
            wider = EVERYWHERE if wide is NEARBY or (best is not None and alone(best)) else NEARBY
            wide = TURNS if best is not None and well_placed(best) else wider
        if not fits:
            return fits
        best = max(fits, key=rank)
        if thorough and not settled(best):
            fits.append(self.without_worst(sight, best, lag))
        return fits + self._alike(sight, best, lag)

    def _best(self, sight: Sight, fits: list[Fit], lag: Lag | None) -> Fit | Status:
        """Return the most likely fit if it is accepted, or why it is not."""
        fits = sorted(fits, key=rank, reverse=True)
        reason = None
        # A pose outside the arena is refused, but if it outranks the best pose inside, that one is in doubt.
        for best in sorted(fits, key=lambda one: not one.inside):
            fit = best.changed(lead=lead(best, fits, self._radius), resized=self.search.resized(sight, best))
            doubtful = fit.inside and not settled(fit)
            fit, shown = self._in_shade(sight, fit, lag) if doubtful else (fit, sight)
            refused = refusal(fit)
            if refused is None:
                return self.examined(shown, fit, lag)
            reason = reason or refused
            if refused is not Status.AMBIGUOUS:
                break
        return reason or Status.INCONSISTENT_VIEWS

    def _contest(
        self, sight: Sight, hypotheses: list[Hypothesis], before: list[Fit], lag: Lag | None, most: int
    ) -> list[Fit]:
        """Fit the hypotheses that explain the label maps about as well as the best earlier fit, or better.

        There are at most `most` fits, earlier ones included. After the refinement's first step, duplicates of
        better ones are dropped.
        """
        chosen: list[Hypothesis] = []
        known: list[Fit | Hypothesis] = [*before]
        explained = self.search.near(sight, [(fit.rotation, fit.position) for fit in before], still=True)
        least = CLOSE * max((one.score for one in explained), default=0.0)
        several = len(sight.used) > 1
        for one in hypotheses:
            if len(chosen) == REFINED or (one.score < least and several):
                break
            if all(apart(one, other, self._radius) for other in (*known, *chosen)):
                chosen.append(one)
        if len(chosen) < 2:
            return [self._fitted(sight, one, SCHEDULE, lag) for one in chosen]
        begun = sorted((self._fitted(sight, one, FIRST, lag) for one in chosen), key=rank, reverse=True)
        found: list[Fit] = []
        for fit in begun:
            if len(before) + len(found) == most:
                break
            if all(apart(fit, other, self._radius) for other in known):
                found.append(self._fitted(sight, fit, FROM_THERE, lag))
                known += [fit, found[-1]]
                if settled(found[-1]):
                    break
        return found

    def _fitted(self, sight: Sight, one: Hypothesis | Fit, schedule: Schedule, lag: Lag | None) -> Fit:
        """Fit a hypothesis, or go on with a fit, by a schedule."""
        place, ask = (one.rotation, one.position), schedule is not FIRST
        return self.refiner(sight, *place, schedule, lag=lag, left_out=one.left_out, ask=ask)

    def without_worst(self, sight: Sight, fit: Fit, lag: Lag | None = None) -> Fit:
        """Refit without the camera that agrees least; return whichever fit is more certain."""
        used = [c for c in sight.used if c not in fit.left_out]
        if len(used) <= ENOUGH:
            return fit
        seen = fit.cameras
        against = seen["wrong"] + seen["extra"] + seen["elsewhere"] - seen["agree"]
        left_out = (*fit.left_out, max(used, key=lambda c: float(against[c])))
        other = self.refiner(
            sight, fit.rotation, fit.position, FOLLOWING, fit.end, lag, fit.resized,
            left_out=left_out,
        )  # fmt: skip
        better = supporters(other) >= max(ENOUGH, supporters(fit)) and confidence(other) > confidence(fit)
        return other if better else fit

    def _in_shade(self, sight: Sight, fit: Fit, lag: Lag | None) -> tuple[Fit, Sight]:
        """Refit with colours read as those of faces in shade; return the likelier fit with its images."""
        dark = self.reader.labelled(sight.images, sight.pictures.copy(), hidden=sight.hidden, shaded=True)
        other = self.refiner(dark, fit.rotation, fit.position, FOLLOWING, fit.end, lag, left_out=fit.left_out)
        other = other.changed(lead=fit.lead, resized=self.search.resized(dark, other))
        return (other, dark) if confidence(other) > confidence(fit) else (fit, sight)

    def _alike(self, sight: Sight, fit: Fit, lag: Lag | None) -> list[Fit]:
        """Return fits of other poses that look like a fit: shifted, or turned about the face in view."""
        rotation, position, half = fit.rotation, fit.position, self.box.half
        poses = [(rotation, other) for other in shifted_along(fit, self.box)]
        camera = self.search.lenses["position"][int(np.argmax(fit.cameras["inliers"]))]
        poses += [(other, position) for other in turned_about_face(rotation, position, half, camera)]
        if not poses:
            return []
        least = CLOSE * self.search.near(sight, [(rotation, position)], still=True)[0].score
        others = [one for one in self.search.near(sight, poses, still=True) if one.score > least][:REFINED]
        return [self._fitted(sight, one._replace(left_out=fit.left_out), SCHEDULE, lag) for one in others]

    def examined(self, sight: Sight, fit: Fit, lag: Lag | None = None) -> Fit:
        """Return the fit with a judgement of the calibration, if two or more cameras see the object.

        If a label map shows the object beside the pose, that camera's image is searched on its own, since
        there the object's edges lie outside the strips.
        """
        views = fit.own
        assert views is not None
        for c, seen in enumerate(fit.counts):
            astray = c in fit.left_out or seen.extra + seen.wrong > ODD * seen.expected
            asked = astray and seen.predicted >= EXPECTED and c in sight.used
            if asked and (other := self._own_search(sight, fit, c, lag)) is not None:
                views = OwnViews(*(column.copy() for column in views))
                views.information[c], views.moved[c], views.inliers[c] = other
        if sum(known > 0.0 for known in views.information[:, 0, 0].tolist()) < 2:
            return fit.changed(own=views)
        found = disagreement(views, self.search.lenses, fit.position, self._radius)
        return fit.changed(own=views, disagreement=found)

    def _own_search(
        self, sight: Sight, fit: Fit, c: int, lag: Lag | None
    ) -> tuple[FloatArray, FloatArray, float] | None:
        """Search one camera's image near the pose; return its row of OwnViews, None if nothing is found."""
        only = sight.without(*(k for k in sight.used if k != c))
        near = self.search.alone(only, c, fit.rotation, fit.position)
        if near is None:
            return None
        # Count again: in images that were left out, the fit counts colours beside the object as elsewhere.
        before = self.search.counted(only, fit.rotation, fit.position, fit.shifts)[c]
        if not _explains_better(self.search.counted(only, near.rotation, near.position)[c], before):
            return None
        other = self.refiner(only, near.rotation, near.position, start=fit.end, lag=lag)
        turned = so3.log(other.rotation @ fit.rotation.T)
        if other.own is None or other.own.inliers[c] < MIN_VIEW or np.linalg.norm(turned) > TURNED:
            return None
        if not _explains_better(other.cameras[c], before):
            return None
        moved = other.own.moved[c] + np.concatenate([other.position - fit.position, turned])
        return other.own.information[c], moved, float(other.own.inliers[c])


def _explains_better(seen: Any, before: Any) -> bool:
    """Whether a camera's record of SEEN for a pose explains its label map clearly better than the old one."""
    gain = seen["agree"] - seen["extra"] - seen["wrong"] - before["agree"] + before["extra"] + before["wrong"]
    return bool(gain > BETTER * before["predicted"])
