import importlib.util
import threading

import numpy as np
import pytest

import tracker
from tests.helpers.filmed import RIG
from tests.helpers.moments import estimate, moment
from tests.helpers.needs import lack
from tracker.errors import ImageError
from tracker.live import listeners
from tracker.live.listeners import RerunView

if importlib.util.find_spec("rerun") is None:
    lack("rerun", "no module rerun")

MODEL = tracker.load_object("cube_v2")


class Shown:
    """A scene that waits until it may go on, or fails."""

    def __init__(self, error=None):
        self.error, self.numbers = error, []
        self.at_work, self.may_go_on = threading.Event(), threading.Event()

    def show(self, index, timestamp, observation, images):
        self.at_work.set()
        assert self.may_go_on.wait(20)
        if self.error is not None:
            raise self.error
        self.numbers.append(index)

    def __enter__(self):
        return self

    def __exit__(self, *_): ...


def test_images_and_poses_are_in_the_file(tmp_path):
    one = RerunView(tmp_path / "live.rrd", RIG, MODEL)
    images = tuple(np.full((270, 270, 3), 60 + c, np.uint8) for c in range(3))
    one(moment(0, images, pose=estimate(0.05)))
    one.close()
    assert one.fault is None
    chunk = pytest.importorskip("rerun.chunk", reason="rerun: no module rerun.chunk")
    found = {part.entity_path for part in chunk.RrdReader(tmp_path / "live.rrd").stream().to_chunks()}
    assert {"/world/measured", "/confidence/filtered", "/world/cameras/camera60/image"} <= found


def test_a_slow_viewer_is_shown_the_newest_and_holds_up_nobody(monkeypatch):
    shown = Shown()
    monkeypatch.setattr(listeners, "open_scene", lambda *_: shown)
    one = RerunView(None, RIG, MODEL)
    one(moment(0))
    assert shown.at_work.wait(20)
    for number in range(1, 50):
        one(moment(number))  # returns at once
    shown.may_go_on.set()
    one.close()
    assert shown.numbers == [0, 49]


def test_a_viewer_that_is_closed_ends_the_showing_and_nothing_else(monkeypatch):
    shown = Shown(RuntimeError("the connection is gone"))
    shown.may_go_on.set()
    monkeypatch.setattr(listeners, "open_scene", lambda *_: shown)
    one = RerunView(None, RIG, MODEL)
    one(moment(0))
    one.close()
    assert one.fault == "the connection is gone"
    one(moment(1))  # and no word


def test_a_file_that_cannot_be_is_refused_at_once(tmp_path):
    with pytest.raises(ImageError, match=r"expected \.rrd"):
        RerunView(tmp_path / "live.txt", RIG, MODEL)
