import dataclasses
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from benchmarks.data import motion as motion_films
from benchmarks.data.motion import AHEAD, HEIGHTS, LEAST, MotionFrame, film_motion
from benchmarks.data.plan import Plan
from benchmarks.measure import motion as measured_motion
from benchmarks.measure.motion import GIVEN, measure_motion, play
from benchmarks.score.errors import pose_errors
from tests.benchmarks.made_up import Knowing, assert_survives, figures_of
from tests.helpers import opencv_pixels, random_rotations
from tracker.geometry import so3

TOGETHER, OWN_STAMPS, ONE_STAMP = GIVEN


def pose(position, rotation=None):
    return np.column_stack([np.eye(3) if rotation is None else rotation, position])


def frame_of(number, moving=True) -> MotionFrame:
    """A frame of an object that goes along x at 1 m/s."""
    stamps = number / 10 - np.array([0.0, 0.005, 0.01])
    image = np.full((4, 4, 3), number, np.uint8)
    latest, ahead = (pose([time, 0, 0]) for time in (number / 10, number / 10 + AHEAD))
    return MotionFrame(stamps, (image,) * 3, (image + 100,) * 3, latest, ahead, moving)


@pytest.mark.parametrize("seed", range(5))
def test_a_motion_has_no_jumps_and_stays_in_view(seed):
    film, motion = film_motion(seed, 0), motion_films.random_motion(np.random.default_rng(seed), -0.2, 8.0)
    # One of a film goes on until its last prediction.
    assert film.legs[0].begin <= -motion_films.SKEW
    assert film.legs[-1].end >= (motion_films.FRAMES - 1) / motion_films.RATE + AHEAD
    assert motion.legs[0].begin == -0.2
    assert motion.legs[-1].end >= 7.8
    for before, after in zip(motion.legs[:-1], motion.legs[1:], strict=True):
        assert before.end == after.begin
        for one, other in zip(before.pose(before.end), after.pose(after.begin), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)
    times = np.arange(0, 7.8, 0.01)
    speeds = [motion.speed(time) for time in times]
    assert min(speeds) == pytest.approx(0, abs=1e-9)
    assert 0.5 * motion_films.SPEED < np.median(speeds) < 1.5 * motion_films.SPEED
    for (x, y, z), rotation in map(motion.pose, times):
        assert np.hypot(x, y) < motion_films.REACH + motion_films.BULGE * LEAST
        assert HEIGHTS[0] <= z <= HEIGHTS[1]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)


def test_there_is_a_next_turning_point_wherever_one_is(rng):
    assert LEAST < motion_films.REACH
    middle = np.array([0.0, 0.0, np.mean(HEIGHTS)])
    for _ in range(100):
        assert np.linalg.norm(motion_films._leg(rng, "straight", 0.0, middle, np.eye(3)).chord) >= LEAST


def test_one_camera_is_the_latest_and_none_is_too_late_and_a_frame_survives_the_disk(rng):
    for cameras in (2, 3, 5):
        found = motion_films.delays(rng, cameras)
        assert (found.min(), found.max(), len(set(found))) == (0, motion_films.SKEW, cameras)
    latest = pose(rng.normal(size=3), random_rotations(rng, 1)[0])
    assert_survives(dataclasses.replace(frame_of(3), latest=latest))


def test_each_camera_takes_its_picture_at_its_own_time():
    make = motion_films._frames("cube_v2", 515151)
    motion = film_motion(515151, 0)
    number = next(k for k in range(100) if motion.speed(k / 10) > 0.4)
    frame = make(number)
    assert frame.moving
    assert frame.timestamp == number / 10
    for k, camera in enumerate(motion_films.rig()):
        if frame.stamps[k] == frame.timestamp:
            assert np.array_equal(frame.skewed[k], frame.together[k])
            continue
        # The middle of what is coloured moves as OpenCV says that the object's centre does.
        places = [frame.latest[:, 3], motion.pose(frame.stamps[k])[0]]
        moved = np.diff(opencv_pixels(camera, places), axis=0)[0]
        assert np.linalg.norm(moved) > 0.5
        seen = _middle(frame.skewed[k]) - _middle(frame.together[k])
        np.testing.assert_allclose(seen, moved, atol=0.2 * np.linalg.norm(moved))


def _middle(image):
    """(2,) centroid of saturated pixels [px]."""
    blurred = cv2.GaussianBlur(image, (0, 0), 1.0).astype(float)
    chosen = np.ptp(blurred, axis=2) > 60
    _, _, stats, centroids = cv2.connectedComponentsWithStats(chosen.astype(np.uint8))
    return centroids[1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])]


@pytest.mark.parametrize("way", GIVEN)
def test_a_frame_is_given_with_the_stamps_of_its_way(way):
    own = Knowing()
    played = play(own, [frame_of(k) for k in range(3)], GIVEN[way])
    assert own.resets == 1
    for k, (first_pixel, stamps) in enumerate(own.given):
        assert first_pixel == k + (0 if way == TOGETHER else 100)
        assert stamps == (frame_of(k).stamps.tolist() if way == OWN_STAMPS else k / 10)
    units = ["mm", "deg", "nees"]
    for kind in ("measured", "predicted"):
        np.testing.assert_allclose(played[[f"{kind}_{unit}" for unit in units]], 0, atol=1e-9)
    assert played.filtered_mm.isna().all()


def test_what_is_compared_has_units(rng):
    rotation = random_rotations(rng, 1)[0]
    orientation = so3.quaternion_from_matrix(so3.exp([0, 0, np.radians(2)]) @ rotation)
    covariance = np.diag([1e-6] * 3 + [np.radians(1) ** 2] * 3)
    found = SimpleNamespace(position=[0.003, 0, 0], orientation=orientation, covariance=covariance)
    assert pose_errors(found, pose([0, 0, 0], rotation)) == pytest.approx({"mm": 3, "deg": 2, "nees": 13})
    assert np.isnan(list(pose_errors(None, pose([0, 0, 0])).values())).all()


def test_only_frames_that_move_count():
    frames = [frame_of(k, moving=k < 3) for k in range(10)]
    for way, off in ((TOGETHER, 0.001), (ONE_STAMP, 0.004)):
        played = play(Knowing(off), frames, GIVEN[way]).assign(group=way, object="cube_v2")
        played.loc[3:, "measured_mm"] = 99.0
        (row,) = figures_of(played, "motion")
        assert row["n"] == 10
        assert row["measured_mm"] == pytest.approx(1e3 * off)
        assert row["predicted_nees"] == pytest.approx(1e6 * off**2)
        assert np.isnan(row["filtered_mm"])


def test_every_way_is_played(tmp_path, monkeypatch):
    monkeypatch.setattr(measured_motion, "OBJECTS", ("cube_v2",))
    monkeypatch.setattr(measured_motion, "FILMS", 1)
    monkeypatch.setattr(measured_motion, "FRAMES", 2)

    def played(own, frames, given):
        assert len(list(frames)) == 2  # the store is asked for frames, as by the real thing
        return play(Knowing(), [frame_of(1)], given)

    monkeypatch.setattr(measured_motion, "play", played)
    frames = measure_motion(Plan(6, 515151, 1, tmp_path))
    assert frames.group.tolist() == list(GIVEN)
