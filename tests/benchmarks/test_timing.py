import itertools

import numpy as np
import pytest

from benchmarks.measure import timing

IMAGES = [np.zeros((8, 8, 3), np.uint8)]


@pytest.fixture
def clock(monkeypatch):
    """Makes work and reference work in turn take given times [s]."""

    def set_to(*spent):
        # A round reads the clock three times: before, between and after the two.
        pairs = zip(spent[::2], spent[1::2], strict=True)
        steps = itertools.chain.from_iterable((0.0, *pair) for pair in pairs)
        ticks = itertools.accumulate(steps)
        monkeypatch.setattr(timing.time, "process_time", lambda: next(ticks))

    return set_to


def test_the_shortest_of_several_rounds_counts(clock):
    clock(0.004, 0.002, 0.003, 0.008, 0.005, 0.001)
    count = itertools.count()
    result, times = timing.repeated(lambda: next(count), IMAGES)
    assert result == 1
    assert times == pytest.approx({"ms": 3.0, "reference_ms": 1.0, "ratio": 3.0})
    assert next(count) == timing.ROUNDS


def test_one_round_is_work_and_then_its_reference_to_which_a_missing_image_adds_nothing(clock):
    clock(0.004, 0.002)
    assert timing.in_turn(lambda: "done", IMAGES) == (
        "done",
        pytest.approx({"ms": 4.0, "reference_ms": 2.0, "ratio": 2.0}),
    )
    timing.reference_work([None, *IMAGES])
