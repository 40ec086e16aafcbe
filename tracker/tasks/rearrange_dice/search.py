"""The search for the set of dice that explains all views together best.

Squares of a die's size are looked for in the plane of the dice's tops, seen `from_above`. The set
of dice is then improved in the views themselves (`set_score`): each die moves to where it explains most; dice
that explain too little go; what is left unexplained proposes further ones; and dice that other ways of
filling a crowd propose take the places of those that they overlap, if all together then explain more.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.tasks.rearrange_dice import set_score
from tracker.tasks.rearrange_dice.drawn_dice import Views, overlap
from tracker.tasks.rearrange_dice.evidence import DICE, UNKNOWN, Evidence, tops
from tracker.tasks.rearrange_dice.from_above import STYLES, Plan
from tracker.tasks.rearrange_dice.goals import DIE_WIDTH

TERMS = set_score.Terms(
    edge=DIE_WIDTH, table=0.0, hidden=50.0, price=60.0, push=4e4, level=40.0, hovering=5e5
)

RADIUS = 0.19
"""Radius within which the centres of dice lie [m]."""

STEPS = np.array([0.004, 0.002, 0.001, 0.0005])
"""Of a die's moves [m]; the first is for dice that were never settled."""

MOVED = np.array([0.0002, 0.0002, 0.0004, 0.01])
"""Change of a die (x, y, foot, yaw) [m, rad] after which its neighbours are looked at again."""

NEAR = 0.05
"""Distance within which dice touch or hide each other [m]."""

MOST = 40
"""Proposals of one way to fill the plane."""

BIRTHS, BIRTH_FIT = 6, 0.05
"""Proposals from what is unexplained, and how well they must fit it."""

OVERLAP = 0.004
"""Overlap from which a die cannot stay beside a proposal [m]."""

BETTER = 1.0
"""By how much an exchange must explain more."""

TABLE_SURE = 150.0
"""Gain of dice whose heights tell that of the table."""

TABLE_OFF = 0.002
"""Height of the table from which on the proposals are made anew [m]."""


class Search:
    """One search in the evidence of all views."""

    def __init__(self, views: Views, seen: Sequence[Evidence], plan: Plan, canvas: set_score.Canvas) -> None:
        self._views, self._seen, self._plan, self._canvas = views, seen, plan, canvas
        self._terms = TERMS
        self._known = sum(bool((view.mask != UNKNOWN).any()) for view in seen)

    def run(self) -> tuple[FloatArray, FloatArray]:
        """Dice (N, 4) as (x, y, foot, yaw), and what each gains (N,); the greatest gain first."""
        starts = self._starts()
        dice = self._improve(starts[0], rounds=3)
        table = self._find_table(dice)
        if abs(table) > TABLE_OFF:
            self._terms = self._terms._replace(table=table)
            self._plan = self._plan.at(table)
            starts = self._starts()
            dice = self._improve(dice, rounds=1)
        score, others = self._total(dice), np.concatenate(starts[1:])
        for _ in range(2):
            better, score = self._exchange(dice, score, others)
            if better is dice:
                break
            changed = np.array([not (dice == row).all(axis=1).any() for row in better])
            dice = self._improve(better, 1, changed)
            score = self._total(dice)
        gains = np.array([self._gain(dice, k) for k in range(len(dice))])
        order = np.argsort(-gains, kind="stable")
        return dice[order], gains[order]

    def _starts(self) -> list[FloatArray]:
        planes = self._plan.project(tops(self._seen), self._known)
        return [self._plan.propose(planes, style, MOST) for style in range(STYLES)]

    def _find_table(self, dice: FloatArray) -> float:
        """Height of the table in the cameras' world [m], by the dice on it: calibrations may be off."""
        feet = [die[2] for k, die in enumerate(dice) if self._gain(dice, k) > TABLE_SURE]
        feet = [foot for foot in feet if abs(foot) < DIE_WIDTH / 2]
        return float(np.median(feet)) if feet else 0.0

    def _total(self, dice: FloatArray) -> float:
        return float(set_score.total(self._views, dice, self._terms, self._canvas))

    def _settle(self, dice: FloatArray, k: int, steps: FloatArray) -> float:
        return float(set_score.settle(self._views, dice, k, steps, RADIUS, self._terms, self._canvas))

    def _gain(self, dice: FloatArray, k: int) -> float:
        return self._settle(dice, k, STEPS[:0])

    def _improve(self, dice: FloatArray, rounds: int, stale: Array | None = None) -> FloatArray:
        """Let dice settle, drop those that explain too little, add what is unexplained, `rounds` times."""
        dice = dice.copy()
        stale = np.ones(len(dice), dtype=bool) if stale is None else stale
        gains = np.full(len(dice), np.inf)
        for left in range(rounds, -1, -1):
            for sweep in range(3):
                stale = self._sweep(dice, gains, stale, STEPS[min(sweep, 1) :])
                dice, gains, stale = self._prune(dice, gains, stale)
                if not stale.any():
                    break
            added = self._unexplained(dice) if left else dice[:0]
            if not len(added):
                break
            dice = np.concatenate([dice, added])
            gains = np.concatenate([gains, np.full(len(added), np.inf)])
            stale = np.concatenate([stale, np.ones(len(added), dtype=bool)])
        return dice

    def _sweep(self, dice: FloatArray, gains: FloatArray, stale: Array, steps: FloatArray) -> Array:
        """Let the stale dice settle, in place; returns those next to which another has moved since."""
        after = np.zeros(len(dice), dtype=bool)
        for k in np.flatnonzero(stale):
            before = dice[k].copy()
            gains[k] = self._settle(dice, int(k), steps)
            if (np.abs(dice[k] - before) > MOVED).any():
                after |= _near(dice, dice[k])
            after[k] = False
        return after

    def _prune(
        self, dice: FloatArray, gains: FloatArray, stale: Array
    ) -> tuple[FloatArray, FloatArray, Array]:
        """Without the dice whose gain does not pay their price, the worst first."""
        while len(dice):
            worst = int(np.argmin(gains))
            if gains[worst] >= 0:
                break
            others = _near(dice, dice[worst])
            stale, others = np.delete(stale | others, worst), np.delete(others, worst)
            dice, gains = np.delete(dice, worst, axis=0), np.delete(gains, worst)
            for k in np.flatnonzero(others):
                gains[k] = self._gain(dice, int(k))
        return dice, gains, stale

    def _unexplained(self, dice: FloatArray) -> FloatArray:
        """Proposals for what the dice leave unexplained."""
        self._total(dice)  # draws them into the canvas
        left = []
        for view, classes in zip(self._seen, self._canvas.classes, strict=True):
            height, width = view.mask.shape
            rest = ((view.mask == DICE) & (classes[:height, :width] == 0)).astype(np.uint8)
            # No dice; dice that are explained; unknown.
            rated = np.array([-0.5, -0.1, 0.0], np.float32)[view.mask]
            rated[cv2.medianBlur(rest, 3) > 0] = 1
            left.append(rated)
        return self._plan.propose(self._plan.project(left, self._known), 0, BIRTHS, BIRTH_FIT)

    def _exchange(self, dice: FloatArray, score: float, proposals: FloatArray) -> tuple[FloatArray, float]:
        """Dice in which proposals took the places of others where that explains more, and their score."""
        for proposal in proposals:
            trial = self._with(dice, proposal)
            value = -np.inf if trial is None else self._total(trial)
            if trial is not None and value > score + BETTER:
                dice, score = trial, value
        return dice, score

    def _with(self, dice: FloatArray, proposal: FloatArray) -> FloatArray | None:
        """Dice with a proposal in the place of up to two; None if it is among them, or needs more room."""
        away = np.hypot(dice[:, 0] - proposal[0], dice[:, 1] - proposal[1])
        apart = np.abs(dice[:, 2] - proposal[2])
        turn = np.abs((dice[:, 3] - proposal[3] + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        if ((away < 0.003) & (apart < DIE_WIDTH / 2) & (turn < 0.15)).any():
            return None
        free = np.array([overlap(die, proposal, DIE_WIDTH) < OVERLAP for die in dice], dtype=bool)
        if np.count_nonzero(~free) > 2:
            return None
        trial = np.concatenate([dice[free], proposal[None]])
        last = len(trial) - 1
        self._settle(trial, last, STEPS[1:])
        for k in np.flatnonzero((away[free] < 1.5 * DIE_WIDTH) & (apart[free] < 1.5 * DIE_WIDTH)):
            self._settle(trial, int(k), STEPS[1:])
        self._settle(trial, last, STEPS[2:])
        return trial


def _near(dice: FloatArray, die: FloatArray) -> Array:
    """(N,) whether each of the dice may touch or hide a die, or the other way round."""
    return np.asarray(np.hypot(dice[:, 0] - die[0], dice[:, 1] - die[1]) < NEAR)
