"""Compiled: how well a set of dice explains the views, and moves of one die that explain them better.

The score of a set is the sum, over the pixels in which it shows dice, of what that explains. What a view
has against a die (pixels in which it should be seen and is not) counts with a limit, since a finger may hide
it there. Dice that reach into each other, or hang between the levels of a stack, lose.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.tasks.rearrange_dice.drawn_dice import NONE, bounds, draw, frame, look, overlap


class Terms(NamedTuple):
    """Weights of the score; its unit is a pixel that shows dice and is explained."""

    edge: float
    """Edge of a die [m]."""
    table: float
    """Height of the table in the cameras' world [m]."""
    hidden: float
    """Limit of what a view may have against a die."""
    price: float
    """Of every die: what it must explain to be one."""
    push: float
    """Loss per metre that two dice reach into each other, beyond TOUCH."""
    level: float
    """Loss of a die that lies on another, for its level squared."""
    hovering: float
    """Loss of a die for its distance from its level, squared [1/m²]."""


TOUCH = 0.0005
"""Overlap of neighbours that is for nothing: they touch [m]."""

MARGIN = 8
"""Around a die's pixels, for its moves [px]."""


class Canvas(NamedTuple):
    """Room for drawing, so that nothing is allocated in loops; of the views' size."""

    heights: np.ndarray
    """(C, H, W) float32."""
    classes: np.ndarray
    """(C, H, W) int8."""
    owners: np.ndarray
    """(C, H, W) int16."""


@compiled
def own_loss(die, terms):  # type: ignore[no-untyped-def]
    """What a die loses by itself."""
    level = round((die[2] - terms.table) / terms.edge)
    off = die[2] - terms.table - level * terms.edge
    return terms.price + terms.level * level * level + terms.hovering * off * off


@compiled
def total(views, dice, terms, canvas):  # type: ignore[no-untyped-def]
    """The score of a set of dice (N, 4)."""
    score = 0.0
    window = np.zeros(4, np.int64)
    against = np.empty(len(dice))
    for c in range(len(views.lenses)):
        window[2], window[3] = views.lenses[c].width, views.lenses[c].height
        draw(views, c, dice, -1, terms.edge, window, canvas.heights[c], canvas.classes[c], canvas.owners[c])
        against[:] = 0.0
        for j in range(window[3]):
            for i in range(window[2]):
                shown = canvas.classes[c, j, i]
                if shown == NONE:
                    continue
                if views.masks[c, j, i] == 0:
                    against[canvas.owners[c, j, i]] -= views.scores[c, shown, j, i]
                else:
                    score += views.scores[c, shown, j, i]
        for k in range(len(dice)):
            score -= terms.hidden * (1.0 - math.exp(-against[k] / terms.hidden))
    for k in range(len(dice)):
        score -= own_loss(dice[k], terms)
        for other in range(k):
            score -= terms.push * max(0.0, overlap(dice[k], dice[other], terms.edge) - TOUCH)
    return score


@compiled
def _gain(views, dice, skip, die, terms, canvas):  # type: ignore[no-untyped-def]
    """What a die adds to the score of the others, which are drawn in the canvas around it."""
    window = np.empty(4, np.int64)
    score = -own_loss(die, terms)
    for c in range(len(views.lenses)):
        bounds(views.lenses, c, die, terms.edge, 0, window)
        above, ux, uy, cos, sin = frame(views.lenses, c, die, terms.edge)
        gained, against = 0.0, 0.0
        for j in range(window[1], window[3]):
            for i in range(window[0], window[2]):
                sx, sy = views.slopes[c, j, i, 0], views.slopes[c, j, i, 1]
                shown, height = look(sx, sy, above, ux, uy, cos, sin, terms.edge)
                if shown == NONE or die[2] + height <= canvas.heights[c, j, i]:
                    continue
                behind = canvas.classes[c, j, i]
                if views.masks[c, j, i] != 0:
                    gained += views.scores[c, shown, j, i] - views.scores[c, behind, j, i]
                elif behind == NONE:
                    against -= views.scores[c, shown, j, i]
        score += gained - terms.hidden * (1.0 - math.exp(-against / terms.hidden))
    for k in range(len(dice)):
        if k != skip:
            score -= terms.push * max(0.0, overlap(dice[k], die, terms.edge) - TOUCH)
    return score


@compiled
def settle(views, dice, k, steps, radius, terms, canvas):  # type: ignore[no-untyped-def]
    """Move die k (in place) to where it gains most, by steps (S,) [m]; returns what it then gains.

    No step takes it farther than `radius` from the arena's centre [m].
    """
    window = np.empty(4, np.int64)
    for c in range(len(views.lenses)):
        bounds(views.lenses, c, dice[k], terms.edge, MARGIN, window)
        draw(views, c, dice, k, terms.edge, window, canvas.heights[c], canvas.classes[c], canvas.owners[c])
    die, trial = dice[k].copy(), dice[k].copy()
    best = _gain(views, dice, k, die, terms, canvas)
    for step in steps:
        for _ in range(6):
            before = best
            for axis in range(4):
                # A turn moves the corners as far as the step; heights are known best.
                size = step if axis < 2 else 0.5 * step if axis == 2 else step / (0.7 * terms.edge)
                for sign in (-1.0, 1.0):
                    for i in range(4):
                        trial[i] = die[i]
                    trial[axis] += sign * size
                    if trial[0] ** 2 + trial[1] ** 2 > radius * radius:
                        continue
                    value = _gain(views, dice, k, trial, terms, canvas)
                    if value > best + 1e-6:
                        best = value
                        die[axis] = trial[axis]
            if best <= before:
                break
    for i in range(4):
        dice[k, i] = die[i]
    return best
