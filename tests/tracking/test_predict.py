import itertools

import numpy as np
import pytest

import tracker
from tests.helpers.consistency import nees, pose_error
from tests.helpers.pushed_cube import DT, MODEL, bits, image_of, new, off, play, shot, within
from tracker import TrackerError, TrackingOptions
from tracker.geometry import so3
from tracker.tracking.motion import KINDS, LIKELIEST_SHARE

FRAMES = 10
SPEED = np.array([0.25, 0.20, 0.0])
TURN = np.radians([0.0, 0.0, 120.0])
LATER = (0.0, 1e-9, 0.005, 0.01, 0.05, 0.1, 0.2, 0.3, 0.499)


def pose_at(seconds):
    """Pushed all the time, at 0.32 m/s and 120 degrees a second."""
    start = np.array([-0.09, -0.08, 0.0325])
    return start + seconds * SPEED, so3.exp(np.array([0.0, 0.0, 0.4]) + seconds * TURN)


STEP = 0.04
"""Between the images of the film [s]."""


def film_of(rig, ages, count=FRAMES):
    """Images that each camera took by its age [s] before the moment."""
    return [
        [image_of(rig, c, pose_at(STEP * k - age), k) for c, age in enumerate(ages)] for k in range(count)
    ]


@pytest.fixture(scope="module")
def film(rig):
    return film_of(rig, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def reference(rig, film):
    return play(new(rig), film, dt=STEP)


@pytest.fixture
def moving(rig, film):
    """A tracker that has seen the film, and the stamp of its end."""
    one = new(rig)
    play(one, film, dt=STEP)
    return one, STEP * (FRAMES - 1)


def squares(pose, seconds):
    """NEES of a pose."""
    return nees(pose_error(pose.position, pose.rotation, *pose_at(seconds)), pose.covariance)


def exceeds(matrix, other):
    """Whether a covariance is not less than another in any direction, up to rounding."""
    units = 1.0 / np.sqrt(np.diag(other))
    return np.linalg.eigvalsh((matrix - other) * np.outer(units, units)).min() > -1e-9


def test_predictions_change_nothing(rig, film, reference):
    one = new(rig)
    for k, images in enumerate(film):
        answer = one.update(images, STEP * k)
        assert bits(answer) == bits(reference[k])
        before = bits(answer)
        for dt in (*LATER, 0.6, 100.0, 0.0):
            one.predict(STEP * k + dt)
        for wrong in (np.nan, STEP * k - 1.0):
            with pytest.raises(TrackerError):
                one.predict(wrong)
        assert bits(answer) == before
        assert one.update(images, STEP * k) is answer


def test_a_prediction_to_the_last_images_is_near_the_filtered_pose(rig, film):
    one = new(rig)
    for k, images in enumerate(film):
        filtered = one.update(images, STEP * k).filtered_object_pose
        found = one.predict(STEP * k)
        off_by = found.position - filtered.position
        assert off_by @ np.linalg.solve(filtered.covariance[:3, :3], off_by) < 1.0
        # What is unlikely is left out.
        assert exceeds(1.5 * filtered.covariance, found.covariance)


@pytest.mark.parametrize("dt", LATER)
def test_the_kinds_of_motion_are_offered_and_the_likely_ones_make_the_prediction(moving, dt):
    one, now = moving
    found = one.predict(now + dt)
    weights = [kind.probability for kind in found.kinds]
    assert {kind.name for kind in found.kinds} == set(KINDS)
    assert weights == sorted(weights, reverse=True)
    assert sum(weights) == pytest.approx(1.0)
    count = int(np.searchsorted(np.cumsum(weights), LIKELIEST_SHARE)) + 1
    mean = np.average([kind.position for kind in found.kinds[:count]], axis=0, weights=weights[:count])
    np.testing.assert_allclose(found.position, mean, atol=1e-9)
    spread = [np.trace(kind.covariance[:3, :3]) for kind in found.kinds[:count]]
    assert np.trace(found.covariance[:3, :3]) >= np.average(spread, weights=weights[:count]) * (1 - 1e-9)
    if dt > 0.0:
        # That a motion may turn into any other is what an update without images allows for.
        answer = one.update([None] * 3, now + dt).filtered_object_pose
        assert np.trace(answer.covariance) > np.trace(found.covariance)


def test_no_prediction_has_the_object_in_the_table(rig):
    one, drop = new(rig), np.array([0.0, 0.0, -0.25])
    for k in range(6):
        position, rotation = pose_at(0.3)
        one.update(shot(rig, (position + [0.0, 0.0, 0.07] + STEP * k * drop, rotation), k), STEP * k)
    lowest = []
    for dt in np.linspace(0.0, 0.45, 10):
        found = one.predict(5 * STEP + dt)
        for pose in (found, *found.kinds):
            lowest.append(pose.position[2] - np.abs(pose.rotation[2]) @ MODEL.size / 2)
    assert min(lowest) > -1e-9


@pytest.mark.parametrize("dt", LATER[2:6])
def test_a_prediction_moves_with_the_velocity(moving, dt):
    one, now = moving
    start, found = one.predict(now), one.predict(now + dt)
    np.testing.assert_allclose(start.velocity[:3], SPEED, atol=0.02)
    np.testing.assert_allclose(found.position - start.position, dt * SPEED, atol=0.1 * dt * 0.32)
    turned = so3.log(found.rotation @ start.rotation.T)
    np.testing.assert_allclose(turned, dt * TURN, atol=0.1 * dt * np.linalg.norm(TURN))
    assert off(found, pose_at(now + dt))[0] < off(start, pose_at(now + dt))[0]


def test_a_prediction_of_what_lies_still_stays_where_it_is(rig):
    one, resting = new(rig), pose_at(0.3)
    for k in range(8):
        one.update(shot(rig, resting, k), DT * k)
    start = one.predict(7 * DT)
    for dt in LATER:
        found = one.predict(7 * DT + dt)
        assert within(found, resting, 0.3, 0.3), dt
        assert np.linalg.norm(found.position - start.position) < 2e-4


def test_the_covariance_of_predictions_grows_with_time(moving):
    one, now = moving
    found = [one.predict(now + dt) for dt in LATER]
    for before, after in itertools.pairwise(found):
        assert exceeds(after.covariance, before.covariance)
        assert after.confidence <= before.confidence + 1e-9
    assert np.trace(found[-1].covariance) > 100 * np.trace(found[0].covariance)
    for pose in found:
        np.testing.assert_allclose(pose.covariance, pose.covariance.T, rtol=0, atol=1e-15)
        assert (np.linalg.eigvalsh(pose.covariance) > 0).all()


def test_predictions_are_within_their_covariance(moving):
    one, now = moving
    for dt in LATER:
        assert squares(one.predict(now + dt), now + dt) < 30, dt


def test_there_is_no_prediction_before_the_object_was_seen(rig, film):
    one = new(rig)
    assert one.predict(0.0) is None
    assert one.predict(-100.0) is None
    one.update([None] * 3, 1.0)
    assert one.predict(1.0) is None
    one.update(film[0], 1.1)
    assert one.predict(1.1) is not None
    one.reset()
    assert one.predict(0.0) is None


@pytest.mark.parametrize("coast", [0.1, 0.5, 2.0])
def test_a_prediction_ends_when_coasting_does(rig, film, coast):
    one = tracker.ObjectTracker(
        tracker.load_object("cube_v2"), rig, tracking=TrackingOptions(coast_seconds=coast)
    )
    play(one, film[:3], dt=STEP)
    now = 2 * STEP
    assert one.predict(now + coast - 1e-6) is not None
    assert one.predict(now + coast + 1e-6) is None
    assert one.predict(now + 1e9) is None
    # Images without the object do not make it last longer.
    one.update([None] * 3, now + 0.5 * coast)
    assert one.predict(now + coast - 1e-6) is not None
    assert one.predict(now + coast + 1e-6) is None


@pytest.mark.parametrize("kind", [list, tuple, np.array])
def test_the_same_stamp_for_every_camera_is_one_stamp(rig, film, reference, kind):
    one = new(rig)
    for k, images in enumerate(film):
        assert bits(one.update(images, kind([STEP * k] * 3))) == bits(reference[k])


def test_stamps_of_cameras_without_an_image_do_not_count(rig, film):
    one, other = new(rig), new(rig)
    for k, images in enumerate(film):
        some = [images[0], None, images[2]]
        odd = (np.nan, 1e9, -1e9, 0.0)[k % 4]
        answer = one.update(some, [STEP * k, odd, STEP * k])
        assert bits(answer) == bits(other.update(some, STEP * k))


def errors(answers):
    """Distances [mm] of the poses from where the object was at the latest stamps, after a few images."""
    found = []
    for k, answer in enumerate(answers):
        if k >= 4:
            assert answer.object_pose is not None
            found.append(off(answer.object_pose, pose_at(STEP * k))[0])
    return np.array(found)


AGES = [(0.0, 0.01, 0.02), (0.02, 0.0, 0.01), (0.0, 0.01, 0.01)]


@pytest.mark.parametrize("ages", AGES)
def test_stamps_of_each_camera_are_much_better_than_one_for_all(rig, ages):
    film = film_of(rig, ages)
    stamped, plain = new(rig), new(rig)
    with_stamps = [stamped.update(images, [STEP * k - age for age in ages]) for k, images in enumerate(film)]
    without = play(plain, film, dt=STEP)
    assert np.median(errors(with_stamps)) < 0.25 * np.median(errors(without))
    assert errors(with_stamps).max() < 0.5
    for k, answer in enumerate(with_stamps[4:], 4):
        assert within(answer.filtered_object_pose, pose_at(STEP * k), 0.5, 0.5)


def test_which_camera_is_the_latest_does_not_matter_to_a_resting_object(rig):
    resting = pose_at(0.6)
    film = [shot(rig, resting, k) for k in range(6)]
    for ages in AGES:
        one = new(rig)
        for k, images in enumerate(film):
            answer = one.update(images, [STEP * k - age for age in ages])
            pose, shift, turn = answer.object_pose, 0.3, 0.3
            if k == 0:
                # In the first pictures it is not known that the object rests: they leave its velocity open.
                shift, turn = (
                    3 * unit * np.sqrt(np.trace(block))
                    for unit, block in ((1e3, pose.covariance[:3, :3]), (57.3, pose.covariance[3:, 3:]))
                )
                assert shift < 3.0
            assert within(pose, resting, shift, turn), (ages, k)


def test_a_camera_that_is_older_than_the_last_images_may_be_among_them(rig, film):
    one = new(rig)
    play(one, film[:6], dt=STEP)
    images = [image_of(rig, c, pose_at(5.5 * STEP - age), 6) for c, age in enumerate((0.0, 0.03, 0.0))]
    answer = one.update(images, [5.5 * STEP, 5.5 * STEP - 0.03, 5.5 * STEP])
    assert within(answer.object_pose, pose_at(5.5 * STEP), 0.5, 0.5)


@pytest.mark.parametrize("ages", [(0.0, 0.01, 0.02), (0.02, 0.0, 0.01), (0.01, 0.0, 0.01)])
def test_the_first_pose_of_cameras_apart_in_time_is_as_uncertain_as_it_is_wrong(rig, ages):
    images = [image_of(rig, c, pose_at(0.1 - age), c) for c, age in enumerate(ages)]
    pose = new(rig).update(images, [0.1 - age for age in ages]).object_pose
    assert squares(pose, 0.1) < 50
