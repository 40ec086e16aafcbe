"""Random single scenes of the platform."""

from typing import Any

import numpy as np

from synthetic.look.appearance import Look, random_lighting, random_look
from synthetic.scene import PlatformScene
from synthetic.world.fingers import random_fingers
from synthetic.world.placement import CUBOID_KINDS, DICE_KINDS, place
from synthetic.world.platform import Platform
from tracker.errors import TrackerError


def random_scene(
    platform: Platform,
    rng: np.random.Generator,
    *,
    near: float | None = 0.5,
    object_present: bool = True,
    kind: str | None = None,
) -> PlatformScene:
    """Draw a scene; the same state of `rng` gives the same scene, whatever came before.

    Args:
        platform: the platform with the object.
        rng: source of all randomness.
        near: probability that a finger is near the object, otherwise anywhere; None: there is no robot.
        object_present: False: an arena without object.
        kind: "rest" on any face, "tilted" on an edge, "thrown", "air"; for dice "dice_thrown" or
            "dice_goal". None: drawn.

    Raises:
        TrackerError: `kind` is unknown.
    """
    kinds = DICE_KINDS if platform.model is None else CUBOID_KINDS
    if kind is not None and kind not in kinds:
        raise TrackerError(f"kind of scene: found {kind!r}, expected one of {', '.join(kinds)}")
    look, lighting = random_look(rng, platform.model), random_lighting(rng)
    chosen = kind or str(rng.choice(list(kinds), p=list(kinds.values())))
    (positions, rotations), about = place(platform, rng, chosen)
    states = platform.object_states(positions, rotations) if object_present else ()
    joints, is_near = None, [False] * 3
    if near is not None:
        joints, is_near = random_fingers(platform, states, rng, near)
    if not object_present:
        chosen, about = "empty", {}
    fingers = "none" if near is None else "random"
    about = {"kind": chosen, **about, "fingers": fingers, "fingers_near": is_near, **describe(look)}
    about["lamps"] = len(lighting.lamps)
    return platform.scene(states, joints, look, lighting, about)


def describe(look: Look) -> dict[str, Any]:
    """Return the entries about a look in the description of a scene."""
    return {"dark_robot": look.dark_robot, "cross": bool(look.cross_size[0] > 0)}
