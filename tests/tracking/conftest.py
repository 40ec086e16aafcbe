"""What the tests of tracking over time share."""

import pytest

from tests.helpers.pushed_cube import DT, new, play, pose_at, shot


@pytest.fixture(scope="session")
def film(rig):
    """Images of a cube that is pushed, ten times a second."""
    return [shot(rig, pose_at(DT * k), k) for k in range(16)]


@pytest.fixture(scope="session")
def short(film):
    return film[:8]


@pytest.fixture(scope="session")
def reference(rig, film):
    """What a fresh tracker answers to the film."""
    return play(new(rig), film)
