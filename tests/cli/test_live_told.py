"""What `tracker live` tells of."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from tests.helpers.moments import estimate, moment
from tracker.cli.live_told import Told

FAILED = {"camera60": "the buffer failed"}


def test_a_jump_is_not_taken_for_a_fault_of_a_camera_that_is_called_stamps():
    told = Told()
    told.hear(replace(moment(0), faults={"stamps": "the buffer failed"}))
    told.hear(replace(moment(1), jump="went back by 3.000 s"))
    summary = told.summary(0, ())
    assert "amiss in 1 of 2 sets; last: the buffer failed" in summary
    assert "amiss in 1 of 2 sets; last: went back by 3.000 s" in summary


def test_the_summary_names_cameras_in_their_order_and_a_fault_once(tmp_path):
    told, counts = Told(), {"camera60": 0, "camera180": 3}
    assert not told.only_faults
    for number in range(3):
        faults = {"camera180": "too small", "camera60": "frozen"}
        told.hear(replace(moment(number), faults=faults, fault_counts=counts))
    recorder = SimpleNamespace(recorded=0, path=tmp_path / "log.h5", left_out=0, fault=None)
    lines = told.summary(0, ["camera180: too small", "a listener"], recorder).splitlines()
    begins = ["sets", "status", "no", "latency", "camera60", "camera180", "recorded", "fault"]
    assert [line.split()[0] for line in lines] == begins
    assert lines[-2].split() == ["recorded", "nothing"]
    assert told.only_faults
    told.hear(moment(3, (np.zeros((16, 16, 3), np.uint8),)))
    assert not told.only_faults
    assert "never found" in told.summary(0, ())
    assert lines[-1].endswith("a listener")


def test_a_fault_of_one_set_is_in_the_next_line_and_in_the_summary(monkeypatch):
    now = 100.0
    monkeypatch.setattr("tracker.cli.live_told.time.monotonic", lambda: now)
    told = Told()
    for number in range(10):
        told.hear(replace(moment(number, pose=estimate()), faults=FAILED if number == 3 else {}))
    assert told.due() is None
    now += 1.1
    line = told.due()
    assert "tracking" in line
    assert line.endswith("camera60: the buffer failed (1 of 10 sets)")
    told.hear(moment(10, pose=estimate()))
    now += 1.1
    assert "buffer" not in told.due()
    assert "never found" not in told.summary(0, ())
    assert "camera60        amiss in 1 of 11 sets; last: the buffer failed" in told.summary(0, ())
