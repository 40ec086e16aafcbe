"""Compares masks and positions of dice with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from tracker.conventions import Array, FloatArray, Image
from tracker.tasks.rearrange_dice import DIE_WIDTH, Die

RIGHT = DIE_WIDTH / 2
"""A reported die counts as a true one within so much of it [m]."""

RIM, NEAR_DICE = 2, 3
"""Distances [px] from the nearest pixel of a die: beyond the first, a pixel of the mask is false; beyond the
second, a pixel of the cross is judged."""

MIN_BLUE, BLUE_OVER_RED = 30, 1.5
"""Least level of blue, and over the level of red, of a pixel of the cross that nothing hides."""


@dataclass(frozen=True)
class View:
    """The mask of one camera's picture, in pixels."""

    true: int
    found: int
    both: int
    """Pixels of dice, of the mask, of both."""
    cross: int
    cross_taken: int
    """Blue pixels of the cross with no die near them, and those of them in the mask."""
    elsewhere: int
    """Pixels of the mask that are near no die, and not of the cross."""
    total: int
    """Of the picture."""


@dataclass(frozen=True, eq=False)
class Answer:
    """The dice reported of one scene, judged."""

    error: FloatArray
    """(D,) distance of each true die to the one that was reported for it [m]; nan: none was."""
    right: Array
    """(N,) whether each reported die is a true one."""
    probability: FloatArray
    """(N,) as stated."""


def judge_positions(true: FloatArray, dice: Sequence[Die]) -> Answer:
    """Pairs true dice at (D, 3) [m] with those reported: as many as are near enough, then the nearest."""
    found = np.array([die.position for die in dice]).reshape(-1, 3)
    distance = np.linalg.norm(true[:, None] - found, axis=2)
    # Too far costs more than all good pairs together, so that none is given up for a nearer one.
    rows, columns = linear_sum_assignment(np.where(distance <= RIGHT, distance, 1.0 + RIGHT * len(true)))
    kept = distance[rows, columns] <= RIGHT
    error, right = np.full(len(true), np.nan), np.zeros(len(found), bool)
    error[rows[kept]] = distance[rows, columns][kept]
    right[columns[kept]] = True
    return Answer(error, right, np.array([die.probability for die in dice], dtype=np.float64))


def judge_mask(mask: Image, image: Image, labels: Image, cross: Array) -> View:
    """Compares a mask with the truth; `cross` (H, W) says where one is on the table, hidden or not."""
    found, true = mask > 0, labels > 0
    distance = cv2.distanceTransform((~true).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    blue, red = (image[..., channel].astype(np.float64) for channel in (0, 2))
    seen = cross & (distance > NEAR_DICE) & (blue >= MIN_BLUE) & (blue >= BLUE_OVER_RED * red)
    # Its rim is a mixture of cross and table, and part of neither.
    around = cv2.dilate(cross.astype(np.uint8), np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8)) > 0
    count = np.count_nonzero
    return View(
        true=int(count(true)),
        found=int(count(found)),
        both=int(count(true & found)),
        cross=int(count(seen)),
        cross_taken=int(count(seen & found)),
        elsewhere=int(count(found & (distance > RIM) & ~around)),
        total=labels.size,
    )
