"""What the dice task costs, next to reference work on the same images in the same process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.measure.timing import one_thread, reference_work
from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.tasks import rearrange_dice

GOAL_SEED = 31
"""Of the goals, which have nothing to do with where the dice are."""


def speed_rows(rig: CameraRig, triplets: Sequence[Sequence[Image]], rounds: int) -> list[dict[str, Any]]:
    """One row for each kind of work: `work`, `median_ms`, `p99_ms`, `reference_ms`, `ratio`, `times`.

    Every kind of work is done in turn with the reference work; the ratio is the median of the pairs'. The
    first row is what the task's reward costs while its goal stays.

    Args:
        rig: the cameras.
        triplets: the images of each scene.
        rounds: how often each scene is timed, after once uncounted.
    """
    rng = np.random.default_rng(GOAL_SEED)
    times: dict[str, list[tuple[float, float]]] = {}
    with one_thread():
        for images in triplets:
            works = _works(rig, images, rearrange_dice.sample_goal(rng))
            for name, work in works.items():
                work()
                reference_work(images)
                for _ in range(rounds):
                    start = time.perf_counter()
                    work()
                    middle = time.perf_counter()
                    reference_work(images)
                    times.setdefault(name, []).append((middle - start, time.perf_counter() - middle))
    return [_row(name, 1e3 * np.array(pairs)) for name, pairs in times.items()]


def _works(rig: CameraRig, images: Sequence[Image], goal: Any) -> dict[str, Callable[[], Any]]:
    goals = rearrange_dice.goal_masks(rig, goal)
    masks = [rearrange_dice.segment_dice(image) for image in images]

    def segment() -> list[Image]:
        return [rearrange_dice.segment_dice(image) for image in images]

    return {
        "masks, error": lambda: rearrange_dice.error(goals, segment()),
        "goal masks, masks, error": lambda: rearrange_dice.error(
            rearrange_dice.goal_masks(rig, goal), segment()
        ),
        "positions from masks and images": lambda: rearrange_dice.locate(rig, masks, images),
        "positions from masks alone": lambda: rearrange_dice.locate(rig, masks),
    }


def _row(name: str, pairs: Any) -> dict[str, Any]:
    work, reference = pairs.T
    return {
        "work": name,
        "median_ms": float(np.median(work)),
        "p99_ms": float(np.quantile(work, 0.99)),
        "reference_ms": float(np.median(reference)),
        "ratio": float(np.median(work / reference)),
        "times": len(work),
    }
