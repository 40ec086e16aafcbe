import contextlib
import importlib
import sys

import numpy as np
import pytest

from synthetic.world.platform import Platform
from tests.helpers import ROOT
from tests.helpers.synthetic_needs import skip_without_platform

skip_without_platform()
sys.path.insert(0, str(ROOT / "examples"))
late_poses = importlib.import_module("late_poses")
cube_pusher = importlib.import_module("cube_pusher")
STEP, Pushing = cube_pusher.STEP, cube_pusher.Pushing


@pytest.fixture(scope="module")
def platform():
    with Platform("cube_v2") as one:
        yield one


@pytest.fixture
def pushing(platform):
    with Pushing(platform, np.zeros(2), 0.3) as one:
        yield one


def test_fingers_that_know_the_cube_bring_it_to_the_goal(pushing):
    goal = np.array([-0.04, -0.02])
    for _ in range(round(3.0 / STEP)):
        pushing.step(pushing.truth, goal)
    assert np.linalg.norm(pushing.truth[0][:2] - goal) < 0.006
    assert pushing.truth[0][2] == pytest.approx(0.0325, abs=0.001)


def test_fingers_that_know_nothing_wait_and_late_pictures_give_poses_of_the_moment_of_acting(
    platform, pushing
):
    poses = []
    with contextlib.closing(late_poses.Predicted(platform, 3)) as known:
        for number in range(round(0.5 / STEP)):
            poses.append(known.pose(number * STEP, pushing))
            pushing.step(None, np.array([0.04, 0.03]))
    late, true = round(late_poses.DELAY / STEP), pushing.truth[0]
    assert np.linalg.norm(true[:2]) < 0.001
    assert all(pose is None for pose in poses[: late - 1])
    assert all(np.linalg.norm(pose[0] - true) < 1e-3 for pose in poses[late + 1 :])
