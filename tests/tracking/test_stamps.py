import numpy as np
import pytest

from tests.helpers.pushed_cube import DT, HEIGHT, image_of, new, off, play, within
from tracker import Status, TrackerError
from tracker.geometry import so3
from tracker.inputs import check_stamps
from tracker.tracking.follow import Gate

DELAYS = np.array([0.03, 0.015, 0.0])
STEP = 0.04
NAMES = ("left", "middle", "right")


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


@pytest.mark.parametrize(
    ("given", "shown", "latest", "delays"),
    [
        (1.5, [True, False, True], 1.5, [0.0] * 3),
        (np.float32(2.0), [False] * 3, 2.0, [0.0] * 3),
        ([1.0, 1.5, 1.25], [True] * 3, 1.5, [0.5, 0.0, 0.25]),
        ({"right": 1.25, "left": 1.0, "middle": 1.5}, [True] * 3, 1.5, [0.5, 0.0, 0.25]),
        *(
            ([1.0, none, 1.25], [True, False, True], 1.25, [0.25, 0.0, 0.0])
            for none in (np.nan, np.inf, -np.inf, 7.0, -7.0)
        ),
    ],
)
def test_the_latest_picture_counts_others_are_older_and_those_without_do_not_count(
    given, shown, latest, delays
):
    last, older = check_stamps(given, shown, NAMES)
    assert last == latest
    np.testing.assert_allclose(older, delays)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("now", "'now', expected finite numbers of seconds"),
        ("1.5", "'1.5', expected finite numbers of seconds"),
        (None, "expected"),
        (True, "expected"),
        (1j, "expected"),
        (10**400, "a whole number above 10.18, expected finite"),
        ([10**400, 1.0, 1.0], "expected finite"),
        ((10**5000,) * 3, "found a tuple, expected finite"),
        (np.datetime64("2026-05-04T03:02:01", "ns"), "datetime64.*astype"),
        (np.timedelta64(3, "s"), "expected finite"),
        (1_770_000_000_000_000_000, "nanoseconds"),
        ([1.77e18, 1.77e18, 1.77e18], "nanoseconds"),
        (1.77e12, "nanoseconds"),
        ([1.0, 2.0], "2 stamps, expected one, or one for each of 3"),
        ([[1.0, 2.0, 3.0]], r"shape \(1, 3\)"),
        ([1.0, np.nan, 3.0], "finite"),
        ([1.0, [2.0], 3.0], "expected finite numbers of seconds"),
        ({"camera60": 1.0, "camera180": 1.0, "top": 1.0}, "unknown 'top'; missing camera300"),
        ({"camera60": 1.0, "camera180": 1.0}, r"missing camera300; .*\(nan where a camera gave none\)$"),
    ],
)
def test_wrong_stamps_are_named(rig, short, given, says):
    with pytest.raises(TrackerError, match=says):
        new(rig).update(short[0], given)


@pytest.mark.parametrize(
    "given", ["x", None, np.nan, np.inf, -np.inf, 10**400, 1.77e18, np.datetime64("now"), [1.0], {}]
)
def test_moments_that_are_none_are_not_predicted(rig, given):
    with pytest.raises(TrackerError, match="timestamp: found"):
        new(rig).predict(given)


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


@pytest.mark.parametrize("stamp", [np.nan, np.inf, -np.inf, DT - 1e-6, 0.05, -100.0])
def test_a_moment_that_is_past_or_none_is_not_predicted(rig, short, stamp):
    one = new(rig)
    play(one, short[:2])
    with pytest.raises(TrackerError, match=r"^[^\n]*timestamp[^\n]*$"):
        one.predict(stamp)


def test_a_gate_opens_again_after_an_error():
    gate = Gate()
    with pytest.raises(ValueError, match="inside"), gate:
        raise ValueError("inside")
    with gate:
        pass
