"""The scenes of dice with the most mistakes as one picture: from above, beside the three views."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.data.dice import DiceScene
from benchmarks.data.sets import Plan
from benchmarks.measure.dice import IMAGES, SEEN, Judged, dice_scenes
from tracker.conventions import FloatArray, Image
from tracker.files import write_whole
from tracker.geometry.cuboid import corners
from tracker.tasks.rearrange_dice import ARENA_RADIUS, DIE_WIDTH, Die
from tracker.viz import paint

FILE = "dice_worst.png"
"""Beside the results."""

COUNT = 6
"""Scenes."""

PANEL, GAP, CAPTION = 270, 6, 22
"""Side of a panel, space between panels, and height of the line of text above a row [px]."""

HALF = 0.21
"""Half of what the panel from above shows of the table [m]."""

TRUE: paint.Color = (235, 232, 228)
RIGHT: paint.Color = (150, 235, 110)
INVENTED: paint.Color = (20, 125, 255)
MISSED: paint.Color = (215, 80, 200)
HIDDEN: paint.Color = (120, 112, 106)
"""Of true squares, of reported ones that are right or invented; fillings of missed dice."""

_LEGEND = (("true", TRUE), ("right", RIGHT), ("invented", INVENTED), ("missed", MISSED))
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * DIE_WIDTH / 2


def write_worst_dice(judged: Sequence[Judged], plan: Plan, folder: Path) -> Path:
    """Write the picture of the scenes with the most dice missed or invented; returns its path."""
    worst = sorted(judged, key=lambda one: one.mistakes, reverse=True)[:COUNT]
    rows = []
    for one in worst:
        (scene,) = dice_scenes(one.kind, plan, [one.index])
        rows.append(_row(one, scene))
    rows.append(_legend(4 * PANEL + 3 * GAP))
    _, data = cv2.imencode(".png", np.concatenate(rows))
    write_whole(folder / FILE, data.tobytes())
    return folder / FILE


def _row(one: Judged, scene: DiceScene) -> Image:
    answer = one.answers[IMAGES]
    seen = one.visible >= SEEN
    parts: list[Image] = [from_above(one, scene)]
    for image in scene.images:
        parts += [np.full((PANEL, GAP, 3), paint.BACKGROUND, np.uint8), image]
    row = np.concatenate(parts, axis=1)
    title: Image = np.full((CAPTION, row.shape[1], 3), paint.BACKGROUND, np.uint8)
    text = (
        f"{one.kind} {one.index}: missed {np.count_nonzero(np.isnan(answer.error[seen]))} of {seen.sum()}, "
        f"invented {np.count_nonzero(~answer.right)} of {len(answer.right)}"
    )
    paint.put_text(title, text, (4, CAPTION - 6), paint.BRIGHT, size=10)
    return np.concatenate([title, row])


def from_above(one: Judged, scene: DiceScene) -> Image:
    """The table with x to the right and y up: (PANEL, PANEL, 3) uint8 BGR."""
    panel: Image = np.full((PANEL, PANEL, 3), paint.BACKGROUND, np.uint8)
    answer = one.answers[IMAGES]
    paint.stroke(panel, [paint.circle(np.full(2, (PANEL - 1) / 2), ARENA_RADIUS * _SCALE)], paint.FAINT, 1.0)
    # Lower dice first: what lies on them is drawn over them.
    for k in np.argsort(scene.positions[:, 2], kind="stable"):
        outline = _to_panel(_true_outline(scene.positions[k], scene.rotations[k]))
        if np.isnan(answer.error[k]):
            paint.fill(panel, outline, MISSED if one.visible[k] >= SEEN else HIDDEN, 0.85)
        paint.stroke(panel, [outline], TRUE, 1.0, 0.8)
    for die, right in zip(one.dice[IMAGES], answer.right, strict=True):
        paint.stroke(panel, [_to_panel(_found_outline(die))], RIGHT if right else INVENTED, 1.6)
    return panel


_SCALE = PANEL / (2 * HALF)


def _to_panel(points: FloatArray) -> FloatArray:
    return np.asarray((PANEL - 1) / 2 + _SCALE * points * [1, -1])


def _true_outline(position: FloatArray, rotation: FloatArray) -> FloatArray:
    points = (position + corners(np.full(3, DIE_WIDTH)) @ rotation.T)[:, :2]
    hull = cv2.convexHull(points.astype(np.float32))[:, 0].astype(np.float64)
    return np.concatenate([hull, hull[:1]])


def _found_outline(die: Die) -> FloatArray:
    cosine, sine = np.cos(die.yaw), np.sin(die.yaw)
    return np.asarray(die.position[:2] + _CORNERS @ np.array([[cosine, sine], [-sine, cosine]]))


def _legend(width: int) -> Image:
    line: Image = np.full((CAPTION, width, 3), paint.BACKGROUND, np.uint8)
    left = 4.0
    entries = (*_LEGEND, (f"missed, visible < {SEEN:g}", HIDDEN))
    for text, color in entries:
        paint.put_text(line, text, (left, CAPTION - 6), color, size=10)
        left += paint.text_width(text, 10) + 24
    return line
