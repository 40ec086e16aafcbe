"""What the line about a recording says of the object's way and of rewards."""

from __future__ import annotations

import numpy as np
import pytest

from tracker.recordings.outcome.rewards import totals
from tracker.recordings.outcome.row import STEP, path_length


def test_an_object_at_rest_has_no_path(rng):
    still = rng.uniform(-1, 1, (500, 3)) * STEP / 4
    assert path_length(still) == 0
    way = np.linspace(0, 1, 101)[:, None] * [1.0, 0, 0]
    assert path_length(way) == pytest.approx(1.0)


def test_rewards_last_until_the_next_and_are_held_where_nothing_was_seen():
    nan = float("nan")
    found = totals(np.array([nan, -1.0, nan, -3.0]), np.array([0.0, 1.0, 3.0, 4.0]))
    assert found == {"reward_total": -(1 + 2 + 1 + 3) * 1e3, "reward_mean": -7 / 5, "error_end": 3.0}
    assert totals(np.array([nan]), np.array([0.0])) == {}
