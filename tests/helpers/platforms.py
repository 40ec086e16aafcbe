"""Platforms for tests, or a reason to skip them."""

from __future__ import annotations

import pytest

from synthetic.errors import AssetError
from synthetic.world.platform import Platform


def platform_of(object_name: str) -> Platform:
    """The simulated platform; the test is skipped where the robot's meshes cannot be had."""
    try:
        return Platform(object_name)
    except AssetError as error:
        pytest.skip(str(error))
