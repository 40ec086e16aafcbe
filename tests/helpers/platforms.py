"""Platforms for tests, or a reason to skip them."""

from synthetic.errors import AssetError
from synthetic.world.platform import Platform
from tests.helpers.needs import lack


def platform_of(object_name: str) -> Platform:
    """The simulated platform; the test is skipped where the robot's meshes cannot be had."""
    try:
        return Platform(object_name)
    except AssetError as error:
        lack("platform", str(error))
