"""Compiled rendering of flat-lying dice into the views by ray casting, and the score of a set of dice.

A pixel's ray is described by how far it travels sideways while it descends: at height z it passes
(x, y) = camera (x, y) + (camera z - z) · slope. Seen from above, it therefore follows a straight segment
between the heights of a die's top and foot. It hits the top if the segment starts within the die's square,
and a side where the segment enters the square.

A die is a row (x, y, foot, yaw): centre and height of the lower face [m], rotation about z [rad].

The score of a set is the sum of the scores of all pixels in which its dice appear. A view's evidence against
a die (pixels where it should be seen and is not) is limited, since a finger may hide it there. Dice that
overlap, or hover between the levels of a stack, are penalised.
"""

import math
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, Image
from tracker.geometry.lens import clamped, project
from tracker.tasks.rearrange_dice.goals import ARENA_RADIUS, DIE_WIDTH

NONE, SIDE, SIDE_RIM, TOP, TOP_RIM = range(5)
"""What a pixel shows of the dice; the rim of a face is the part without pips."""

PIPS = 0.62
"""Half the edge of the square that contains a face's pips, over half the edge of the face: on the real dice,
pips of 3.4 mm are up to 4.4 mm from the middle of a face of 22 mm; the rest allows for blur."""


class Views(NamedTuple):
    """Evidence from all cameras in arrays of one size; a camera's image may fill only part of it."""

    slopes: Array
    """(C, H, W, 2) float32: how far a pixel's ray travels along x and y while it descends by 1."""
    lenses: Array
    """(C,) of tracker.geometry.lens.LENS."""
    scores: Array
    """(C, 5, H, W) float32: score of a pixel if NONE … TOP_RIM explains it."""
    masks: Image
    """(C, H, W): 1 where dice are seen, 2 where nothing is known, else 0."""


# Weights of the score; its unit is one explained pixel that shows dice.

HIDDEN = 50.0
"""Limit of a view's evidence against a die."""

PRICE = 60.0
"""Penalty on every die: the least that it must explain."""

PUSH = 4e4
"""Penalty per metre of overlap of two dice beyond TOUCH [1/m]."""

LEVEL = 40.0
"""Penalty on a die that lies on others, multiplied by its level squared."""

HOVERING = 5e5
"""Penalty on the square of a die's distance from its level [1/m²]."""

TOUCH = 0.0005
"""Overlap of touching neighbours that is not penalised [m]."""

MARGIN = 8
"""Margin around a die's pixels that allows for one step along each axis [px]."""


class Canvas(NamedTuple):
    """Buffers for drawing, of the views' size, so that loops do not allocate memory."""

    heights: np.ndarray
    """(C, H, W) float32: height at which a pixel's ray first meets a die [m]."""
    classes: np.ndarray
    """(C, H, W) int8: the part of that die: NONE … TOP_RIM."""
    owners: np.ndarray
    """(C, H, W) int16: index of that die."""


@compiled
def look(sx, sy, above, ux, uy, cos, sin):  # type: ignore[no-untyped-def]
    """Return which part of a die a ray of slope (sx, sy) meets, and how high above its foot [m]; NONE, -1.

    above: height of the camera above the die's top; (ux, uy): the camera in the die's frame [m].
    """
    half = 0.5 * DIE_WIDTH
    ax, ay = cos * sx + sin * sy, cos * sy - sin * sx
    px, py = above * ax + ux, above * ay + uy
    if abs(px) <= half and abs(py) <= half:
        return (TOP if max(abs(px), abs(py)) <= PIPS * half else TOP_RIM), DIE_WIDTH
    dx, dy = DIE_WIDTH * ax, DIE_WIDTH * ay
    qx, qy = px + dx, py + dy
    if (px > half and qx > half) or (px < -half and qx < -half):
        return NONE, -1.0
    if (py > half and qy > half) or (py < -half and qy < -half):
        return NONE, -1.0
    share = 0.0
    if abs(px) > half:
        share = (math.copysign(half, px) - px) / dx
    if abs(py) > half:
        share = max(share, (math.copysign(half, py) - py) / dy)
    x, y = abs(px + share * dx), abs(py + share * dy)
    if x > half + 1e-9 or y > half + 1e-9:
        return NONE, -1.0
    reach = max(min(x, y), DIE_WIDTH * abs(0.5 - share))
    return (SIDE if reach <= PIPS * half else SIDE_RIM), DIE_WIDTH * (1.0 - share)


@compiled
def bounds(lenses, c, die, margin, out):  # type: ignore[no-untyped-def]
    """Fill out (4,) with left, top, right, bottom of the pixels of camera c that may show the die."""
    left, top, right, bottom = 1e9, 1e9, -1e9, -1e9
    cos, sin, half = math.cos(die[3]), math.sin(die[3]), 0.5 * DIE_WIDTH
    for k in range(8):
        ox, oy = half if k & 1 else -half, half if k & 2 else -half
        x, y = die[0] + cos * ox - sin * oy, die[1] + sin * ox + cos * oy
        u, v, _ = project(lenses, c, x, y, die[2] + (DIE_WIDTH if k & 4 else 0.0))
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    width, height = lenses[c].width, lenses[c].height
    out[0], out[1] = clamped(left - margin, width), clamped(top - margin, height)
    out[2], out[3] = clamped(right + margin + 2.0, width), clamped(bottom + margin + 2.0, height)


@compiled
def frame(lenses, c, die):  # type: ignore[no-untyped-def]
    """Return above, ux, uy, cos, sin of `look` for camera c and a die."""
    cos, sin = math.cos(die[3]), math.sin(die[3])
    cx, cy = lenses[c].position[0] - die[0], lenses[c].position[1] - die[1]
    return lenses[c].position[2] - die[2] - DIE_WIDTH, cos * cx + sin * cy, cos * cy - sin * cx, cos, sin


@compiled
def draw(views, c, dice, skip, window, canvas):  # type: ignore[no-untyped-def]
    """Draw all dice except number `skip` into the window (4,) of camera c."""
    heights, classes, owners = canvas.heights[c], canvas.classes[c], canvas.owners[c]
    for j in range(window[1], window[3]):
        for i in range(window[0], window[2]):
            heights[j, i], classes[j, i], owners[j, i] = -1.0, NONE, -1
    own = np.empty(4, np.int64)
    for k in range(len(dice)):
        if k == skip:
            continue
        bounds(views.lenses, c, dice[k], 0, own)
        above, ux, uy, cos, sin = frame(views.lenses, c, dice[k])
        for j in range(max(own[1], window[1]), min(own[3], window[3])):
            for i in range(max(own[0], window[0]), min(own[2], window[2])):
                sx, sy = views.slopes[c, j, i, 0], views.slopes[c, j, i, 1]
                shown, height = look(sx, sy, above, ux, uy, cos, sin)
                if shown != NONE and dice[k, 2] + height > heights[j, i]:
                    heights[j, i], classes[j, i], owners[j, i] = dice[k, 2] + height, shown, k


@compiled
def overlap(a, b):  # type: ignore[no-untyped-def]
    """Return the overlap of two dice: the smallest shift that separates them [m]; 0 without overlap."""
    lift = DIE_WIDTH - abs(a[2] - b[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    if lift <= 0.0 or dx * dx + dy * dy >= 2.0 * DIE_WIDTH * DIE_WIDTH:
        return 0.0
    turn = b[3] - a[3]
    reach = 0.5 * DIE_WIDTH * (1.0 + abs(math.cos(turn)) + abs(math.sin(turn)))
    least = lift
    for yaw in (a[3], b[3]):
        cos, sin = math.cos(yaw), math.sin(yaw)
        least = min(least, reach - abs(cos * dx + sin * dy), reach - abs(cos * dy - sin * dx))
    return max(least, 0.0)


@compiled
def own_loss(die, table):  # type: ignore[no-untyped-def]
    """Return a die's own penalty, without overlaps; table: height of the table in the world [m]."""
    level = round((die[2] - table) / DIE_WIDTH)
    off = die[2] - table - level * DIE_WIDTH
    return PRICE + LEVEL * level * level + HOVERING * off * off


@compiled
def total(views, dice, table, canvas):  # type: ignore[no-untyped-def]
    """Return the score of a set of dice (N, 4), and draw it on the canvas."""
    score = 0.0
    window = np.zeros(4, np.int64)
    against = np.empty(len(dice))
    for c in range(len(views.lenses)):
        window[2], window[3] = views.lenses[c].width, views.lenses[c].height
        draw(views, c, dice, -1, window, canvas)
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
            score -= HIDDEN * (1.0 - math.exp(-against[k] / HIDDEN))
    for k in range(len(dice)):
        score -= own_loss(dice[k], table)
        for other in range(k):
            score -= PUSH * max(0.0, overlap(dice[k], dice[other]) - TOUCH)
    return score


@compiled
def _gain(views, dice, skip, die, table, canvas):  # type: ignore[no-untyped-def]
    """Return what a die adds to the score of the others, which are drawn on the canvas around it."""
    window = np.empty(4, np.int64)
    score = -own_loss(die, table)
    for c in range(len(views.lenses)):
        bounds(views.lenses, c, die, 0, window)
        above, ux, uy, cos, sin = frame(views.lenses, c, die)
        gained, against = 0.0, 0.0
        for j in range(window[1], window[3]):
            for i in range(window[0], window[2]):
                sx, sy = views.slopes[c, j, i, 0], views.slopes[c, j, i, 1]
                shown, height = look(sx, sy, above, ux, uy, cos, sin)
                if shown == NONE or die[2] + height <= canvas.heights[c, j, i]:
                    continue
                behind = canvas.classes[c, j, i]
                if views.masks[c, j, i] != 0:
                    gained += views.scores[c, shown, j, i] - views.scores[c, behind, j, i]
                elif behind == NONE:
                    against -= views.scores[c, shown, j, i]
        score += gained - HIDDEN * (1.0 - math.exp(-against / HIDDEN))
    for k in range(len(dice)):
        if k != skip:
            score -= PUSH * max(0.0, overlap(dice[k], die) - TOUCH)
    return score


@compiled
def _draw_around(views, dice, skip, die, canvas):  # type: ignore[no-untyped-def]
    """Draw all dice except number `skip` around a die, so that it may make one step along each axis."""
    window = np.empty(4, np.int64)
    for c in range(len(views.lenses)):
        bounds(views.lenses, c, die, MARGIN, window)
        draw(views, c, dice, skip, window, canvas)


@compiled
def settle(views, dice, k, steps, table, canvas):  # type: ignore[no-untyped-def]
    """Move die k, in place, to where it gains most, by steps (S,) [m]; return its gain there.

    No step moves its centre farther than ARENA_RADIUS from the arena's centre.
    """
    die, trial = dice[k].copy(), dice[k].copy()
    _draw_around(views, dice, k, die, canvas)
    best = _gain(views, dice, k, die, table, canvas)
    for step in steps:
        for _ in range(6):
            before = best
            for axis in range(4):
                # Rotations move the corners by the step; heights, which are known best, move by half of it.
                size = step if axis < 2 else 0.5 * step if axis == 2 else step / (0.7 * DIE_WIDTH)
                for sign in (-1.0, 1.0):
                    for i in range(4):
                        trial[i] = die[i]
                    trial[axis] += sign * size
                    if trial[0] ** 2 + trial[1] ** 2 > ARENA_RADIUS * ARENA_RADIUS:
                        continue
                    value = _gain(views, dice, k, trial, table, canvas)
                    if value > best + 1e-6:
                        best = value
                        die[axis] = trial[axis]
            if best <= before:
                break
            _draw_around(views, dice, k, die, canvas)
    for i in range(4):
        dice[k, i] = die[i]
    return best
