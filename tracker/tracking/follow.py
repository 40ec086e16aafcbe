"""One tracking step: predict, measure near the prediction or else anywhere, filter; the tracker's state."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, Image
from tracker.errors import TrackerError
from tracker.pose.agreement import spread
from tracker.pose.estimate import PoseEstimator
from tracker.pose.fit import Fit, Lag, Seen, Start
from tracker.pose.hypotheses import ENOUGH
from tracker.pose.judge import against, alone, log_odds, rank, refusal, supporters, trust
from tracker.pose.result import Observation, Status
from tracker.pose.schedule import FOLLOWING
from tracker.pose.views import Hidden
from tracker.tracking.belief import Belief, TrackingOptions, measured
from tracker.tracking.cameras import EVERY, READ, Agreement, CameraMemory, after, looked_at, unfrozen, usable
from tracker.tracking.motion import START_VELOCITY, MotionState

TOGETHER, ALONE = 1.2, 2.2
"""Smallest log odds of a fit near the prediction that make a search everywhere unnecessary: with several
cameras, and with one, in which wrong poses look better."""

MORE_EXTRA = 0.08
"""Largest increase in the share of object-coloured pixels outside the outline, since the last search
everywhere, for a fit to be kept: a fit that slid along an edge looks good, too, but leaves them uncovered."""

MOSTLY = 0.8
"""Share of these pixels above which one camera counts as showing most of them."""


class Memory(NamedTuple):
    """The tracker's state between frames."""

    belief: Belief
    """The estimated motion of the object."""
    cameras: tuple[CameraMemory, ...]
    lights: Array | None = None
    """(C,) of PICTURE: the light of each camera's image as last measured."""
    as_they_are: bool = False
    """Whether the object was last found in images whose greys keep their colour and brightness."""
    shaded: bool = False
    """Whether it was last found with colours read as those of faces in shade."""
    start: Start | None = None
    """The unknowns other than the pose in the last frame; None: none yet."""
    agreement: Agreement = Agreement()
    """The estimate of the calibration's errors."""
    extra: float = 0.0
    """Result of `lasting` at the last search everywhere."""
    resized: float = -math.inf
    """Log odds of a body with one edge shorter or longer, as last computed."""
    latest: Observation | None = None
    """The last answer."""

    @classmethod
    def empty(cls, cameras: int, options: TrackingOptions | None = None) -> Memory:
        """Return the state of a tracker that has seen nothing."""
        return cls(Belief(options or TrackingOptions()), (CameraMemory(),) * cameras)

    def after(self, found: Fit) -> Memory:
        """Return the state after a search everywhere; light of another kind is measured again."""
        memory = self._replace(extra=lasting(found), resized=found.resized, shaded=found.shaded)
        if found.as_they_are == self.as_they_are:
            return memory
        return memory.without_light()._replace(as_they_are=found.as_they_are)

    def without_light(self) -> Memory:
        """Return the state without what was measured of the light."""
        return self._replace(lights=None, cameras=tuple(one._replace(age=None) for one in self.cameras))


class Gate:
    """Lets one thread in; others get an error, or wait if they come at the same instant."""

    def __init__(self) -> None:
        self._locks = dict[int, threading.Lock]()

    def lock(self) -> threading.Lock:
        """Return the lock to use in a `with` statement, which Ctrl-C cannot leave locked.

        Raises:
            TrackerError: it is locked.
        """
        # A forked process has no thread that would release an inherited lock.
        lock = self._locks.setdefault(os.getpid(), threading.Lock())
        if lock.locked():
            raise TrackerError(
                "update: found another call of update or reset in progress on this tracker, expected one at "
                "a time: use one tracker for each recording (detect may be called from many threads)"
            )
        return lock


class Follower:
    """Tracks one object from frame to frame; stateless: the state is a `Memory`.

    Args:
        estimator: finds and refines poses.
        table: height of the table [m]; None: there is none.
    """

    def __init__(self, estimator: PoseEstimator, table: float | None) -> None:
        self._estimator, self._size = estimator, 2 * estimator.box.half
        self.body = estimator.box, -math.inf if table is None else table

    def __call__(
        self,
        images: Sequence[Image | None],
        timestamp: float,
        delays: Sequence[float],
        memory: Memory,
        hidden: Hidden = None,
    ) -> tuple[Observation, Memory]:
        """Return the answer to the images of a timestamp [s], and the state after them.

        delays: age of each camera's image [s]; hidden: masks of pixels that do not count as evidence.

        Raises:
            TrackerError: the timestamp is earlier than the last one.
        """
        belief, expected = memory.belief.advance(timestamp)
        cameras, given, uses = unfrozen(memory.cameras, *usable(images))
        timing: dict[str, float] = {}
        given = self._estimator.reader.unveiled(given, timing)
        memory, lag = memory._replace(belief=belief, cameras=cameras), None
        # An unused image makes nothing uncertain, however old it is.
        delays = [0.0 if image is None else delay for image, delay in zip(given, delays, strict=True)]
        if (longest := max(delays)) > 0.0:
            velocity, covariance = np.zeros(6), START_VELOCITY
            if expected is not None and belief.motion is not None:
                # The mean velocity since then varies as much as the velocity does in a third of the time.
                ahead = belief.motion.predicted(longest / 3.0).state
                velocity, covariance = expected.velocity, ahead.covariance[6:, 6:]
            lag = Lag(np.array(delays), velocity, covariance)
        outcome, memory = self._measure(given, expected, lag, memory, timing, hidden)
        pose, status, reason = None, Status.COASTING, None
        if isinstance(outcome, Status):
            reason = outcome
        else:
            agreement = memory.agreement.after(outcome, expected, lagging=longest > READ)
            wide = spread(agreement.size, supporters(outcome)) if self._estimator.stated else 0.0
            belief, status = belief.updated(outcome, expected, agreement.fitting, wide)
            uses = after(uses, outcome)
            if status is Status.COASTING:  # found, but not accepted yet: does not update the agreement
                unlikely = trust(outcome) < belief.options.min_confidence
                reason = against(outcome) if unlikely else Status.AMBIGUOUS
            else:
                memory = memory._replace(agreement=agreement)
                pose = measured(outcome, agreement.fitting, wide, self._size)
                status = Status.INCONSISTENT_VIEWS if agreement.contradicts else status
        filtered = belief.estimate(*self.body)
        if filtered is None:
            status = Status.LOST
        answer = Observation(pose, filtered, status, timing, reason, uses)
        return answer, memory._replace(belief=belief, latest=answer)

    def _measure(
        self,
        images: Sequence[Image | None],
        expected: MotionState | None,
        lag: Lag | None,
        memory: Memory,
        timing: dict[str, float],
        hidden: Hidden,
    ) -> tuple[Fit | Status, Memory]:
        """Find the object near its prediction, else anywhere; return a fit or a reason, and the new state."""
        if all(image is None for image in images):
            return Status.NO_OBJECT_COLORS, memory
        near = None
        if expected is None:
            memory = memory.without_light()  # the light may have changed since the object was lost
        else:
            near, memory = self._near(images, expected, lag, memory, timing, hidden)
            if near is not None and kept(near, memory.extra) and memory.belief.plausible(expected, near):
                return near, memory
        found = self._estimator.find(images, timing, thorough=near is None, lag=lag, hidden=hidden)
        if near is not None and (isinstance(found, Status) or rank(found) <= rank(near)):
            found = near.changed(as_they_are=memory.as_they_are, resized=memory.resized)
        if isinstance(found, Status):
            return found, memory._replace(extra=0.0)
        return found, memory.after(found)

    def _near(
        self,
        images: Sequence[Image | None],
        expected: MotionState,
        lag: Lag | None,
        memory: Memory,
        timing: dict[str, float],
        hidden: Hidden,
    ) -> tuple[Fit | None, Memory]:
        """Find the object at its prediction or near it; return the fit, else None, and the new state."""
        laps, estimator = [time.perf_counter()], self._estimator
        cameras, fresh = looked_at(memory.cameras, images)
        pictures = estimator.reader.lit(images, memory.lights, fresh, as_they_are=memory.as_they_are)
        sight = estimator.reader.labelled(images, pictures, expected.position, hidden, memory.shaded)
        laps.append(time.perf_counter())
        due = memory.agreement.due(expected)
        place = expected.rotation, expected.position
        fit = estimator.refiner(sight, *place, FOLLOWING, memory.start, lag, memory.resized, ask=due)
        good = kept(fit, memory.extra)
        if not good and kept(other := estimator.without_worst(sight, fit, lag), memory.extra):
            fit, good = other, True
        memory = memory._replace(cameras=cameras, lights=sight.pictures, start=fit.end)
        if not good:
            for best in estimator.search.near(sight, [place, memory.belief.last_pose or place])[:1]:
                far = estimator.refiner(
                    sight, best.rotation, best.position, lag=lag, resized=memory.resized, ask=due
                )
                fit = far if refusal(fit) is not None or rank(far) > rank(fit) else fit
        if (memory.agreement.age + 1) % EVERY == 0:
            memory = memory._replace(resized=estimator.search.resized(sight, fit))
        if due:
            fit = estimator.examined(sight, fit, lag)
        laps.append(time.perf_counter())
        timing["segmentation"], timing["pose"] = 1e3 * (laps[1] - laps[0]), 1e3 * (laps[2] - laps[1])
        return (fit if refusal(fit) is None else None), memory


def extra(counts: Sequence[Seen]) -> float:
    """Return the object-coloured pixels outside the outline in some cameras, relative to those predicted."""
    return sum(one.extra for one in counts) / max(sum(one.predicted for one in counts), 1.0)


def lasting(fit: Fit) -> float:
    """Return `extra`; of more than two cameras, omit one that shows most of it, as it may see the object."""
    most = MOSTLY * sum(one.extra for one in fit.counts)
    counts = [one for one in fit.counts if one.predicted > 0]
    if len(counts) > ENOUGH:
        counts = [one for one in counts if one.extra <= most]
    return extra(counts)


def kept(fit: Fit, before: float) -> bool:
    """Whether a fit near the prediction is so certain that no search everywhere is needed.

    before: share of object-coloured pixels outside the outline that are known to belong to other things.
    """
    if not fit.converged or refusal(fit) is not None:
        return False
    if log_odds(fit) < (ALONE if alone(fit) else TOGETHER):
        return False
    return extra(fit.counts) <= before + MORE_EXTRA
