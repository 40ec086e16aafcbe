"""What tests of the simulated platform need, and why they are skipped without it."""

import functools
import importlib.util

import pytest

from tests.helpers.needs import lack


@functools.cache
def missing() -> str:
    """Why the simulated platform cannot be rendered here; empty if it can."""
    for package in ("pybullet", "trimesh"):
        if importlib.util.find_spec(package) is None:
            return f"{package} is not installed (extra `synthetic`)"
    from synthetic.world.assets import find_assets
    from tracker.errors import TrackerError

    try:
        find_assets()
    except TrackerError as error:
        return str(error)
    return ""


def skip_without_platform() -> None:
    """Skip the test that calls it, with the reason, where the platform cannot be rendered."""
    if reason := missing():
        lack("platform", reason)


@pytest.fixture(autouse=True)
def platforms_stay_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """No frame depends on what a platform showed before; to load the robot takes as long as to draw one."""
    if not missing():
        from synthetic.world.platform import Platform
        from tests.helpers.stills import platform

        monkeypatch.setattr("synthetic.frames.Platform", platform)
        monkeypatch.setattr(Platform, "close", lambda self: None)
