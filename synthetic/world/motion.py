"""Sequences: motions on the platform, as scenes with timestamps."""

import functools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from synthetic.look.appearance import Look, random_lighting, random_look
from synthetic.scene import Lighting, PlatformScene, SceneAt
from synthetic.world.acts import PERIOD, Moment, Moments, Stage, push, release, tumble, withdraw
from synthetic.world.carrying import carry, lift_and_lower, random_grip
from synthetic.world.fingers import random_fingers
from synthetic.world.placement import MAX_CLEARANCE, Poses, lowest, place, random_place, random_rotation
from synthetic.world.platform import DIE_SIZE, Platform
from synthetic.world.scenes import describe
from tracker.conventions import FloatArray
from tracker.errors import TrackerError
from tracker.geometry import so3

CUBOID_MOTIONS = ("push", "tumble", "drop", "lift", "carry", "mixed")
DICE_MOTIONS = ("push", "tumble", "drop", "mixed")
"""Kinds of motion."""

JITTER = 0.003
"""Standard deviation of the interval between two images [s]."""

_STARTS_TRIED = 300
_MIXED = {"push": 0.3, "tumble": 0.2, "lift": 0.15, "carry": 0.35}


BEFORE, AFTER = 0.03, 0.01
"""Time range before and after an image's timestamp for which scenes are available [s]."""


def film(
    platform: Platform,
    rng: np.random.Generator,
    *,
    seconds: float,
    rate: float = 10.0,
    kind: str | None = None,
    jitter: float = JITTER,
    dropped: float = 0.0,
) -> Iterator[tuple[float, SceneAt]]:
    """Yield timestamps [s], from 0, and scenes as functions of time from BEFORE earlier to AFTER later.

    Args:
        platform: the platform with the object.
        rng: source of all randomness; the same state gives the same sequence.
        seconds: length [s].
        rate: image rate [Hz].
        kind: "push", "tumble" and "drop" by physics; "lift" and "carry" with the fingers at the object's
            faces (not for dice); "mixed": one after the other without jumps. None: drawn.
        jitter: standard deviation of the interval between images [s].
        dropped: probability that an image is missing.

    Raises:
        TrackerError: `kind` is unknown.
    """
    kinds = DICE_MOTIONS if platform.model is None else CUBOID_MOTIONS
    if kind is not None and kind not in kinds:
        raise TrackerError(f"kind of motion: found {kind!r}, expected one of {', '.join(kinds)}")
    chosen = kind or kinds[int(rng.integers(len(kinds)))]
    return _pictures(platform, rng, chosen, _stamps(rng, seconds, rate, jitter, dropped))


def _stamps(
    rng: np.random.Generator, seconds: float, rate: float, jitter: float, dropped: float
) -> FloatArray:
    count = max(1, round(seconds * rate))
    # Jitter does not accumulate, since a clock triggers the cameras. The limit keeps their order.
    limit = 0.4 / rate
    stamps = np.arange(count) / rate + np.clip(rng.normal(0.0, jitter / np.sqrt(2), count), -limit, limit)
    kept = rng.random(count) >= dropped
    kept[0] = True
    result: FloatArray = (stamps - stamps[0])[kept]
    return result


class _Known(NamedTuple):
    """A moment of a film."""

    time: float
    act: str
    held_by: list[int]
    moment: Moment


def _pictures(
    platform: Platform, rng: np.random.Generator, kind: str, stamps: FloatArray
) -> Iterator[tuple[float, SceneAt]]:
    look, lighting = random_look(rng, platform.model), random_lighting(rng)
    with _begin(platform, rng, kind) as stage:
        known = [_Known(0.0, kind, sorted(stage.grip), stage.moment())]
        acts = _acts(stage, kind)
        for stamp in stamps.tolist():
            while len(known) < 2 or known[-1].time < stamp + AFTER:
                act, moment = next(acts)
                known.append(_Known(known[-1].time + PERIOD, act, sorted(stage.grip), moment))
            while len(known) > 2 and known[1].time <= stamp - BEFORE:
                del known[0]
            yield stamp, functools.partial(_scene_at, platform, look, lighting, kind, tuple(known))


def _scene_at(
    platform: Platform, look: Look, lighting: Lighting, kind: str, known: tuple[_Known, ...], time: float
) -> PlatformScene:
    """Return the scene at a time between moments; before the first moment, that of the first."""
    k = next((k for k in range(1, len(known)) if known[k].time >= time), len(known) - 1)
    share = max(0.0, 1.0 - (known[k].time - time) / PERIOD)
    moment = between(known[k - 1].moment, known[k].moment, share)
    states = platform.object_states(moment.positions, moment.rotations)
    about = {"kind": kind, "act": known[k].act, "fingers_hold": known[k].held_by, **describe(look)}
    return platform.scene(states, moment.joints, look, lighting, about)


def between(before: Moment, after: Moment, share: float) -> Moment:
    """Interpolate between two moments at `share` (0 to 1)."""
    turn = so3.log(after.rotations @ np.swapaxes(before.rotations, -1, -2))
    return Moment(
        before.positions + share * (after.positions - before.positions),
        so3.exp(share * turn) @ before.rotations,
        before.joints + share * (after.joints - before.joints),
    )


def _begin(platform: Platform, rng: np.random.Generator, kind: str) -> Stage:
    """Return the stage with everything in place for the first act."""
    (positions, rotations), _ = place(platform, rng, "rest" if platform.model else "dice_goal")
    if platform.model is not None and kind in ("drop", "lift", "carry"):
        for _ in range(_STARTS_TRIED):
            if kind != "lift":
                positions, rotations = _in_air(platform, rng)
            else:
                (positions, rotations), _ = place(platform, rng, "rest")
            joints, _ = random_fingers(platform, platform.object_states(positions, rotations), rng, 0.0)
            found = random_grip(platform, rng, positions[0], rotations[0], joints)
            if found is not None and len(found[0]) > 1:
                stage = Stage(platform, rng, platform.object_states(positions, rotations), found[1])
                stage.grip = found[0]
                return stage
    elif kind == "drop":
        # At four heights, so that neighbours have room for their diagonals of 38 mm, however they are turned.
        odd = np.rint(positions[:, :2] / DIE_SIZE).astype(np.int64) % 2
        positions[:, 2] += 0.01 + 0.04 * (odd @ [1, 2])
        rotations = np.stack([random_rotation(rng) for _ in positions])
    states = platform.object_states(positions, rotations)
    joints, _ = random_fingers(platform, states, rng, 0.0)
    return Stage(platform, rng, states, joints)


def _in_air(platform: Platform, rng: np.random.Generator) -> Poses:
    rotation = random_rotation(rng)
    height = rng.uniform(0.1, 1.0) * MAX_CLEARANCE - lowest(platform.size, rotation)
    position = np.array([*(0.6 * random_place(rng, platform.size, rotation)), height])
    return position[None], rotation[None]


def _acts(stage: Stage, kind: str) -> Iterator[tuple[str, Moment]]:
    """Yield, without end, the moments at each PERIOD and the name of their act."""
    name = kind
    while True:
        if kind == "mixed":
            names = [name for name in _MIXED if stage.platform.model is not None or name in DICE_MOTIONS]
            weights = np.array([_MIXED[name] for name in names])
            name = "drop" if stage.grip else str(stage.rng.choice(names, p=weights / weights.sum()))
        for moment in _ACTS[name](stage):
            yield name, moment


def _drop(stage: Stage) -> Moments:
    """Drop the object; if it lies on the table, grip and lift it first."""
    if stage.platform.model is None:
        yield from stage.settle(1.5, least=0.5)
        yield from tumble(stage)
        return
    if not stage.grip:
        yield from lift_and_lower(stage)
    else:
        yield from release(stage)


def _tumble(stage: Stage) -> Moments:
    yield from withdraw(stage)
    yield from tumble(stage)


_ACTS: dict[str, Callable[[Stage], Moments]] = {
    "push": push,
    "tumble": _tumble,
    "drop": _drop,
    "lift": lift_and_lower,
    "carry": carry,
}
