"""Finds the object near where its motion lets it be expected, from what the pictures show around there."""

from __future__ import annotations

import time
from collections.abc import Sequence

from tracker.conventions import FloatArray, Image
from tracker.pose.estimate import PoseEstimator
from tracker.pose.fit import Fit, Lag, Start
from tracker.pose.judge import alone, log_odds, rank, refusal
from tracker.pose.views import Sight
from tracker.tracking.cameras import looked_at
from tracker.tracking.doubt import held_back
from tracker.tracking.filter import MotionState
from tracker.tracking.memory import Memory

TOGETHER, ALONE = 1.2, 2.2
"""Least log odds of a fit near where the object was expected, with which it is not looked for farther away:
where several cameras see it, and one alone, to which wrong poses look better."""

MOST_EXTRA = 0.08
"""Share of pixels in the object's colours beyond its outline up to which it is not: slid along an edge, it
fits too, but leaves part of itself."""


class Follower:
    """Looks for the object where it is expected; has no memory of its own.

    Args:
        estimator: of the pose.
    """

    def __init__(self, estimator: PoseEstimator) -> None:
        self._estimator = estimator

    def __call__(
        self,
        images: Sequence[Image | None],
        expected: MotionState,
        memory: Memory,
        lag: Lag | None,
        timing: dict[str, float],
    ) -> tuple[Fit | None, Memory]:
        """The object where it is expected, or not far from there, else None; and what was learned."""
        lap = time.perf_counter()
        sight, memory = self._glance(images, memory, expected.position)
        split = time.perf_counter()
        timing["segmentation"] = 1e3 * (split - lap)
        unused = held_back(memory.cameras, images)
        due = memory.agreement.due(expected)
        fit = self._near(sight, unused, expected, memory.start, lag, ask=due)
        if not settled(fit):
            other = self._estimator.without_worst(sight, fit, lag)
            fit = other if settled(other) else fit
        memory = memory._replace(start=fit.end)
        if not settled(fit):
            hypotheses = [(expected.rotation, expected.position)]
            if memory.belief.last_pose is not None:
                hypotheses.append(memory.belief.last_pose)
            far = self._estimator.follow_far(sight.without(*unused), hypotheses, lag)
            if far is not None and unused:
                far = self._estimator.heard(sight, far, unused)
            if far is not None and (refusal(fit) is not None or rank(far) > rank(fit)):
                fit = far
        if due:
            fit = self._estimator.examined(sight, fit, lag)
        timing["pose"] = 1e3 * (time.perf_counter() - split)
        return (fit if refusal(fit) is None else None), memory

    def _near(
        self,
        sight: Sight,
        left_out: Sequence[int],
        expected: MotionState,
        start: Start,
        lag: Lag | None,
        *,
        ask: bool = False,
    ) -> Fit:
        """The fit nearest to the expected pose, made without some cameras, which are heard."""
        used = sight.without(*left_out) if left_out else sight
        fit = self._estimator.follow(used, expected.rotation, expected.position, start, lag, ask=ask)
        return self._estimator.heard(sight, fit, left_out) if left_out else fit

    def _glance(
        self, images: Sequence[Image | None], memory: Memory, position: FloatArray
    ) -> tuple[Sight, Memory]:
        """What the images show around a position (3,) [m], and what is remembered of their cameras."""
        cameras, fresh = looked_at(memory.cameras, images)
        windows = [self._estimator.search.window(c, position) for c in range(len(images))]
        reader = self._estimator.reader
        sight = reader.labelled(images, reader.lit(images, memory.lights, fresh), windows)
        return sight, memory._replace(cameras=cameras, lights=sight.pictures)


def settled(fit: Fit | None) -> bool:
    """Whether a fit is so sure that no other needs to be tried."""
    if fit is None or not fit.converged or refusal(fit) is not None:
        return False
    if log_odds(fit) < (ALONE if alone(fit) else TOGETHER):
        return False
    return fit.total("extra") <= MOST_EXTRA * fit.total("predicted")
