"""Accuracy of the dice task's masks and positions, on scenes with ground truth and one recorded image."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
import pandas as pd

from benchmarks.data.dice import KINDS, DiceScene, dice_store
from benchmarks.data.plan import Plan
from benchmarks.data.scenes import rig as exact_rig
from benchmarks.measure.timing import one_thread, repeated
from benchmarks.score.dice import cross_pixels, judge_mask, judge_positions, visible_fractions
from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.tasks import rearrange_dice

GIVEN = ("masks and images", "masks alone")
"""Inputs for estimating positions."""

TIMED = 30
"""Largest number of scenes of thrown dice that are timed."""

GOAL_SEED = 31
"""Seed of the goals used for timing, which are independent of the dice's positions."""

Rows = list[dict[str, Any]]


def measure_dice(plan: Plan, real: Path | None) -> dict[str, pd.DataFrame]:
    """Return rows of `dice, masks` (views), `dice, positions` (true dice), `dice, reported`, `dice, time`.

    real: folder of recorded data, or None.
    """
    rig = exact_rig()
    rows: dict[str, Rows] = {f"dice, {part}": [] for part in ("masks", "positions", "reported", "time")}
    with one_thread():
        for kind in KINDS:
            click.echo(f"dice, {kind}", err=True)
            store = dice_store(kind, plan)
            for scene in store.scenes(range(plan.count(kind))):
                for part, found in judge_scene(kind, scene, rig).items():
                    rows[part] += found
                if kind == "thrown" and scene.index < TIMED:
                    rows["dice, time"] += time_rows(rig, scene.images)
    if real is not None:
        rows["dice, masks"] += recorded_row(real)
    return {part: pd.DataFrame(found).assign(object="dice") for part, found in rows.items()}


def judge_scene(kind: str, scene: DiceScene, rig: CameraRig) -> dict[str, Rows]:
    """Segment and locate the dice of one scene; return the rows of all parts except the time."""
    masks = [rearrange_dice.segment_dice(image) for image in scene.images]
    visible = visible_fractions(rig.cameras, scene)
    positions, reported = [], []
    for given in GIVEN:
        found = rearrange_dice.locate(rig, masks, scene.images if given == GIVEN[0] else None)
        answer, group = judge_positions(scene.positions, found), f"{kind}, {given}"
        about = {"group": group, "scene": scene.index}
        positions += [
            about | {"visible": seen, "mm": 1e3 * error}
            for seen, error in zip(visible.tolist(), answer.error.tolist(), strict=True)
        ]
        reported += [
            about | {"right": bool(right), "probability": probability}
            for right, probability in zip(answer.right, answer.probability.tolist(), strict=True)
        ]
    views = [{"group": kind, "scene": scene.index} | view for view in _judged_masks(rig, scene, masks)]
    return {"dice, masks": views, "dice, positions": positions, "dice, reported": reported}


def _judged_masks(rig: CameraRig, scene: DiceScene, masks: Sequence[Image]) -> Iterator[dict[str, int]]:
    for camera, mask, image, labels in zip(rig.cameras, masks, scene.images, scene.labels, strict=True):
        cross = cross_pixels(camera, scene.bars) if len(scene.bars) else np.zeros(labels.shape, bool)
        yield judge_mask(mask, image, labels, cross)


def recorded_row(real: Path) -> Rows:
    """Return the recorded image as a view, compared with its hand-made mask; empty if it is missing."""
    image = cv2.imread(str(real / "dice" / "test_image.png"), cv2.IMREAD_COLOR)
    mask = cv2.imread(str(real / "dice" / "test_mask.png"), cv2.IMREAD_GRAYSCALE)
    if image is None or mask is None:
        return []
    true, found = mask > 127, rearrange_dice.segment_dice(np.asarray(image, dtype=np.uint8)) > 0
    counts = {"true": true, "found": found, "both": true & found}
    pixels = {key: int(np.count_nonzero(where)) for key, where in counts.items()}
    return [{"group": "recorded picture"} | pixels]


def time_rows(rig: CameraRig, images: Sequence[Image]) -> Rows:
    """Return a row for each kind of work, with its times.

    The first row is the cost of the task's reward while the goal stays the same.
    """
    goal = rearrange_dice.sample_goal(np.random.default_rng(GOAL_SEED))
    goals = rearrange_dice.goal_masks(rig, goal)
    masks = [rearrange_dice.segment_dice(image) for image in images]

    def segment() -> list[Image]:
        return [rearrange_dice.segment_dice(image) for image in images]

    works: dict[str, Callable[[], Any]] = {
        "masks, error": lambda: rearrange_dice.error(goals, segment()),
        "goal masks, masks, error": lambda: rearrange_dice.error(
            rearrange_dice.goal_masks(rig, goal), segment()
        ),
        "positions from masks and images": lambda: rearrange_dice.locate(rig, masks, images),
        "positions from masks alone": lambda: rearrange_dice.locate(rig, masks),
    }
    return [{"group": name, **repeated(work, images)[1]} for name, work in works.items()]
