"""What the dice task's masks and positions are worth, on scenes with exact truth and one recorded picture."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.data.dice import KINDS, SEED, DiceScene, cross_pixels, dice_store, visible_fractions
from benchmarks.data.scenes import rig as exact_rig
from benchmarks.data.store import CACHE
from benchmarks.measure.dice_speed import speed_rows
from benchmarks.score.dice import Answer, View, judge_mask, judge_positions
from benchmarks.score.summary import brier_score, percent, reliability
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.tasks import rearrange_dice
from tracker.tasks.rearrange_dice import NUM_DICE, Die

BINS = ((0.05, 0.3), (0.3, 0.5), (0.5, 1.0))
"""Bins of visible fractions; the lower end belongs to a bin, the upper only where it is 1."""

SEEN = 0.3
"""Visible fraction from which on a die ought to be found."""

IMAGES, ALONE = "masks and images", "masks alone"
"""What positions are found from."""


@dataclass(frozen=True)
class DiceOptions:
    """How much is measured."""

    thrown: int = 200
    """Scenes of thrown dice."""
    laid: int = 100
    """Scenes of dice on the task's grid."""
    timed: int = 30
    """Scenes of thrown dice that are timed."""
    rounds: int = 5
    """How often each of them is."""
    seed: int = SEED
    """Of the scenes; another one for all but judging."""
    workers: int = 2
    """Processes that render."""
    cache: Path = CACHE
    """Folder of rendered scenes."""


QUICK = DiceOptions(thrown=3, laid=2, timed=2, rounds=2)


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
    options: DiceOptions, real: Path | None, say: Callable[[str], None] = lambda line: None
) -> tuple[dict[str, Any], list[Judged]]:
    """Results as plain numbers, and what they are made of.

    The results hold `about`, `masks` and `positions` with a row for each kind of scenes, `recorded` (None
    without recorded data), `speed`, and `figures`: those few that are held against targets.

    Args:
        options: how much is measured.
        real: folder of recorded data, or None.
        say: takes lines about the progress.
    """
    rig, judged = exact_rig(), []
    for kind in KINDS:
        say(f"dice, {kind}")
        numbers = range(int(getattr(options, kind)))
        judged += [judge_scene(kind, scene, rig) for scene in dice_scenes(kind, options, numbers)]
    say("dice, speed")
    timed = dice_scenes("thrown", options, range(min(options.timed, options.thrown)))
    results: dict[str, Any] = {
        "about": {"seed": options.seed, "scenes": {kind: getattr(options, kind) for kind in KINDS}},
        "masks": [mask_row(kind, _views(judged, kind)) for kind in KINDS],
        "positions": [
            position_row(kind, given, [one for one in judged if one.kind == kind])
            for kind, given in itertools.product(KINDS, (IMAGES, ALONE))
        ],
        "recorded": None if real is None else recorded_row(real),
        "speed": speed_rows(rig, [scene.images for scene in timed], options.rounds),
    }
    return results | {"figures": _figures(results)}, judged


def dice_scenes(kind: str, options: DiceOptions, numbers: Sequence[int]) -> Iterator[DiceScene]:
    """The scenes of these numbers of a kind."""
    return dice_store(kind, options.seed, options.workers, options.cache).scenes(numbers)


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


def _views(judged: Sequence[Judged], kind: str) -> list[View]:
    return [view for one in judged if one.kind == kind for view in one.views]


def mask_row(kind: str, views: Sequence[View]) -> dict[str, Any]:
    """Figures of the masks of one kind: shares [1], but of false pixels [%].

    `iou`, `precision`, `recall` are of all views' pixels together; with `_median` and `_p5` of single views.
    """
    true, found, both = (
        np.array([getattr(view, key) for view in views]) for key in ("true", "found", "both")
    )
    row: dict[str, Any] = {"kind": kind, "views": len(views)}
    for key, whole in (("iou", true + found - both), ("precision", found), ("recall", true)):
        single = both[whole > 0] / whole[whole > 0]
        row[key] = _share(both.sum(), whole.sum())
        row[f"{key}_median"], row[f"{key}_p5"] = _quantile(single, 0.5), _quantile(single, 0.05)
    sums = {key: sum(getattr(view, key) for view in views) for key in ("cross", "cross_taken", "elsewhere")}
    return row | {
        "cross_views": sum(view.cross > 0 for view in views),
        "cross_px": sums["cross"],
        "cross_taken": 100 * _share(sums["cross_taken"], sums["cross"]),
        "elsewhere": 100 * _share(sums["elsewhere"], sum(view.total for view in views)),
    }


def position_row(kind: str, given: str, judged: Sequence[Judged]) -> dict[str, Any]:
    """Figures of the positions of one kind, found from what was given: shares in %, errors in mm."""
    answers = [one.answers[given] for one in judged]
    visible = np.concatenate([one.visible for one in judged])
    error = 1e3 * np.concatenate([answer.error for answer in answers])
    right = np.concatenate([answer.right for answer in answers])
    probability = np.concatenate([answer.probability for answer in answers])
    found = np.isfinite(error)
    bins = []
    for low, high in BINS:
        own = (visible >= low) & ((visible < high) | (high == 1.0))
        bins.append({"low": low, "high": high, "dice": int(own.sum()), "found": percent(found[own])})
    return {
        "kind": kind,
        "given": given,
        "scenes": len(judged),
        "reported": len(right),
        "found": percent(found[visible >= SEEN]),
        "invented": percent(~right),
        "median_mm": _quantile(error[found], 0.5),
        "p90_mm": _quantile(error[found], 0.9),
        "count_error": _quantile(np.array([abs(len(answer.right) - NUM_DICE) for answer in answers]), 0.5),
        "bins": bins,
        "brier": brier_score(probability, right),
        "reliability": reliability(probability, right),
    }


def recorded_row(real: Path) -> dict[str, float] | None:
    """Precision, recall and intersection over union [1] with the hand-made mask; None: no picture."""
    image, mask = (cv2.imread(str(real / "dice" / f"test_{name}.png"), flag) for name, flag in _RECORDED)
    if image is None or mask is None:
        return None
    true, found = mask > 127, rearrange_dice.segment_dice(np.asarray(image, dtype=np.uint8)) > 0
    wholes = {"precision": found, "recall": true, "iou": true | found}
    return {key: _share(int((true & found).sum()), int(whole.sum())) for key, whole in wholes.items()}


_RECORDED = (("image", cv2.IMREAD_COLOR), ("mask", cv2.IMREAD_GRAYSCALE))


def _figures(results: dict[str, Any]) -> dict[str, float]:
    masks, positions = (
        next(row for row in results[key] if row["kind"] == "thrown" and row.get("given") in (None, IMAGES))
        for key in ("masks", "positions")
    )
    recorded = results["recorded"] or {}
    return {
        "recorded_recall": recorded.get("recall", np.nan),
        "recorded_precision": recorded.get("precision", np.nan),
        "mask_iou": masks["iou"],
        **{key: positions[key] for key in ("median_mm", "p90_mm", "found", "invented", "brier")},
        "ratio": results["speed"][0]["ratio"],
    }


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole else np.nan


def _quantile(values: Array, q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else np.nan
