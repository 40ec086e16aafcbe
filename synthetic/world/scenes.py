"""Random single scenes of the platform."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from synthetic.look.appearance import Look, random_lighting, random_look
from synthetic.scene import PlatformScene
from synthetic.world.fingers import random_fingers
from synthetic.world.placement import CUBOID_KINDS, DICE_KINDS, place
from synthetic.world.platform import Platform
from tracker.errors import TrackerError

FINGERS = {"random": None, "near": 1.0, "away": 0.0, "none": None}
"""Modes of placing fingers; the number is the probability that a finger is near the object."""


def random_scene(
    platform: Platform,
    rng: np.random.Generator,
    *,
    fingers: str = "random",
    occlusion: float = 0.5,
    object_present: bool = True,
    kind: str | None = None,
) -> PlatformScene:
    """Draw a scene; the same state of `rng` gives the same scene, whatever came before.

    Args:
        platform: the platform with the object.
        rng: source of all randomness.
        fingers: "random": each finger is near the object with the probability `occlusion`, otherwise
            anywhere; "near": all are near; "away": all are placed anywhere; "none": there is no robot.
        occlusion: see `fingers`.
        object_present: False: an arena without object.
        kind: "rest" on any face, "tilted" on an edge, "thrown", "air"; for dice "dice_thrown" or
            "dice_goal". None: drawn.

    Raises:
        TrackerError: `fingers` or `kind` is unknown.
    """
    if fingers not in FINGERS:
        raise TrackerError(f"fingers: found {fingers!r}, expected one of {', '.join(FINGERS)}")
    kinds = kinds_of(platform)
    if kind is not None and kind not in kinds:
        raise TrackerError(f"kind of scene: found {kind!r}, expected one of {', '.join(kinds)}")
    look, lighting = random_look(rng, platform.model), random_lighting(rng)
    chosen = kind or str(rng.choice(list(kinds), p=list(kinds.values())))
    (positions, rotations), about = place(platform, rng, chosen)
    states = platform.object_states(positions, rotations) if object_present else ()
    near = FINGERS[fingers]
    joints, is_near = None, [False] * 3
    if fingers != "none":
        joints, is_near = random_fingers(platform, states, rng, occlusion if near is None else near)
    if not object_present:
        chosen, about = "empty", {}
    about = {"kind": chosen, **about, "fingers": fingers, "fingers_near": is_near, **describe(look)}
    about["lamps"] = len(lighting.lamps)
    return platform.scene(states, joints, look, lighting, about)


def kinds_of(platform: Platform) -> Mapping[str, float]:
    """Return the kinds of scene for the platform's object, with their probabilities."""
    return DICE_KINDS if platform.model is None else CUBOID_KINDS


def describe(look: Look) -> dict[str, Any]:
    """Return the entries about a look in the description of a scene."""
    return {"dark_robot": look.dark_robot, "cross": bool(look.cross_size[0] > 0)}
