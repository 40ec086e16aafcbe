import copy
import math
from fractions import Fraction

import numpy as np
import pytest

import tracker
from tests.helpers import random_rotations
from tests.helpers.fits import COVARIANCE, HOME, made_fit
from tracker import Status, TrackerError
from tracker.geometry import so3
from tracker.objects.model import Box
from tracker.tracking.belief import Belief, TrackingOptions

DT = 0.1
ELSEWHERE = np.array([-0.1, 0.05, 0.0325])
X = np.array([1.0, 0.0, 0.0])
BOX = Box.of(tracker.load_object("cube_v2"))


class Track:
    """An object that is followed: what is believed of it now."""

    def __init__(self, **options):
        self.belief = Belief(TrackingOptions(**options))

    def advance(self, timestamp):
        self.belief, expected = self.belief.advance(timestamp)
        return expected

    def see(self, fit, timestamp):
        expected = self.advance(timestamp)
        if fit is None:
            return None
        self.belief, status = self.belief.updated(fit, expected)
        return status

    def estimate(self):
        return self.belief.estimate(BOX, -math.inf)


def follow(track, fits, start=0.0, dt=DT):
    """Statuses of one fit, or None for none, after the other."""
    return [track.see(fit, start + k * dt) for k, fit in enumerate(fits)]


@pytest.fixture
def track():
    """An object that has lain at HOME for a second, up to and including the stamp 1."""
    result = Track()
    assert follow(result, [made_fit()] * 11)[-1] is Status.TRACKING
    return result


@pytest.mark.parametrize("sure", [True, False])
@pytest.mark.parametrize("start", [-5.0, 0.0, 1.7e9])
def test_first_is_found_then_tracked_and_after_a_loss_found_again_anywhere_however_unsure(sure, start):
    one, fit, other = Track(), made_fit(sure=sure), made_fit(ELSEWHERE, sure=sure)
    statuses = follow(one, [fit, fit, fit, *[None] * 4, fit], start)
    assert statuses[:3] == [Status.FOUND, Status.TRACKING, Status.TRACKING]
    assert statuses[-1] is Status.TRACKING
    np.testing.assert_allclose(one.estimate().position, HOME, atol=1e-6)
    assert follow(one, [*[None] * 9, other, other], start + 0.8)[-2:] == [Status.REFOUND, Status.TRACKING]
    np.testing.assert_allclose(one.estimate().position, ELSEWHERE, atol=1e-9)


@pytest.mark.parametrize("coast", [0.0, 0.25, 0.5, 2.0])
def test_coasting_ends_when_its_time_is_over(coast):
    track = Track(coast_seconds=coast)
    follow(track, [made_fit()] * 11)
    # The difference of stamps since the epoch is a little more than what it should be.
    for stamp in (*np.arange(1.05, 1.0 + coast, 0.05), 1.0 + coast + 2.4e-7):
        assert track.advance(stamp) is not None
        assert track.estimate() is not None
    for stamp in (1.0 + coast + 0.01, 5.0, 6.0):
        assert track.advance(stamp) is None
        assert track.estimate() is None
        assert track.belief.seen is None


def test_confidence_falls_and_spread_grows_while_coasting():
    track = Track()
    follow(track, [made_fit(HOME + 0.01 * k * X) for k in range(11)])
    before = track.estimate()
    for stamp in (1.1, 1.2, 1.3, 1.4):
        track.advance(stamp)
        after = track.estimate()
        assert np.linalg.eigvalsh(after.covariance - before.covariance)[0] > 0
        assert after.confidence < before.confidence
        before = after


def test_what_rests_unseen_probably_rests_on_however_many_sets_show_nothing(track):
    before, rarely = track.estimate().confidence, copy.deepcopy(track)
    for stamp in (1.1, 1.2, 1.3, 1.4):
        track.advance(stamp)
        after = track.estimate()
        # A rest of some seconds has probably not ended in these tenths.
        assert after.confidence > (1.0 - 0.6 * (stamp - 1.0)) * before
        np.testing.assert_allclose(after.position, HOME, atol=1e-4)
    rarely.advance(1.4)
    assert rarely.estimate().confidence == pytest.approx(after.confidence, abs=1e-6)


leaps = pytest.mark.parametrize(
    ("position", "rotation"),
    [
        pytest.param(ELSEWHERE, np.eye(3), id="shift"),
        pytest.param(HOME, so3.exp([0.0, 0.0, math.radians(100)]), id="turn"),
        pytest.param(HOME, so3.exp([math.pi, 0.0, 0.0]), id="half turn"),
    ],
)


@leaps
@pytest.mark.parametrize("dt", [0.02, DT])
def test_an_unsure_jump_that_the_next_images_confirm_begins_a_new_motion(track, position, rotation, dt):
    fit = made_fit(position, rotation, sure=False)
    assert track.see(fit, 1.0 + dt) is Status.COASTING
    kept = track.estimate()
    np.testing.assert_allclose(kept.position, HOME, atol=1e-3)
    assert so3.angle_between(kept.rotation, np.eye(3)) < math.radians(1)
    assert follow(track, [fit, fit], start=1.0 + 2 * dt, dt=dt) == [Status.REFOUND, Status.TRACKING]
    np.testing.assert_allclose(track.estimate().position, position, atol=1e-3)
    assert so3.angle_between(track.estimate().rotation, rotation) < math.radians(1)
    assert np.abs(track.estimate().velocity).max() < 0.05


@leaps
def test_a_sure_jump_is_believed_at_once(track, position, rotation):
    assert track.see(made_fit(position, rotation), 1.1) is Status.REFOUND
    np.testing.assert_allclose(track.estimate().position, position, atol=1e-6)
    np.testing.assert_array_equal(track.estimate().velocity, 0)


@pytest.mark.parametrize(
    ("dt", "places"),
    [
        (0.01, [ELSEWHERE, -ELSEWHERE, ELSEWHERE * [1, -1, 1], HOME * [-3, 3, 1]]),
        (DT, [ELSEWHERE, ELSEWHERE * [1, -1, 1]]),
        (DT, [ELSEWHERE, HOME] * 2),
    ],
)
def test_jumps_that_are_taken_back_or_do_not_confirm_each_other_are_not_believed(track, dt, places):
    back = [place is HOME for place in places]
    fits = [made_fit(place, sure=sure) for place, sure in zip(places, back, strict=True)]
    statuses = [Status.TRACKING if sure else Status.COASTING for sure in back]
    assert follow(track, fits, start=1.0 + dt, dt=dt) == statuses
    np.testing.assert_allclose(track.estimate().position, HOME, atol=1e-4)


def test_unbelieved_measurements_do_not_keep_a_track_alive(track):
    for k in range(1, 6):
        place = np.array([0.6 + k, (-1.0) ** k, 0.0])
        assert track.see(made_fit(place, sure=False), 1.0 + k * DT) is Status.COASTING
        assert track.estimate() is not None
    assert track.advance(1.6) is None
    assert track.estimate() is None


def test_what_is_plausible_widens_with_time_and_narrows_for_one_camera(track):
    aside = HOME + 0.08 * X
    expected = track.advance(1.01)
    assert not track.belief.plausible(expected, made_fit(aside))
    assert track.belief.plausible(expected, made_fit(HOME + 0.03 * X))
    assert not track.belief.plausible(expected, made_fit(HOME + 0.03 * X, cameras=1))
    expected = track.advance(1.3)
    assert track.belief.plausible(expected, made_fit(aside))
    assert not track.belief.plausible(expected, made_fit(aside + 0.3 * X))


def test_what_is_plausible_widens_while_neither_the_object_nor_a_jump_is_seen(track):
    jump, aside = (made_fit(place, sure=False) for place in (ELSEWHERE, HOME + 0.2 * X))
    other = copy.copy(track)
    assert follow(track, [jump, *[None] * 3, aside], start=1.1)[-1] is Status.TRACKING
    # Right after a jump, the object is where it was.
    assert follow(other, [jump, aside], start=1.1)[-1] is Status.COASTING


def test_what_one_camera_sees_must_be_sure():
    unsure, sure = made_fit(cameras=1, sure=False), made_fit(cameras=1)
    one, other, third = (Track(min_confidence=0.9) for _ in range(3))
    assert follow(one, [unsure] * 3) == [Status.COASTING] * 3
    assert follow(other, [sure] * 2) == [Status.FOUND, Status.TRACKING]
    assert follow(third, [sure, unsure, sure]) == [Status.FOUND, Status.COASTING, Status.TRACKING]


def passing(steps, velocity, dt=0.04):
    """An object that moved at a velocity [m/s] until it was no longer seen; estimates after each step [s]."""
    one = Track()
    follow(one, [made_fit(HOME + k * dt * np.array(velocity)) for k in range(-10, 1)], -10 * dt, dt)
    estimates, now = [one.estimate()], 0.0
    for step in steps:
        now += step
        one.see(None, now)
        estimates.append(one.estimate())
    return one, now, estimates


def test_a_prediction_for_the_time_of_images_without_the_object_is_the_filtered_pose():
    for steps in ([0.1], [0.04] * 3, [0.3, 0.1]):
        one, now, (*_, estimate) = passing(steps, [0.3, 0.0, 0.0])
        predicted = one.belief.forecast(now, BOX, -math.inf)
        for name in ("position", "orientation", "covariance", "confidence", "velocity"):
            np.testing.assert_allclose(getattr(predicted, name), getattr(estimate, name), atol=1e-12)
        assert estimate.confidence < 0.95 * one.belief.trust


def test_a_forecast_is_as_sure_as_the_object_probably_does_not_begin_to_move_until_then(track):
    trusted = track.belief.trust
    # A rest lasts two seconds on average; one that has just ended leaves the object near.
    for dt in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5):
        forecast = track.belief.forecast(1.0 + dt, BOX, -math.inf)
        assert forecast.confidence == pytest.approx(trusted * math.exp(-dt / 2.0), abs=0.025), dt
        np.testing.assert_allclose(forecast.position, HOME, atol=1e-4)


def test_an_unseen_object_moves_on_ever_slower_as_its_velocity_says():
    for steps in ([0.01] * 40, [0.35, 0.05]):
        _, _, estimates = passing(steps, [0.3, 0.0, 0.0])
        x = np.array([estimate.position[0] for estimate in estimates])
        speed = np.array([estimate.velocity[0] for estimate in estimates])
        assert (np.diff(x) > 0).all()
        if len(steps) > 2:
            mean = (speed[2:] + speed[1:-1]) / 2
            np.testing.assert_allclose(np.diff(x)[1:] / 0.01, mean, rtol=0.3)
            assert (np.diff(speed[1:]) < 0).all()
            assert speed[-1] < 0.6 * speed[0]


def test_an_unseen_object_does_not_fall_through_the_table():
    ground = HOME[2] - BOX.half[2] - 0.02
    one, now, (seen, *estimates) = passing([0.04] * 8, [0.0, 0.0, -0.8])
    assert min(estimate.position[2] for estimate in estimates) < HOME[2] - 0.05
    found = one.belief.estimate(BOX, ground), one.belief.forecast(now, BOX, ground)
    for pose in found:
        assert BOX.lowest(pose.position, pose.rotation) == pytest.approx(ground, abs=1e-9)
    assert one.belief.estimate(BOX, HOME[2]).position[2] == pytest.approx(seen.position[2], abs=1e-3)


@pytest.mark.parametrize("cameras", [2, 3])
@pytest.mark.parametrize("dt", [0.01, DT])
def test_what_more_cameras_see_elsewhere_has_not_moved(dt, cameras):
    track = Track()
    follow(track, [made_fit(HOME + 4e-3 * X, cameras=1, covariance=50 * COVARIANCE)] * 10, dt=dt)
    assert track.see(made_fit(cameras=cameras), 10 * dt) is Status.TRACKING
    assert np.linalg.norm(track.estimate().velocity[:3]) < 2e-3
    assert np.linalg.norm(track.belief.forecast(10 * dt + 0.1, BOX, 0.0).position - HOME) < 1e-3


def test_last_pose_is_the_last_measurement(track):
    rotation = random_rotations(np.random.default_rng(1), 1)[0]
    track.see(made_fit(ELSEWHERE, rotation), 1.1)
    np.testing.assert_array_equal(track.belief.last_pose[0], rotation)
    np.testing.assert_array_equal(track.belief.last_pose[1], ELSEWHERE)
    assert track.see(made_fit(HOME, sure=False), 1.11) is Status.COASTING
    np.testing.assert_array_equal(track.belief.last_pose[1], ELSEWHERE)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("coast_seconds", value) for value in (-1.0, math.nan, math.inf, "1", None, (1.0, 2.0), True)],
        ("min_confidence", 40),
        ("min_confidence", Fraction(3, 2)),
        *[("max_jump", value) for value in (0.04, (0.04,), (0.04, -1.0), (0.04, math.inf), "ab", None)],
        ("min_confidence", 1j),
    ],
)
def test_options_that_are_no_sizes_are_refused(name, value):
    with pytest.raises(TrackerError, match=f"{name}: found .*, expected .* not negative"):
        TrackingOptions(**{name: value})


def test_options_keep_no_list_that_they_are_given():
    listed = list(TrackingOptions().max_jump)
    options = TrackingOptions(max_jump=listed)
    listed[0] = -1.0
    assert options == TrackingOptions()
    assert hash(options) == hash(TrackingOptions())
