"""What the tests of tracking over time share."""

import pytest

from tests.helpers.pushed_cube import DT, pose_at, shot

FRAMES = 16


@pytest.fixture(scope="session")
def film(rig):
    """Images of a cube that is pushed, ten times a second."""
    return [shot(rig, pose_at(DT * k), k) for k in range(FRAMES)]


@pytest.fixture(scope="session")
def short(film):
    return film[: FRAMES // 2]
