import os
import time
from contextlib import closing
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

from tests.helpers.needs import lack
from tests.live.test_platform import Cube, loop
from tracker.errors import LiveError
from tracker.live import Live, Moment
from tracker.live.cameras import CameraUnfit
from tracker.live.platform import Frontend
from tracker.live.sources import open_cameras

if find_spec("pypylon") is None:
    lack("pylon", "pypylon is not installed")
os.environ.setdefault("PYLON_CAMEMU", "3")

from tracker.live.drivers import PylonCamera, pylon_serials

SERIALS = ["0815-0000", "0815-0001", "0815-0002"]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("pictures"), np.random.default_rng(3)
    images = [rng.integers(0, 256, (540, 540), np.uint8) for _ in range(2)]
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return folder, images


def settings(folder):
    film = {"ImageFilename": str(folder), "ImageFileMode": "On", "TestImageSelector": "Off"}
    return {**film, "PixelFormat": "BayerRG8", "Width": 540, "Height": 540, "ExposureTime": 1500.0}


@pytest.fixture
def camera(pictures):
    with closing(PylonCamera(SERIALS[0], settings(pictures[0]))) as one:
        yield one


def test_pictures_are_the_cameras_to_the_bit_and_stamped_and_its_settings_are_reported(camera, pictures):
    before = time.time()
    given = [camera.grab(2.0) for _ in range(2)]
    assert np.array_equal([one.image for one in given], pictures[1])
    assert before < given[0].stamp < given[1].stamp <= time.time() + 1e-3
    found = camera.settings()
    assert (found["ExposureTime"], found["PixelFormat"]) == (1500.0, "BayerRG8")
    assert "Gain" in found


def test_stamps_are_half_the_present_exposure_time_after_the_trigger(camera):
    camera._camera.ExposureTime.Value = 400_000.0  # as ExposureAuto does [µs]
    before = time.time()
    assert before + 0.2 <= camera.grab(2.0).stamp


def test_a_failed_buffer_is_one_picture_that_is_missing(camera):
    camera.grab(2.0)
    camera._camera.ForceFailedBufferCount.Value = 1
    camera._camera.ForceFailedBuffer.Execute()
    with pytest.raises(LiveError, match="0815-0000: The buffer was incompletely grabbed") as raised:
        camera.grab(2.0)
    assert raised.type is LiveError  # it is not lost
    assert camera.grab(2.0).image.shape == (540, 540)


def test_an_image_that_comes_after_its_grab_gave_up_is_not_taken_for_the_next(camera, pictures):
    camera.grab(2.0)
    # Until it is ready, the camera ignores a trigger.
    camera._camera.WaitForFrameTriggerReady(10_000, camera._pylon.TimeoutHandling_ThrowException)
    camera._camera.TriggerSoftware.Execute()
    assert camera._camera.GetGrabResultWaitObject().Wait(10_000)
    assert np.array_equal(camera.grab(2.0).image, pictures[1][0])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"ExposureTime": "long"}, "does not take ExposureTime = 'long'"),
        ({"Nonsense": 1}, "does not take Nonsense = 1"),
        ({"PixelFormat": "Mono8"}, "PixelFormat Mono8, expected one of BayerRG8"),
    ],
)
def test_a_setting_that_is_not_taken_is_named(wrong, words):
    with pytest.raises(CameraUnfit, match=f"pylon: 0815-0001.* {words}"):
        PylonCamera(SERIALS[1], wrong)


def test_a_camera_may_round_whole_numbers_too():
    with closing(PylonCamera(SERIALS[1], {"PixelFormat": "BayerRG8", "Gain": 1})) as one:
        assert 1 < one.settings()["Gain"] < 1.001


def test_a_camera_that_is_not_there_is_named():
    with pytest.raises(LiveError, match="pylon: 4711 cannot be opened"):
        PylonCamera("4711")
    with pytest.raises(LiveError, match=r"calls itself camera60; there are 0815-0000"):
        pylon_serials(["camera60"])


@pytest.fixture
def source(pictures, tmp_path):
    """Three cameras, the last with a setting of its own."""
    text = "\n".join(f"{name} = {value!r}" for name, value in settings(pictures[0]).items())
    (tmp_path / "cameras.toml").write_text(text + '\n["0815-0002"]\nExposureTime = 1400.0\n')
    return open_cameras(f"pylon:{','.join(SERIALS)}", Cube.rig, settings=tmp_path / "cameras.toml")


def test_three_cameras_are_a_source_for_live(source, pictures):
    with Live(source, Cube()) as live:
        moment = live.wait(after=-1, timeout=60)
        while any(image is None for image in moment.taken.images):
            moment = live.wait(after=moment, timeout=60)
    assert isinstance(moment, Moment)
    assert moment.taken.faults == (None, None, None)
    assert [image.shape for image in moment.taken.images] == [(270, 270, 3)] * 3  # halved for the rig
    assert all(any(np.array_equal(raw, one) for one in pictures[1]) for raw in moment.taken.raw)
    assert 0 <= moment.latency < 5


def test_the_platforms_loop_runs_against_cameras(source):
    with Frontend(source, Cube()) as robot:
        robot.wait_until_timeindex(1)
        assert loop(robot, 3)
        assert time.time() - robot.get_timestamp_ms(robot.get_current_timeindex()) / 1e3 < 30
