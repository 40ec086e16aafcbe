"""What effects of the real world do to a scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from synthetic.effects import Effects, stream
from synthetic.scene import PlatformScene
from synthetic.world.chamfers import chamfered
from synthetic.world.fittings import fitted
from synthetic.world.prints import printed
from synthetic.world.reflections import reflecting
from synthetic.world.worn_table import worn

_CHANGES: dict[str, Callable[[PlatformScene, np.random.Generator], PlatformScene]] = {
    "chamfers": chamfered,
    "surface": printed,
    "table": worn,
    "fittings": fitted,
    "reflections": reflecting,
}
"""In the order in which they are made."""


def with_effects(scene: PlatformScene, effects: Effects, seed: int, number: int) -> PlatformScene:
    """The scene with the effects that change scenes; all scenes of one `number` get the same ones.

    Args:
        scene: a tidy one.
        effects: those wanted.
        seed: of everything random.
        number: of the single scene or of the motion.
    """
    for name in (name for name in _CHANGES if name in effects.names):
        scene = _CHANGES[name](scene, stream(name, seed, number))
    return scene
