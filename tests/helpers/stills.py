"""Scenes of the platform without the robot and pictures of them, or a reason to skip the tests."""

from collections.abc import Callable
from typing import Any

import pytest

from synthetic.errors import AssetError
from tests.helpers.needs import lack

pytest.importorskip("trimesh", reason="platform: no module trimesh")

from synthetic import stills
from synthetic.scene import PlatformScene
from synthetic.stills import Still, take

__all__ = ["Still", "bare_scene", "posed_scene", "scene_with_fingers", "take"]


def _or_skip(make: Callable[..., PlatformScene]) -> Callable[..., PlatformScene]:
    def made(*arguments: Any, **more: Any) -> PlatformScene:
        try:
            return make(*arguments, **more)
        except AssetError as error:
            lack("platform", str(error))

    return made


bare_scene = _or_skip(stills.bare_scene)
posed_scene = _or_skip(stills.posed_scene)
scene_with_fingers = _or_skip(stills.scene_with_fingers)
