"""The simulated platform as a source."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

import tracker
from tests.helpers.filmed import RIG
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.errors import LiveError
from tracker.live.opening import open_source
from tracker.live.simulation import Simulation, _to_and_fro


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
    def film(*_, **__):
        return [SimpleNamespace(given=RIG, images=())]

    monkeypatch.setattr("tracker.live.simulation._film", film)
    model = tracker.load_object("cube_v2")
    assert open_source("simulation", tracker.ObjectTracker(model, RIG)).rig is RIG
    other = tracker.CameraRig((RIG.cameras[1], RIG.cameras[0], *RIG.cameras[2:]), arena=RIG.arena)
    with pytest.raises(LiveError, match="a tracker of other cameras"):
        open_source("simulation", tracker.ObjectTracker(model, other))


def test_without_the_generator_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr("tracker.live.simulation.find_spec", lambda name: None)
    with pytest.raises(LiveError, match=r"pip install .*\[synthetic\]"):
        Simulation("cube_v2")
