import time

import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.filmed import shots
from tests.helpers.log_writers import make_content, write_native
from tests.helpers.moments import estimate
from tests.live.test_live import Given
from tests.live.test_without_cameras import Frames, frame
from tracker.errors import LiveError
from tracker.live import ImageSet, Pushed, Replay
from tracker.live.platform import Frontend, LogReader, convert_image
from tracker.logs.pictures import from_bayer
from tracker.pose.result import Observation, Status


@pytest.fixture(scope="module")
def film():
    return shots("cube_v2", 1, seed=621)[0].images


@pytest.fixture
def source():
    return Pushed()


class Cube:
    """A tracker that is sure of its cube, unless all images are missing."""

    rig = RIG

    def __init__(self):
        self.count = -1

    def reset(self): ...

    def update(self, images, stamps):
        self.count += 1
        pose = None if all(image is None for image in images) else estimate(0.01 * self.count)
        return Observation(pose, pose, Status.LOST if pose is None else Status.TRACKING)

    def forecast(self):
        return lambda timestamp: None


def push(source, film, stamp):
    source.push([image.copy() for image in film], [stamp, stamp + 0.001, stamp + 0.002])


def loop(robot, steps):
    """A control loop as the platform's users write it, of its names only."""
    seen = []
    for t in range(steps):
        observation = robot.get_camera_observation(t)
        for camera in observation.cameras:
            assert camera.image is None or camera.image.shape == (270, 270, 3)
            assert camera.timestamp > 0
        pose = observation.filtered_object_pose
        if pose.confidence > 0.5:
            seen.append((pose.position, pose.orientation, observation.object_pose.confidence))
        robot.wait_until_timeindex(robot.get_current_timeindex())
    return seen


def test_a_control_loop_finds_the_cube_by_the_platforms_names(film, source):
    with Frontend(source, tracker.ObjectTracker("cube_v2", RIG)) as robot:
        assert not robot.has_observations()
        push(source, film, 10.0)
        seen = loop(robot, 5)
        assert robot.has_observations()
        assert robot.get_current_timeindex() == robot.get_oldest_timeindex() == 0
        assert robot.get_timestamp_ms(0) == pytest.approx(10002.0)
        assert [camera.timestamp for camera in robot.get_observation(0).cameras] == [10.0, 10.001, 10.002]
        assert robot.get_sensor_info() is RIG
    expected = tracker.ObjectTracker("cube_v2", RIG).update(film, [10.0, 10.001, 10.002])
    assert len(seen) == 5
    for position, orientation, confidence in seen:
        assert np.array_equal(position, expected.filtered_object_pose.position)
        assert np.array_equal(orientation, expected.filtered_object_pose.orientation)
        assert confidence == expected.object_pose.confidence


def test_the_same_loop_runs_against_a_recording(film):
    frames = [frame(n, 0.05 * n, np.full(3, 0.05 * n), film) for n in range(10)]
    with Frontend(Replay(Frames(frames)), Cube()) as robot:
        seen = loop(robot, 5)
        robot.wait_until_timeindex(2)
    assert len(seen) == 5


def test_time_indices_count_sets_and_old_ones_are_forgotten(film, source):
    with Frontend(source, Cube(), history=3) as robot:
        for n in range(6):
            push(source, film, 10.0 + n)
            robot.wait_until_timeindex(n)
        assert robot.get_current_timeindex() == 5
        assert robot.get_oldest_timeindex() == 3
        assert robot.get_pose(4).position[0] == pytest.approx(0.04)
        assert robot.get_current_pose().position[0] == pytest.approx(0.05)
        with pytest.raises(LiveError, match="observation 2: not kept any more, the oldest is 3"):
            robot.get_observation(2)


def test_an_observation_to_come_is_waited_for_and_none_that_will_not(film, source):
    with Frontend(source, Cube()) as robot:
        push(source, film, 10.0)
        source.finish()
        assert robot.get_observation(0).object_pose.confidence == 0.97
        start = time.monotonic()
        with pytest.raises(LiveError, match="observation 1: will not come: the source has ended"):
            robot.get_observation(1)
        assert time.monotonic() - start < 10


def test_once_the_source_has_failed_its_last_observation_is_not_the_latest_any_more(film):
    failing = Given(ImageSet(tuple(film), (1.0,) * 3), error=LiveError("camera60: gone for good"))
    with Frontend(failing, Cube()) as robot:
        while robot.live.running:
            time.sleep(0.01)
        with pytest.raises(LiveError, match="observation 1: will not come: camera60: gone for good"):
            robot.get_camera_observation()
        assert robot.get_observation(0).object_pose.confidence == 0.97


def test_where_no_object_is_found_nobody_can_compute_with_its_pose(source):
    with Frontend(source, Cube()) as robot:
        source.push([None] * 3, 5.0)
        observation = robot.get_latest_observation()
    for pose in (observation.object_pose, observation.filtered_object_pose):
        assert pose.confidence == 0
        assert np.isnan(pose.position).all()
        assert np.isnan(pose.orientation).all()
    assert [camera.image for camera in observation.cameras] == [None] * 3


def test_an_interrupt_in_the_source_reaches_who_waits():
    with Frontend(Given(error=KeyboardInterrupt("now")), Cube()) as robot, pytest.raises(KeyboardInterrupt):
        robot.get_latest_observation()


def test_raw_pixels_are_handed_on_on_request_and_colours_are_refused_there(film):
    raw = tuple(np.random.default_rng(6).integers(0, 256, (3, 540, 540), np.uint8))
    with Frontend(Given(ImageSet(tuple(film), (1.0,) * 3, raw=raw)), Cube(), raw=True) as robot:
        observation = robot.get_camera_observation(123)
    assert np.array_equal(observation.cameras[1].image, raw[1])
    assert np.array_equal(convert_image(observation.cameras[1].image), from_bayer(raw[1]))
    assert np.array_equal(convert_image(film[0]), film[0])
    with (
        Frontend(Given(ImageSet(tuple(film), (1.0,) * 3)), Cube(), raw=True) as robot,
        pytest.raises(LiveError, match="found images in colour, expected raw Bayer pixels"),
    ):
        robot.get_latest_observation()


def test_the_log_reader_has_data_and_timestamps(tmp_path):
    path = write_native(tmp_path / "camera_data.dat", make_content(4))
    reader = LogReader(path)
    with tracker.open_log(path) as log:
        frames = list(log)
    assert len(reader.data) == len(reader.timestamps) == 4
    for observation, stamp, kept in zip(reader.data, reader.timestamps, frames, strict=True):
        assert stamp == pytest.approx(1e3 * kept.timestamp)
        assert np.array_equal(observation.cameras[0].image, (kept.raw or kept.images)[0])
        assert observation.cameras[2].timestamp == kept.camera_timestamps[2]
        expected = kept.recorded_pose
        assert observation.object_pose.confidence == (0 if expected is None else expected.confidence)
    reader.read_file(path)
    assert len(reader.data) == 4
