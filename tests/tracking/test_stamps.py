"""Pictures that are not taken at once, poses of a later moment, and one caller at a time."""

from __future__ import annotations

import copy
import pickle
import threading

import numpy as np
import pytest

import tracker
from tests.helpers.pushed_cube import DT, HEIGHT, MODEL, bits, image_of, new, off, play, pose_at, within
from tracker.errors import TrackerError
from tracker.geometry import so3
from tracker.pipeline import Status
from tracker.tracking.belief import TrackingOptions
from tracker.tracking.gate import Gate
from tracker.tracking.stamps import check_stamps

DELAYS = np.array([0.03, 0.015, 0.0])
STEP = 0.04


@pytest.fixture(scope="module")
def film(film):
    return film[:8]


def gliding(seconds, speed):
    """A pose on a straight way [m/s], turned at 3 rad for each metre."""
    place = np.array([-0.1, -0.05, HEIGHT]) + seconds * speed * np.array([0.96, 0.28, 0.0])
    return place, so3.exp([0.0, 0.0, 0.4 + 3.0 * speed * seconds])


def one_after_another(rig, speed, count):
    """Images of a gliding cube, and their cameras' stamps."""
    for k in range(count):
        stamps = STEP * k - DELAYS
        taken = [image_of(rig, c, gliding(stamps[c], speed), 10 * k) for c in range(3)]
        yield taken, stamps


def test_one_stamp_is_that_of_all():
    assert check_stamps(1.5, [True, False]).latest == 1.5
    assert not check_stamps(1.5, [True, False]).delays.any()
    assert check_stamps(np.float32(2.0), [False, False]).latest == 2.0


def test_the_latest_picture_counts_and_others_are_older():
    stamps = check_stamps([1.0, 1.5, 1.25], [True, True, True])
    assert stamps.latest == 1.5
    np.testing.assert_allclose(stamps.delays, [0.5, 0.0, 0.25])


@pytest.mark.parametrize("strange", [np.nan, np.inf, -np.inf, 7.0, -7.0])
def test_stamps_of_cameras_without_a_picture_do_not_count(strange):
    stamps = check_stamps([1.0, strange, 1.25], [True, False, True])
    assert stamps.latest == 1.25
    np.testing.assert_allclose(stamps.delays, [0.25, 0.0, 0.0])


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("now", "'now', expected seconds"),
        (None, "expected"),
        ([1.0, 2.0], "2 stamps, expected one, or one for each of 3"),
        ([[1.0, 2.0, 3.0]], r"shape \(1, 3\)"),
        ([1.0, np.nan, 3.0], "finite"),
        ([1.0, [2.0], 3.0], "expected seconds"),
    ],
)
def test_wrong_stamps_are_named_and_change_nothing(rig, film, given, says):
    one, other = new(rig), new(rig)
    for k in range(2):
        with pytest.raises(TrackerError, match=says):
            one.update(film[k], given)
        assert bits(one.update(film[k], DT * k)) == bits(other.update(film[k], DT * k))


def test_equal_stamps_of_all_cameras_are_one_stamp(rig, film):
    one, other = new(rig), new(rig)
    for k in range(4):
        assert bits(one.update(film[k], [DT * k] * 3)) == bits(other.update(film[k], DT * k))


@pytest.mark.parametrize("speed", [0.1, 0.5, 1.0])
def test_what_is_seen_late_is_moved_by_the_velocity(rig, speed):
    one = new(rig)
    for k, (images, stamps) in enumerate(one_after_another(rig, speed, 6)):
        answer = one.update(images, stamps)
        assert answer.object_pose is not None, k
        if k < 2:
            # The velocity is not known yet.
            continue
        assert answer.status is Status.TRACKING, k
        assert within(answer.object_pose, gliding(STEP * k, speed), 0.5, 0.5), k
        assert within(answer.filtered_object_pose, gliding(STEP * k, speed), 0.5, 0.5), k
        assert answer.object_pose.confidence > 0.95, k
    # With one stamp for all, the same pictures are explained by no pose so well.
    naive, errors = new(rig), []
    for k, (images, stamps) in enumerate(one_after_another(rig, speed, 6)):
        pose = naive.update(images, float(stamps.max())).object_pose
        errors += [] if pose is None else [off(pose, gliding(STEP * k, speed))[0]]
    assert np.median(errors) > 5 * speed


def test_a_later_pose_is_predicted_and_nothing_changes(rig, film):
    one, other = new(rig), new(rig)
    for k in range(8):
        answer = one.update(film[k], DT * k)
        assert bits(answer) == bits(other.update(film[k], DT * k))
        now, later = one.predict(DT * k), one.predict(DT * k + 0.05)
        np.testing.assert_allclose(now.position, answer.filtered_object_pose.position, atol=1e-9)
        np.testing.assert_allclose(now.covariance, answer.filtered_object_pose.covariance, atol=1e-9)
        assert np.trace(later.covariance[:3, :3]) > np.trace(now.covariance[:3, :3])
        assert later.confidence <= now.confidence
    # Pushed since image 4.
    assert within(one.predict(0.75), pose_at(0.75), 2.0, 2.0)
    assert np.linalg.norm(one.predict(0.75).position - one.predict(DT * 7).position) > 3e-3


def test_nothing_is_predicted_of_what_is_lost(rig, film):
    one = tracker.ObjectTracker(MODEL, rig, tracking=TrackingOptions(coast_seconds=0.3))
    assert one.predict(0.0) is None
    play(one, film[:2])
    assert one.predict(DT + 0.29) is not None
    assert one.predict(DT + 0.31) is None
    assert one.predict(DT + 0.29) is not None
    one.update([None] * 3, 0.5)
    assert one.predict(0.5) is None


@pytest.mark.parametrize("stamp", [np.nan, np.inf, -np.inf, DT - 1e-6, 0.05, -100.0])
def test_a_moment_that_is_past_or_none_is_not_predicted(rig, film, stamp):
    one = new(rig)
    play(one, film[:2])
    with pytest.raises(TrackerError, match=r"^[^\n]*timestamp[^\n]*$"):
        one.predict(stamp)
    if not np.isfinite(stamp):
        with pytest.raises(TrackerError, match="timestamp"):
            new(rig).predict(stamp)


def test_a_second_caller_is_told_so_and_does_not_wait(rig, film):
    one, other = new(rig), new(rig)
    with one._gate:
        for call in (lambda: one.update(film[0], 0.0), one.reset):
            with pytest.raises(TrackerError, match="one caller at a time"):
                call()
        # What remembers nothing may be asked.
        assert bits(one.detect(film[0])) == bits(other.detect(film[0]))
        assert one.predict(0.0) is None
    assert bits(one.update(film[0], 0.0)) == bits(other.update(film[0], 0.0))


def test_a_gate_opens_again_after_an_error():
    gate = Gate()
    with pytest.raises(ValueError, match="inside"), gate:
        raise ValueError("inside")
    with gate:
        pass


def test_of_many_threads_one_is_let_in():
    gate, inside, refused = Gate(), threading.Barrier(2), []
    leave = threading.Event()

    def hold():
        with gate:
            inside.wait(10)
            leave.wait(10)

    holder = threading.Thread(target=hold)
    holder.start()
    inside.wait(10)
    for _ in range(5):
        with pytest.raises(TrackerError):
            gate.__enter__()
        refused.append(True)
    leave.set()
    holder.join(10)
    assert len(refused) == 5
    with gate:
        pass


def test_a_copy_of_a_tracker_goes_on_from_the_same_memory(rig, film):
    one = new(rig)
    play(one, film[:3])
    with one._gate:
        copies = [copy.deepcopy(one), pickle.loads(pickle.dumps(one))]
    expected = bits(one.update(film[3], 0.3))
    for other in copies:
        assert bits(other.update(film[3], 0.3)) == expected


@pytest.mark.parametrize(("stage", "count"), [("estimate", 0), ("refine", 0), ("follow", 1), ("refine", 3)])
def test_an_error_within_leaves_everything_as_it_was(rig, film, monkeypatch, stage, count):
    one, other = new(rig), new(rig)
    play(one, film[:count])
    play(other, film[:count])

    def broken(*_, **__):
        raise MemoryError("full")

    with monkeypatch.context() as patch:
        patch.setattr(one._estimator, stage, broken)
        for _ in range(2):
            with pytest.raises(MemoryError):
                one.update(film[-1], DT * count + 0.05)
    for k in range(count, count + 2):
        assert bits(one.update(film[k], DT * k)) == bits(other.update(film[k], DT * k))
