import copy
import itertools
from functools import partial

import numpy as np
import pytest

from tests.helpers import nudged
from tests.helpers.consistency import nees, pose_error
from tests.helpers.pushed_cube import DT, bits, has_seen, image_of, near, new, off, play, shot, within
from tracker import Status, TrackerError
from tracker.geometry import so3
from tracker.inputs import check_stamps
from tracker.live import ImageSet
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.pose.fit import Lag
from tracker.recordings import track
from tracker.tracking import follow
from tracker.tracking.motion import KINDS, LIKELIEST_SHARE

FRAMES = 10
STEP = 0.04
"""Between the images of the film [s]."""
END = STEP * (FRAMES - 1)
SPEED = np.array([0.25, 0.20, 0.0])
TURN = np.radians([0.0, 0.0, 120.0])
LATER = (0.0, 1e-9, 0.005, 0.01, 0.05, 0.1, 0.2, 0.3, 0.499)


def pose_at(seconds):
    """Pushed all the time, at 0.32 m/s and 120 degrees a second."""
    start = np.array([-0.09, -0.08, 0.0325])
    return start + seconds * SPEED, so3.exp(np.array([0.0, 0.0, 0.4]) + seconds * TURN)


def taken(rig, now, ages, seed):
    """Images that each camera took by its age [s] before the moment."""
    return [image_of(rig, c, pose_at(now - age), seed) for c, age in enumerate(ages)]


@pytest.fixture(scope="module")
def passing(rig):
    return [taken(rig, STEP * k, (0.0, 0.0, 0.0), k) for k in range(FRAMES)]


def test_a_recording_is_tracked_with_the_stamps_of_its_images(rig, tmp_path):
    ages = np.array([0.03, 0.015, 0.0])
    with Hdf5LogWriter(tmp_path / "log.h5", rig) as log:
        for k in range(FRAMES):
            log.append(taken(rig, STEP * k, ages, k), STEP * k + 0.09, STEP * k - ages)
    poses = track(tmp_path / "log.h5", new(rig).model, rig=rig).poses
    np.testing.assert_allclose(poses.timestamp, STEP * np.arange(FRAMES), atol=1e-9)
    truth = np.array([pose_at(STEP * k)[0] for k in range(FRAMES)])
    assert np.median(np.linalg.norm(poses.measured.position - truth, axis=1)) < 5e-4


def test_a_black_image_has_no_more_of_a_stamp_than_a_missing_one(rig, passing, tmp_path):
    ahead, missing, dark = np.array([0.0, 0.0, 0.05]), new(rig), new(rig)
    with Hdf5LogWriter(tmp_path / "log.h5", rig) as log:
        for k, (*images, last) in enumerate(passing):
            black, stamps = np.zeros_like(last), 0.1 + STEP * k + ahead
            log.append([*images, black], 0.2 + STEP * k, stamps)
            expected = missing.update([*images, None], stamps).filtered_object_pose
            found = dark.update([*images, black], stamps).filtered_object_pose
            np.testing.assert_array_equal(found.position, expected.position)
            np.testing.assert_array_equal(found.covariance, expected.covariance)
            taken = ImageSet((*images, black), tuple(stamps))
            assert taken.timestamp == stamps[0]
    poses = track(tmp_path / "log.h5", new(rig).model, rig=rig).poses
    np.testing.assert_allclose(poses.timestamp, 0.1 + STEP * np.arange(FRAMES), atol=1e-9)


def test_a_wrong_calibration_is_doubted_although_cameras_are_read_one_after_another(rig):
    wrong = nudged(rig, 1, [0.0, 0.02, 0.0])
    images = [image_of(rig, c, pose_at(0.0), 3) for c in range(3)]
    for stamps in (0.0, [0.0, 0.001, 0.002], [0.0, 0.005, 0.01]):
        pose = new(wrong).update(images, stamps).object_pose
        assert pose is None or pose.confidence < 0.5


def test_a_frozen_camera_counts_as_missing_however_old_its_image_is(rig, passing):
    one, other = new(rig), new(rig)
    for k, images in enumerate(passing):
        now = STEP * k
        frozen = [*images[:2], passing[min(k, 4)][2]], [now - 0.01, now, STEP * min(k, 4)]
        missing = [*images[:2], images[2] if k < 5 else None], [now - 0.01, now, now]
        found = [tracker.update(*given).object_pose for tracker, given in ((one, frozen), (other, missing))]
        np.testing.assert_allclose(found[0].position, found[1].position, atol=1e-9)
        np.testing.assert_allclose(found[0].covariance, found[1].covariance, rtol=1e-6, atol=1e-15)


@pytest.fixture(scope="module")
def moving(rig, passing):
    """A tracker that has seen the film."""
    return has_seen(rig, passing, dt=STEP)


def squares(pose, seconds):
    """NEES of a pose."""
    return nees(pose_error(pose.position, pose.rotation, *pose_at(seconds)), pose.covariance)


def exceeds(matrix, other):
    """Whether a covariance is not less than another in any direction, up to rounding."""
    units = 1.0 / np.sqrt(np.diag(other))
    return np.linalg.eigvalsh((matrix - other) * np.outer(units, units)).min() > -1e-9


def test_predictions_change_nothing_and_that_to_the_last_images_is_near_the_filtered_pose(rig, passing):
    one, other = new(rig), new(rig)
    for k, images in enumerate(passing):
        answer = one.update(images, STEP * k)
        before = bits(answer)
        assert before == bits(other.update(images, STEP * k))
        filtered, found = answer.filtered_object_pose, one.predict(STEP * k)
        off_by = found.position - filtered.position
        assert off_by @ np.linalg.solve(filtered.covariance[:3, :3], off_by) < 1.0
        # What is unlikely is left out.
        assert exceeds(1.5 * filtered.covariance, found.covariance)
        for dt in (*LATER, 0.6, 100.0, 0.0):
            one.predict(STEP * k + dt)
        for wrong in (np.nan, STEP * k - 1.0):
            with pytest.raises(TrackerError):
                one.predict(wrong)
        assert bits(answer) == before
        assert one.update(images, STEP * k) is answer


@pytest.mark.parametrize("dt", LATER)
def test_the_kinds_of_motion_are_offered_and_the_likely_ones_make_the_prediction(moving, dt):
    found = moving.predict(END + dt)
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
        answer = copy.deepcopy(moving).update([None] * 3, END + dt).filtered_object_pose
        assert np.trace(answer.covariance) > np.trace(found.covariance)


def test_no_prediction_has_the_object_in_the_table(rig):
    (position, rotation), drop = pose_at(0.3), np.array([0.0, 0.0, -0.25])
    falling = [position + np.array([0.0, 0.0, 0.07]) + STEP * k * drop for k in range(6)]
    one = has_seen(rig, [shot(rig, (place, rotation), k) for k, place in enumerate(falling)], dt=STEP)
    for dt in np.linspace(0.0, 0.45, 10):
        found = one.predict(5 * STEP + dt)
        for pose in (found, *found.kinds):
            assert pose.position[2] - np.abs(pose.rotation[2]) @ one.model.size / 2 > -1e-9


@pytest.mark.parametrize("dt", LATER[2:6])
def test_a_prediction_moves_with_the_velocity(moving, dt):
    start, found = moving.predict(END), moving.predict(END + dt)
    np.testing.assert_allclose(start.velocity[:3], SPEED, atol=0.02)
    np.testing.assert_allclose(found.position - start.position, dt * SPEED, atol=0.1 * dt * 0.32)
    turned = so3.log(found.rotation @ start.rotation.T)
    np.testing.assert_allclose(turned, dt * TURN, atol=0.1 * dt * np.linalg.norm(TURN))
    assert off(found, pose_at(END + dt))[0] < off(start, pose_at(END + dt))[0]


def test_the_covariance_of_predictions_grows_with_time_and_with_their_errors(moving):
    found = [moving.predict(END + dt) for dt in LATER]
    for before, after in itertools.pairwise(found):
        assert exceeds(after.covariance, before.covariance)
        assert after.confidence <= before.confidence + 1e-9
    assert np.trace(found[-1].covariance) > 100 * np.trace(found[0].covariance)
    for dt, pose in zip(LATER, found, strict=True):
        np.testing.assert_allclose(pose.covariance, pose.covariance.T, rtol=0, atol=1e-15)
        assert (np.linalg.eigvalsh(pose.covariance) > 0).all()
        assert squares(pose, END + dt) < 30, dt


def test_there_is_no_prediction_before_the_object_was_seen(rig, passing):
    one = new(rig)
    assert one.predict(0.0) is None
    assert one.predict(-100.0) is None
    one.update([None] * 3, 1.0)
    assert one.predict(1.0) is None
    one.update(passing[0], 1.1)
    assert one.predict(1.1) is not None
    one.reset()
    assert one.predict(0.0) is None


@pytest.mark.parametrize("coast", [0.1, 0.5, 2.0])
def test_a_prediction_ends_when_coasting_does(rig, passing, coast):
    one = new(rig, coast_seconds=coast)
    play(one, passing[:3], dt=STEP)
    now = 2 * STEP
    for _ in range(2):
        assert one.predict(now + coast - 1e-6) is not None
        assert one.predict(now + coast + 1e-6) is None
        assert one.predict(now + 1e9) is None
        # Images without the object do not make it last longer.
        one.update([None] * 3, now + 0.5 * coast)


def gliding(seconds, speed):
    """A pose on a straight way [m/s], turned at 3 rad for each metre."""
    place = np.array([-0.1, -0.05, 0.0325]) + seconds * speed * np.array([0.96, 0.28, 0.0])
    return place, so3.exp([0.0, 0.0, 0.4 + 3.0 * speed * seconds])


AGES = [(0.0, 0.01, 0.02), (0.02, 0.0, 0.01), (0.0, 0.01, 0.01)]
GLIDES = [(partial(gliding, speed=speed), (0.03, 0.015, 0.0), 5 * speed) for speed in (0.1, 0.5, 1.0)]


@pytest.mark.parametrize(("way", "ages", "off_by"), [*GLIDES, *[(pose_at, ages, 2.0) for ages in AGES]])
def test_what_is_seen_late_is_moved_by_the_velocity(rig, way, ages, off_by):
    one, naive, errors, age = new(rig), new(rig), [], np.array(ages)
    for k in range(6):
        stamps, truth = STEP * k - age, way(STEP * k)
        images = [image_of(rig, c, way(stamps[c]), 10 * k) for c in range(3)]
        answer = one.update(images, stamps)
        assert answer.object_pose is not None, k
        # Before, the velocity is not known yet.
        if k >= 2:
            assert answer.status is Status.TRACKING, k
            assert near(answer, truth, 0.5, 0.5), k
            assert answer.object_pose.confidence > 0.95, k
        pose = naive.update(images, float(stamps.max())).object_pose
        errors += [] if pose is None else [off(pose, truth)[0]]
    # With one stamp for all, the same pictures are explained by no pose so well.
    assert np.median(errors) > off_by


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
                shift = 3e3 * np.sqrt(np.trace(pose.covariance[:3, :3]))
                turn = 3 * 57.3 * np.sqrt(np.trace(pose.covariance[3:, 3:]))
                assert shift < 3.0
            assert within(pose, resting, shift, turn), (ages, k)


def test_a_camera_that_is_older_than_the_last_images_may_be_among_them(rig, passing):
    one, now, ages = has_seen(rig, passing[:6], dt=STEP), 5.5 * STEP, (0.0, 0.03, 0.0)
    answer = one.update(taken(rig, now, ages, 6), [now - age for age in ages])
    assert within(answer.object_pose, pose_at(now), 0.5, 0.5)


def test_the_older_an_image_the_less_is_known_of_the_motion_since(rig, passing, monkeypatch):
    given = []
    monkeypatch.setattr(follow, "Lag", lambda *known: given.append(Lag(*known)) or given[-1])
    for age in (0.01, 0.1, 0.3):
        one, now = has_seen(rig, passing, dt=STEP), END + STEP
        one.update(taken(rig, now, (0.0, 0.0, age), 7), [now, now, now - age])
    assert len(given) == 3
    for less, more in itertools.pairwise(given):
        # The object may have begun to move since, or stopped.
        assert exceeds(more.covariance, less.covariance)
        assert np.trace(more.covariance) > 1.05 * np.trace(less.covariance)


@pytest.mark.parametrize("ages", [(0.0, 0.01, 0.02), (0.02, 0.0, 0.01), (0.01, 0.0, 0.01)])
def test_the_first_pose_of_cameras_apart_in_time_is_as_uncertain_as_it_is_wrong(rig, ages):
    images = [image_of(rig, c, pose_at(0.1 - age), c) for c, age in enumerate(ages)]
    pose = new(rig).update(images, [0.1 - age for age in ages]).object_pose
    assert squares(pose, 0.1) < 50


@pytest.mark.parametrize(
    ("given", "shown", "latest", "delays"),
    [
        (1.5, [True, False, True], 1.5, [0.0] * 3),
        (np.float32(2.0), [False] * 3, 2.0, [0.0] * 3),
        *((kind([1.5] * 3), [True] * 3, 1.5, [0.0] * 3) for kind in (list, tuple, np.array)),
        ([1.0, 1.5, 1.25], [True] * 3, 1.5, [0.5, 0.0, 0.25]),
        ({"right": 1.25, "left": 1.0, "middle": 1.5}, [True] * 3, 1.5, [0.5, 0.0, 0.25]),
        *(
            ([1.0, none, 1.25], [True, False, True], 1.25, [0.25, 0.0, 0.0])
            for none in (np.nan, np.inf, -np.inf, 7.0, -7.0, 1e9, -1e9, 0.0, None)
        ),
    ],
)
def test_the_latest_picture_counts_others_are_older_and_those_without_do_not_count(
    given, shown, latest, delays
):
    last, older = check_stamps(given, shown, ("left", "middle", "right"))
    assert last == latest
    np.testing.assert_allclose(older, delays)


def test_a_set_without_images_has_the_time_that_is_given(rig, short):
    one = new(rig)
    one.update(short[0], 0.0)
    nothing = [None] * 3
    with pytest.raises(TrackerError, match="found none for any camera, expected one number"):
        one.update(nothing, [None] * 3)
    one.update(nothing, [0.1, None, None])
    with pytest.raises(TrackerError, match=r"found 0\.050000 s after 0\.100000 s"):
        one.update(nothing, 0.05)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("now", "'now', expected finite numbers of seconds"),
        (None, "expected"),
        (True, "expected"),
        (1j, "expected"),
        (10**400, "a whole number above 10.18, expected finite"),
        ([10**400, 1.0, 1.0], "expected finite"),
        (np.datetime64("2026-05-04T03:02:01", "ns"), "datetime64.*astype"),
        (np.timedelta64(3, "s"), "expected finite"),
        (1_770_000_000_000_000_000, "nanoseconds"),
        (np.float32(1.77e9), "of float32, expected float64"),
        (1.77e12, "nanoseconds"),
        ([1.0, 2.0], "2 stamps, expected one, or one for each of 3"),
        ([], "0 stamps, expected one"),
        ([[1.0, 2.0, 3.0]], r"shape \(1, 3\)"),
        ([1.0, np.nan, 3.0], "finite"),
        (-np.inf, "found -inf, expected finite"),
        ([1.0, [2.0], 3.0], "expected finite numbers of seconds"),
        ({"camera60": 1.0, "camera180": 1.0, "top": 1.0}, "unknown 'top'; missing camera300"),
        ({"camera60": 1.0, "camera180": 1.0}, r"missing camera300; .*\(nan for a missing image\)$"),
    ],
)
def test_wrong_stamps_are_named(rig, short, given, says):
    with pytest.raises(TrackerError, match=says):
        new(rig).update(short[0], given)


NO_MOMENTS = ["x", None, np.nan, np.inf, -np.inf, 10**400, 1.77e18, np.datetime64("now"), [1.0], {}]


def test_a_moment_that_is_past_or_none_is_not_predicted(rig, short):
    one, unused = has_seen(rig, short[:2]), new(rig)
    past = [(one, stamp) for stamp in (DT - 1e-6, 0.05, -100.0)]
    for asked, given in (*itertools.product((one, unused), NO_MOMENTS), *past):
        with pytest.raises(TrackerError, match=r"^timestamp: found [^\n]*$"):
            asked.predict(given)
