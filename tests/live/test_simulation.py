"""The simulated platform as a source."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

import tracker
from tests.helpers.filmed import RIG
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.errors import LiveError
from tracker.live.sources import open_source
from tracker.live.sources.without_cameras import Simulation, _to_and_fro


def test_a_film_goes_to_and_fro():
    assert [_to_and_fro(n, 4) for n in range(9)] == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert [_to_and_fro(n, 1) for n in range(3)] == [0, 0, 0]


def test_the_simulated_platform_gives_pictures_of_its_rig():
    skip_without_platform()
    source = Simulation("cube_v2", frames=2)
    given = [source.next(5.0) for _ in range(2)]
    source.close()
    for shot in given:
        sizes = [image.shape for image in shot.images]
        assert sizes == [(camera.height, camera.width, 3) for camera in source.rig]
    assert given[1].timestamp - given[0].timestamp >= 0.1 - 1e-6


def test_a_tracker_of_other_cameras_is_refused(monkeypatch):
    def maker(*_, **__):
        return SimpleNamespace(rig=RIG, chunk=lambda _: drawn(), close=lambda: None)

    def drawn():
        yield pytest.fail("it is drawn")

    monkeypatch.setattr("tracker.live.sources.without_cameras._maker", maker)
    model = tracker.load_object("cube_v2")
    assert open_source("simulation", tracker.ObjectTracker(model, RIG)).rig is RIG
    other = tracker.CameraRig((RIG.cameras[1], RIG.cameras[0], *RIG.cameras[2:]), arena=RIG.arena)
    with pytest.raises(LiveError, match="a tracker of other cameras"):
        open_source("simulation", tracker.ObjectTracker(model, other))


def test_the_film_is_drawn_when_it_is_asked_for_and_no_longer_than_one_waits(monkeypatch):
    film = [SimpleNamespace(images=(np.full((2, 2, 3), n, np.uint8),)) for n in range(3)]
    drawn, closed = [], []

    def chunk(_):
        for one in film:
            time.sleep(0.05)
            drawn.append(one)
            yield one

    maker = SimpleNamespace(rig=RIG, chunk=chunk, close=lambda: closed.append(True))
    monkeypatch.setattr("tracker.live.sources.without_cameras._maker", lambda *_: maker)
    source = Simulation("cube_v2", frames=3)
    assert not drawn
    assert source.next(0.01) is None
    assert len(drawn) == 1
    assert source.draw()
    assert len(drawn) == 3
    assert closed
    before = time.time()
    shot = source.next(5.0)
    assert shot.timestamp >= before  # the film begins when it is shown
    assert shot.images[0] is film[0].images[0]


def test_without_the_generator_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr("tracker.live.sources.without_cameras.find_spec", lambda name: None)
    with pytest.raises(LiveError, match=r"pip install .*\[synthetic\]"):
        Simulation("cube_v2")
