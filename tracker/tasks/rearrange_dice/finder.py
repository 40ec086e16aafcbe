"""Locate dice from the masks of all cameras jointly, and from their images if there are any.

Squares of a die's size are proposed in the plane of the dice's tops (`evidence.Plan`). Then the set of dice
is refined in the views themselves (`set_score`): each die moves to where it explains most, and dice that
explain too little are dropped. Further dice are proposed for unexplained pixels. Dice from other ways to fill
a crowd replace those they overlap if the whole set then explains more.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import Frozen, freeze, is_whole
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TaskError, shown
from tracker.geometry.camera import Camera
from tracker.geometry.lens import stack_lenses
from tracker.inputs import check_images
from tracker.tasks.rearrange_dice import set_score
from tracker.tasks.rearrange_dice.evidence import DICE, STYLES, UNKNOWN, Plan, evidence, tops
from tracker.tasks.rearrange_dice.goals import DIE_WIDTH, NUM_DICE
from tracker.tasks.rearrange_dice.score import masks_of
from tracker.tasks.rearrange_dice.set_score import Canvas, Views, overlap

SIZE = 270
"""Approximate shorter side of the views, reduced by integer factors, in which dice are located [px]."""

LEAST = 0.5
"""Smallest probability at which a die is reported."""

STEPS = np.array([0.004, 0.002, 0.001, 0.0005])
"""Step lengths of a die's moves [m]; the first is used only in the first sweep."""

MOVED = np.array([0.0002, 0.0002, 0.0004, 0.01])
"""Change of a die (x, y, foot, yaw) above which its neighbours are settled again [m, rad]."""

NEAR = 0.05
"""Distance within which dice may touch or hide each other [m]."""

MOST = 40
"""Largest number of proposals of one style."""

BIRTHS, BIRTH_FIT = 6, 0.05
"""Largest number of proposals for unexplained pixels, and the smallest evidence for one."""

OVERLAP = 0.004
"""Smallest overlap at which a proposal replaces a die [m]."""

BETTER = 1.0
"""Smallest increase in the score at which an exchange is accepted."""

TABLE_SURE = 150.0
"""Smallest gain of a die whose height is used to estimate that of the table."""

TABLE_OFF = 0.002
"""Deviation of the table's height above which dice are proposed again [m]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Die(Frozen):
    """One die that lies flat, on the table or on other dice."""

    position: FloatArray
    """(3,) centre in the world [m]; read-only."""
    yaw: float
    """Rotation about z [rad], from -π/4 to π/4, since the sides look alike."""
    probability: float
    """Calibrated probability that a die's centre is within half a die's edge of `position`."""
    gain: float
    """Log likelihood that this die adds to the others', in units of one explained pixel."""

    def __post_init__(self) -> None:
        freeze(self, "position", np.array(self.position, dtype=np.float64))


def locate(
    rig: CameraRig,
    masks: Sequence[Array | None],
    images: Sequence[Array | None] | None = None,
    *,
    most: int = NUM_DICE,
) -> tuple[Die, ...]:
    """Return the dice that together best explain the masks of all cameras, the most certain first.

    Dice lie flat on the table or on dice that do, not higher, anywhere and with any yaw. With inaccurate
    calibrations, the table may be up to half a die above or below the world's z = 0; its height is estimated
    from the dice. A die that fingers or other dice hide almost completely is not found.

    Args:
        rig: the cameras.
        masks: (H, W) of 0/1, 0/255 or bool for each camera, as returned by `segment_dice`; None: no image.
        images: (H, W, 3) uint8 BGR of each camera. Tops are brighter than sides, and pips are away from
            edges, so images separate dice in a crowd better than masks alone.
        most: number of dice in the arena, the largest number returned.

    Raises:
        TaskError: a mask is malformed, their number is not that of the cameras, or the arena is elsewhere.
        ImageError: an image is malformed, or their number is not that of the cameras.
    """
    if not is_whole(most) or most < 0:
        raise TaskError(f"most: found {shown(most)}, expected a number of dice")
    seen = masks_of(rig, masks, "dice")
    if rig.arena.center != (0.0, 0.0) or abs(rig.arena.ground) > DIE_WIDTH / 2:
        where = f"centre {rig.arena.center} and table {rig.arena.table} m"
        raise TaskError(f"arena: found {where}, expected (0, 0) and ±{DIE_WIDTH / 2} m, as in goals")
    given = [None] * len(rig) if images is None else check_images(images, rig, least=0)
    found, gains = Search(rig, seen, given).run()
    pairs = zip(seen, given, strict=True)
    offset, slope = PROBABILITY[any(mask is not None and image is not None for mask, image in pairs)]
    dice = []
    for (x, y, foot, yaw), gain in zip(found[:most], gains[:most], strict=True):
        probability = 1 / (1 + math.exp(-offset - slope * math.log(max(float(gain), 1.0))))
        if probability >= LEAST:
            turned = float((yaw + math.pi / 4) % (math.pi / 2) - math.pi / 4)
            position = np.array([x, y, foot + DIE_WIDTH / 2])
            dice.append(Die(position, turned, probability, float(gain)))
    return tuple(dice)


PROBABILITY = {True: (-4.21, 1.571), False: (-2.62, 1.140)}
"""Offset, and weight of the log gain, in the log odds that a die is real; with images, and with masks only.
Fitted by scripts/fit_dice_probability.py on rendered scenes."""


@functools.lru_cache(maxsize=4)
def _prepared(rig: CameraRig) -> tuple[Plan, Array, Array]:
    """Return what depends only on the rig: plan, slopes and lenses for the reduced cameras, see `Views`."""
    cameras = []
    for camera in rig:
        factor = max(1, round(min(camera.width, camera.height) / SIZE))
        cameras.append(camera.resized(camera.width // factor, camera.height // factor))
    size = (max(c.height for c in cameras), max(c.width for c in cameras))
    slopes = np.zeros((len(cameras), *size, 2), np.float32)
    for its, camera in zip(slopes, cameras, strict=True):
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2)).reshape(*rows.shape, 3)
        # A ray that does not descend misses the table; its slope is set so that it misses all dice, too.
        sink = np.maximum(-np.nan_to_num(rays[..., 2:], nan=0.0), 1e-3)
        its[: camera.height, : camera.width] = np.nan_to_num(rays[..., :2] / sink, nan=1e3)
    return Plan(cameras), slopes, stack_lenses(cameras)


def _reduced(image: Image, camera: Camera) -> Image:
    small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


class Search:
    """One search for dice in the evidence of all views."""

    def __init__(self, rig: CameraRig, masks: Sequence[Array | None], images: Sequence[Array | None]) -> None:
        self._plan, slopes, lenses = _prepared(rig)
        count, *size = slopes.shape[:3]
        scores, self._shades = np.zeros((count, 5, *size), np.float32), np.zeros((count, *size), np.float32)
        known = np.full((count, *size), UNKNOWN, np.uint8)
        for c, (mask, image, camera) in enumerate(zip(masks, images, self._plan.cameras, strict=True)):
            if mask is not None:
                small = _reduced(np.where(mask > 0, 255, 0).astype(np.uint8), camera) >= 128
                part = slice(camera.height), slice(camera.width)
                its = evidence(small, None if image is None else _reduced(image, camera))
                scores[(c, slice(None), *part)], known[(c, *part)], self._shades[(c, *part)] = its
        self.views = Views(slopes, lenses, scores, known)
        self._canvas = Canvas(*(np.zeros(known.shape, kind) for kind in (np.float32, np.int8, np.int16)))
        self._known = int((known != UNKNOWN).any(axis=(1, 2)).sum())

    def run(self) -> tuple[FloatArray, FloatArray]:
        """Return dice (N, 4) as (x, y, foot, yaw) [m, rad], and their gains (N,), in descending order."""
        if not (self.views.masks == DICE).any():
            return np.empty((0, 4)), np.empty(0)
        starts = self._starts()
        dice = self._improve(starts[0], rounds=3)
        # Estimate the height of the table in the world from the dice on it, as calibrations may be off.
        feet = dice[self._gains(dice) > TABLE_SURE, 2]
        feet = feet[np.abs(feet) < DIE_WIDTH / 2]
        table = float(np.median(feet)) if len(feet) else 0.0
        if abs(table) > TABLE_OFF:
            self._plan = Plan(self._plan.cameras, table)
            starts = self._starts()
            dice = self._improve(dice, rounds=1)
        score = self._total(dice)
        for _ in range(2):
            before = dice
            for proposal in np.concatenate(starts[1:]):
                trial = self._with(dice, proposal)
                if trial is not None and (value := self._total(trial)) > score + BETTER:
                    dice, score = trial, value
            if dice is before:
                break
            changed = np.array([not (before == row).all(axis=1).any() for row in dice])
            dice = self._improve(dice, 1, changed)
            score = self._total(dice)
        gains = self._gains(dice)
        order = np.argsort(-gains, kind="stable")
        return dice[order], gains[order]

    def _starts(self) -> list[FloatArray]:
        planes = self._plan.project(tops(self.views.masks, self._shades), self._known)
        return [self._plan.propose(planes, style, MOST) for style in range(len(STYLES))]

    def _total(self, dice: FloatArray) -> float:
        return float(set_score.total(self.views, dice, self._plan.table, self._canvas))

    def _settle(self, dice: FloatArray, k: int, steps: FloatArray = STEPS[:0]) -> float:
        """Settle die k, in place; return its gain. Without steps it stays where it is."""
        return float(set_score.settle(self.views, dice, k, steps, self._plan.table, self._canvas))

    def _gains(self, dice: FloatArray) -> FloatArray:
        return np.array([self._settle(dice, k) for k in range(len(dice))], dtype=np.float64)

    def _improve(self, dice: FloatArray, rounds: int, stale: Array | None = None) -> FloatArray:
        """Repeat `rounds` times: settle dice, drop those that explain too little, fill unexplained pixels."""
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
        """Settle the stale dice, in place; return (N,) bool: dice near which another has moved since."""
        after = np.zeros(len(dice), dtype=bool)
        for k in np.flatnonzero(stale).tolist():
            before = dice[k].copy()
            gains[k] = self._settle(dice, k, steps)
            if (np.abs(dice[k] - before) > MOVED).any():
                after |= _near(dice, dice[k])
            after[k] = False
        return after

    def _prune(
        self, dice: FloatArray, gains: FloatArray, stale: Array
    ) -> tuple[FloatArray, FloatArray, Array]:
        """Drop dice with a negative gain, worst first; return dice, gains, and which dice are stale."""
        while len(dice):
            worst = int(np.argmin(gains))
            if gains[worst] >= 0:
                break
            others = _near(dice, dice[worst])
            stale, others = np.delete(stale | others, worst), np.delete(others, worst)
            dice, gains = np.delete(dice, worst, axis=0), np.delete(gains, worst)
            for k in np.flatnonzero(others).tolist():
                gains[k] = self._settle(dice, k)
        return dice, gains, stale

    def _unexplained(self, dice: FloatArray) -> FloatArray:
        self._total(dice)  # draws them on the canvas
        left = []
        for c, camera in enumerate(self._plan.cameras):
            part = c, slice(camera.height), slice(camera.width)
            mask = self.views.masks[part]
            rest = ((mask == DICE) & (self._canvas.classes[part] == 0)).astype(np.uint8)
            # Ratings of NOTHING, explained DICE, and UNKNOWN.
            rated = np.array([-0.5, -0.1, 0.0], np.float32)[mask]
            rated[cv2.medianBlur(rest, 3) > 0] = 1
            left.append(rated)
        return self._plan.propose(self._plan.project(left, self._known), 0, BIRTHS, BIRTH_FIT)

    def _with(self, dice: FloatArray, proposal: FloatArray) -> FloatArray | None:
        """Replace up to two dice with a proposal; None if it is already there or would replace more."""
        away = np.hypot(dice[:, 0] - proposal[0], dice[:, 1] - proposal[1])
        apart = np.abs(dice[:, 2] - proposal[2])
        turn = np.abs((dice[:, 3] - proposal[3] + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        if ((away < 0.003) & (apart < DIE_WIDTH / 2) & (turn < 0.15)).any():
            return None
        free = np.array([overlap(die, proposal) < OVERLAP for die in dice], dtype=bool)
        if np.count_nonzero(~free) > 2:
            return None
        trial = np.concatenate([dice[free], proposal[None]])
        last = len(trial) - 1
        self._settle(trial, last, STEPS[1:])
        near = (away[free] < 1.5 * DIE_WIDTH) & (apart[free] < 1.5 * DIE_WIDTH)
        for k in np.flatnonzero(near).tolist():
            self._settle(trial, k, STEPS[1:])
        self._settle(trial, last, STEPS[2:])
        return trial


def _near(dice: FloatArray, die: FloatArray) -> Array:
    """Return (N,) bool: whether each of the dice may touch or hide a die, or be hidden by it."""
    return np.asarray(np.hypot(dice[:, 0] - die[0], dice[:, 1] - die[1]) < NEAR)
