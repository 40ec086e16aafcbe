"""What the tests of tracking over time share."""

import pytest

from tests.helpers.pushed_cube import DT, new, play, pose_at, shot, within

FRAMES = 16


def has_seen(rig, film, **more):
    """A tracker after a film."""
    one = new(rig)
    play(one, film, **more)
    return one


def near(answer, truth, *limits):
    """Whether both poses of an answer are near the truth."""
    poses = answer.object_pose, answer.filtered_object_pose
    return all(within(pose, truth, *limits) for pose in poses)


def honest(answer, truth):
    """Whether no pose of an answer is wrong and held to be right."""
    poses = [pose for pose in (answer.object_pose, answer.filtered_object_pose) if pose is not None]
    return all(pose.confidence < 0.5 or within(pose, truth, 5.0, 5.0) for pose in poses)


@pytest.fixture(scope="session")
def film(rig):
    """Images of a cube that is pushed, ten times a second."""
    return [shot(rig, pose_at(DT * k), k) for k in range(FRAMES)]


@pytest.fixture(scope="session")
def short(film):
    return film[: FRAMES // 2]
