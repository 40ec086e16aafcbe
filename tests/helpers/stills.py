"""Scenes of the platform without the robot and pictures of them, or a reason to skip the tests."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.helpers.needs import lack

pytest.importorskip("trimesh", reason="platform: no module trimesh")

from synthetic import stills
from synthetic.scene import PlatformScene
from synthetic.stills import Still, take
from synthetic.world.assets import AssetError
from synthetic.world.platform import Platform
from synthetic.world.scenes import random_scene
from tracker import CuboidModel

__all__ = ["Still", "bare_scene", "platform", "posed_scene", "scene_with_fingers", "take"]


def _or_skip(make: Callable[..., Any]) -> Callable[..., Any]:
    def made(*arguments: Any, **more: Any) -> Any:
        try:
            return make(*arguments, **more)
        except AssetError as error:
            lack("platform", str(error))

    return made


bare_scene = _or_skip(stills.bare_scene)
posed_scene = _or_skip(stills.posed_scene)

platform = _or_skip(functools.cache(Platform))


@_or_skip
def scene_with_fingers(model: CuboidModel, rng: np.random.Generator, *, near: float = 0.5) -> PlatformScene:
    """As `synthetic.stills.scene_with_fingers`, of platforms that stay open."""
    return random_scene(platform(model), rng, near=near)
