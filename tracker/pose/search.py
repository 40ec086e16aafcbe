"""From pictures to the surest pose: in one light or another, and without a camera that spoils the rest."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from tracker.conventions import Image
from tracker.pose.estimate import PoseEstimator
from tracker.pose.evidence import EvidenceReader
from tracker.pose.examine import examined
from tracker.pose.fit import Fit
from tracker.pose.judge import MIN_TRUST, alone, confidence, refusal, supporters, sure, trust, unanimous
from tracker.pose.result import Status
from tracker.pose.sight import Sight
from tracker.pose.start import Lag

SURE = 0.8
"""Confidence below which the light is judged a second time, by the grey world, and below which cameras are
left out in turn."""

ENOUGH = 2
"""Cameras that must support a pose that was found without another one."""


def search(
    reader: EvidenceReader,
    estimator: PoseEstimator,
    images: Sequence[Image | None],
    timing: dict[str, float],
    *,
    thorough: bool = True,
    lag: Lag | None = None,
) -> Fit | Status:
    """The surest pose in a set of images (H, W, 3), None where a camera gave none, or why there is none.

    The light is judged by the scene's most frequent chromaticity; where that gives no sure answer, by the
    grey world as well. Where neither does, and a camera does not see the object there, each is left out in
    turn: one that is tinted, mirrored or of another moment spoils what the others see. The surest answer
    counts, with a judgement of how far off the calibration is.

    Args:
        reader: of the pictures.
        estimator: of the pose.
        images: one for each camera.
        timing: gains the milliseconds of each stage.
        thorough: whether to look a second time.
        lag: how far the pictures lag behind, None where they were taken at once.
    """
    best, status, sight = _surest(reader, estimator, images, timing, thorough, lag)
    if best is None or sight is None:
        return status or Status.INCONSISTENT_VIEWS
    lap = time.perf_counter()
    best = examined(estimator, sight, best, lag)
    timing["pose"] += 1e3 * (time.perf_counter() - lap)
    return best


def _surest(
    reader: EvidenceReader,
    estimator: PoseEstimator,
    images: Sequence[Image | None],
    timing: dict[str, float],
    thorough: bool,
    lag: Lag | None,
) -> tuple[Fit | None, Status | None, Sight | None]:
    """The surest pose, or why there is none, and what it was found in."""
    best: Fit | None = None
    status: Status | None = None
    clearest: Sight | None = None
    for sight in _lights(reader, estimator, images, timing, thorough):
        lap = time.perf_counter()
        clearest = clearest or sight
        if best is not None and alone(best) and sure(best):
            # Only how far away it is leaves doubt: another look, no other search.
            outcome: Fit | Status = estimator.look_again(sight, best, lag)
        else:
            outcome = estimator.estimate(sight, thorough=thorough, lag=lag)
        refused = outcome if isinstance(outcome, Status) else refusal(outcome)
        if isinstance(outcome, Fit) and refused is None:
            if best is None or confidence(outcome) > confidence(best):
                best, clearest = outcome, sight
        else:
            status = status or refused
        timing["pose"] = timing.get("pose", 0.0) + 1e3 * (time.perf_counter() - lap)
        if best is not None and confidence(best) > SURE:
            return best, None, clearest
    if thorough and clearest is not None and (best is None or not unanimous(best)):
        lap = time.perf_counter()
        best = _without_one(estimator, clearest, best, lag)
        timing["pose"] += 1e3 * (time.perf_counter() - lap)
    return best, status, clearest


def _lights(
    reader: EvidenceReader,
    estimator: PoseEstimator,
    images: Sequence[Image | None],
    timing: dict[str, float],
    thorough: bool,
) -> Iterator[Sight]:
    """What the pictures show in the light of their greys, then in that of the grey world."""
    lap = time.perf_counter()
    seen = [None if image is None else reader.see(c, image) for c, image in enumerate(images)]
    timing["light"] = 1e3 * (time.perf_counter() - lap)
    for grey_world in (False, True) if reader.colors.normalise and thorough else (False,):
        lap = time.perf_counter()
        sight = estimator.sight([None if one is None else reader.read(one, grey_world) for one in seen])
        timing["segmentation"] = timing.get("segmentation", 0.0) + 1e3 * (time.perf_counter() - lap)
        yield sight


def _without_one(estimator: PoseEstimator, sight: Sight, best: Fit | None, lag: Lag | None) -> Fit | None:
    """The surest of the best pose so far and those found with each camera left out, by at least as many.

    The camera that shows most of the object's colours is left out first.
    """
    if np.count_nonzero(sight.used) <= ENOUGH:
        return best
    for c in np.argsort(-sight.colored, kind="stable"):
        if not sight.used[c]:
            continue
        outcome = estimator.estimate(sight.without(c), lag=lag)
        if isinstance(outcome, Status) or refusal(outcome) is not None:
            continue
        # What the camera that was left out says counts.
        fit = estimator.heard(sight, outcome, [int(c)], lag)
        least = ENOUGH if best is None else max(ENOUGH, supporters(best))
        if trust(fit) < MIN_TRUST or supporters(fit) < least:
            continue
        if best is None or confidence(fit) > confidence(best):
            best = fit
        if confidence(best) > SURE:
            break
    return best
