"""What the line about a recording says of the object's way."""

from __future__ import annotations

import numpy as np
import pytest

from tracker.recordings.outcome.row import STEP, path_length


def test_an_object_at_rest_has_no_path(rng):
    still = rng.uniform(-1, 1, (500, 3)) * STEP / 4
    assert path_length(still) == 0
    way = np.linspace(0, 1, 101)[:, None] * [1.0, 0, 0]
    assert path_length(way) == pytest.approx(1.0)
