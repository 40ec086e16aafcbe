from __future__ import annotations

import pytest

from tests.helpers.pose_logs import random_poses
from tracker.poses.file import write_poses


@pytest.fixture
def path(tmp_path):
    return tmp_path / "poses.h5"


@pytest.fixture
def written(path, rng):
    """A file of five frames that have all poses but those of frame 2."""
    write_poses(path, random_poses(rng, 5, share=1, gap=2))
    return path
