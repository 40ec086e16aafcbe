import pytest

from tests.helpers.pose_logs import random_poses
from tracker.poses.file import write_poses
from tracker.poses.poses import concatenate


@pytest.fixture
def path(tmp_path):
    return tmp_path / "poses.h5"


@pytest.fixture
def written(path, rng):
    """A file of five frames that have all poses but those of frame 2."""
    poses = random_poses(rng, 5, share=1)
    gap = random_poses(rng, 1, share=0, first=2)
    write_poses(path, concatenate([poses[:2], gap, poses[3:]]))
    return path
