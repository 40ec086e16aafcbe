"""What the dice task's masks and positions are worth, on scenes with exact truth and one recorded picture."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.data.dice import KINDS, DiceScene, dice_store
from benchmarks.data.scenes import rig as exact_rig
from benchmarks.data.sets import Plan
from benchmarks.measure.timing import in_turn, one_thread
from benchmarks.score.dice import (
    Answer,
    View,
    cross_pixels,
    judge_mask,
    judge_positions,
    visible_fractions,
)
from benchmarks.score.shares import brier_score, median, percent, quantile, reliability
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.tasks import rearrange_dice
from tracker.tasks.rearrange_dice import NUM_DICE, Die

BINS = ((0.05, 0.3), (0.3, 0.5), (0.5, 1.0))
"""Bins of visible fractions; the lower end belongs to a bin, the upper only where it is 1."""

SEEN = 0.3
"""Visible fraction from which on a die ought to be found."""

IMAGES, ALONE = "masks and images", "masks alone"
"""What positions are found from."""

SHARES = {"thrown": 0.5, "laid": 0.25}
"""Scenes of a kind over the realistic scenes of an object."""

TIMED, ROUNDS = 30, 5
"""Scenes of thrown dice that are timed, and how often each of them is."""

GOAL_SEED = 31
"""Of the goals of what is timed, which have nothing to do with where the dice are."""

Rows = list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Judged:
    """All that was measured of one scene."""

    kind: str
    index: int
    """Number of the scene in its stream."""
    visible: FloatArray
    """(D,) visible fractions."""
    views: tuple[View, ...]
    dice: dict[str, tuple[Die, ...]]
    """What was reported, by what was given."""
    answers: dict[str, Answer]
    """The same, judged."""

    @property
    def mistakes(self) -> int:
        """Dice that ought to have been found, and dice invented, with masks and images given."""
        answer = self.answers[IMAGES]
        missed = np.isnan(answer.error) & (self.visible >= SEEN)
        return int(np.count_nonzero(missed) + np.count_nonzero(~answer.right))


def measure_dice(
    plan: Plan, real: Path | None, say: Callable[[str], None] = lambda line: None
) -> tuple[Rows, list[Judged]]:
    """Rows of the parts `dice…`, and what they are made of.

    Args:
        plan: which scenes.
        real: folder of recorded data, or None.
        say: takes lines about the progress.
    """
    rig, judged = exact_rig(), []
    rows: Rows = []
    for kind in KINDS:
        say(f"dice, {kind}")
        scenes = dice_scenes(kind, plan, range(dice_count(kind, plan)))
        judged += [judge_scene(kind, scene, rig) for scene in scenes]
        own = [one for one in judged if one.kind == kind]
        rows.append({"part": "dice, masks", "group": kind, **mask_row([v for one in own for v in one.views])})
        for given in (IMAGES, ALONE):
            rows += position_rows(f"{kind}, {given}", [one.answers[given] for one in own], own)
    if real is not None and (row := recorded_row(real)) is not None:
        rows.append({"part": "dice, masks", "group": "recorded picture", "n": 1, **row})
    say("dice, time")
    timed = dice_scenes("thrown", plan, range(min(TIMED, dice_count("thrown", plan))))
    rows += speed_rows(rig, [scene.images for scene in timed], ROUNDS)
    return [{"object": "dice", **row} for row in rows], judged


def dice_count(kind: str, plan: Plan) -> int:
    """Number of scenes of a kind."""
    return max(min(plan.scenes, 2), round(SHARES[kind] * plan.scenes))


def dice_scenes(kind: str, plan: Plan, numbers: Sequence[int]) -> Iterator[DiceScene]:
    """The scenes of these numbers of a kind."""
    return dice_store(kind, plan.seed, plan.workers, plan.cache).scenes(numbers)


def judge_scene(kind: str, scene: DiceScene, rig: CameraRig) -> Judged:
    """Segments and locates the dice of one scene."""
    masks = [rearrange_dice.segment_dice(image) for image in scene.images]
    dice = {
        IMAGES: rearrange_dice.locate(rig, masks, scene.images),
        ALONE: rearrange_dice.locate(rig, masks),
    }
    return Judged(
        kind,
        scene.index,
        visible_fractions(rig.cameras, scene),
        tuple(_judged_masks(rig.cameras, scene, masks)),
        dice,
        {given: judge_positions(scene.positions, found) for given, found in dice.items()},
    )


def _judged_masks(cameras: Sequence[Camera], scene: DiceScene, masks: Sequence[Image]) -> Iterator[View]:
    for camera, mask, image, labels in zip(cameras, masks, scene.images, scene.labels, strict=True):
        cross = cross_pixels(camera, scene.bars) if len(scene.bars) else np.zeros(labels.shape, bool)
        yield judge_mask(mask, image, labels, cross)


def mask_row(views: Sequence[View]) -> dict[str, Any]:
    """Figures of the masks of `n` views: shares [1], but of false pixels [%].

    `iou`, `precision`, `recall` are of all views' pixels together; with `_median` and `_p5` of single views.
    """
    true, found, both = (
        np.array([getattr(view, key) for view in views]) for key in ("true", "found", "both")
    )
    row: dict[str, Any] = {"n": len(views)}
    for key, whole in (("iou", true + found - both), ("precision", found), ("recall", true)):
        single = both[whole > 0] / whole[whole > 0]
        row[key] = _share(both.sum(), whole.sum())
        row[f"{key}_median"], row[f"{key}_p5"] = median(single), quantile(single, 0.05)
    sums = {key: sum(getattr(view, key) for view in views) for key in ("cross", "cross_taken", "elsewhere")}
    return row | {
        "cross_views": sum(view.cross > 0 for view in views),
        "cross_px": sums["cross"],
        "cross_taken": 100 * _share(sums["cross_taken"], sums["cross"]),
        "elsewhere": 100 * _share(sums["elsewhere"], sum(view.total for view in views)),
    }


def position_rows(group: str, answers: Sequence[Answer], judged: Sequence[Judged]) -> Rows:
    """Figures of positions and of their stated probabilities: shares in %, errors in mm."""
    visible = np.concatenate([one.visible for one in judged])
    error = 1e3 * np.concatenate([answer.error for answer in answers])
    right = np.concatenate([answer.right for answer in answers])
    probability = np.concatenate([answer.probability for answer in answers])
    found = np.isfinite(error)
    row: dict[str, Any] = {
        "part": "dice, positions",
        "group": group,
        "n": int(np.count_nonzero(visible >= SEEN)),
        "reported": len(right),
        "found": percent(found[visible >= SEEN]),
        "invented": percent(~right),
        "median_mm": quantile(error, 0.5),
        "p90_mm": quantile(error, 0.9),
        "count_error": median(np.array([abs(len(answer.right) - NUM_DICE) for answer in answers])),
        "brier": brier_score(probability, right),
    }
    for low, high in BINS:
        own = (visible >= low) & ((visible < high) | (high == 1.0))
        name = f"{low:g}".replace(".", "_")
        row |= {f"dice_{name}": int(own.sum()), f"found_{name}": percent(found[own])}
    stated = reliability(probability, right)
    return [row, *({"part": "dice, probability", "group": group, **part} for part in stated)]


def recorded_row(real: Path) -> dict[str, float] | None:
    """Precision, recall and intersection over union [1] with the hand-made mask; None: no picture."""
    image, mask = (cv2.imread(str(real / "dice" / f"test_{name}.png"), flag) for name, flag in _RECORDED)
    if image is None or mask is None:
        return None
    true, found = mask > 127, rearrange_dice.segment_dice(np.asarray(image, dtype=np.uint8)) > 0
    wholes = {"precision": found, "recall": true, "iou": true | found}
    return {key: _share(int((true & found).sum()), int(whole.sum())) for key, whole in wholes.items()}


_RECORDED = (("image", cv2.IMREAD_COLOR), ("mask", cv2.IMREAD_GRAYSCALE))


def speed_rows(rig: CameraRig, triplets: Sequence[Sequence[Image]], rounds: int) -> Rows:
    """One row for each kind of work: median and p99 [ms], and `ratio` to the reference work.

    Every kind of work is done in turn with the reference work; the ratio is the median of the pairs'. The
    first row is what the task's reward costs while its goal stays.

    Args:
        rig: the cameras.
        triplets: the images of each scene.
        rounds: how often each scene is timed, after once uncounted.
    """
    rng = np.random.default_rng(GOAL_SEED)
    times: dict[str, list[list[float]]] = {}
    with one_thread():
        for images, (name, work) in itertools.chain.from_iterable(
            itertools.product([images], _works(rig, images, rearrange_dice.sample_goal(rng)).items())
            for images in triplets
        ):
            for count in range(rounds + 1):
                _, *spent = in_turn(work, images)
                if count:
                    times.setdefault(name, []).append(spent)
    return [_time_row(name, np.array(pairs)) for name, pairs in times.items()]


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


def _time_row(name: str, pairs: FloatArray) -> dict[str, Any]:
    work, reference = pairs.T
    return {
        "part": "dice, time",
        "group": name,
        "n": len(work),
        "median_ms": median(work),
        "p99_ms": quantile(work, 0.99),
        "ratio": median(work / reference),
    }


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole else np.nan
