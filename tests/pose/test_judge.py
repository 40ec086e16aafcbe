import dataclasses
import math

import numpy as np
import pytest

from tests.helpers.fits import made_fit, with_cameras
from tracker import Arena, Status
from tracker.pose.judge import (
    MIN_VIEW,
    SINGLE,
    SURE,
    alone,
    confidence,
    nearness,
    probably_near,
    rank,
    refusal,
    settled,
    trust,
)


def rough(fit, rms):
    """A fit whose edges are off by `rms` [px] at the reference focal length."""
    return with_cameras(fit, squares=rms**2 * fit.cameras["inliers"])


@pytest.mark.parametrize(("cameras", "status"), [(3, Status.INCONSISTENT_VIEWS), (1, Status.AMBIGUOUS)])
def test_an_object_below_the_table_is_refused(cameras, status):
    fit = made_fit(cameras=cameras)
    assert refusal(fit) is None
    arena = Arena()
    for lowest in (0.0, arena.lowest):
        assert refusal(dataclasses.replace(fit, inside=arena.holds(fit.position, lowest))) is None
    below = dataclasses.replace(fit, inside=arena.holds(fit.position, arena.lowest - 1e-3))
    assert refusal(below) is status


def test_pieces_speak_for_a_fit_the_less_the_rougher_they_are():
    ranks = [rank(rough(made_fit(), rms)) for rms in (0.1, 0.2, 0.4, 0.8)]
    assert ranks == sorted(set(ranks), reverse=True)
    for rms in (0.05, 0.3):
        fit = rough(made_fit(), rms)
        seen = fit.cameras
        fewer = with_cameras(fit, inliers=0.7 * seen["inliers"], squares=0.7 * seen["squares"])
        assert rank(fewer) < rank(fit)


def test_what_noise_explains_does_not_speak_against_the_object():
    fit = rough(made_fit(), 0.8)
    noisy = [with_cameras(fit, noise=share * fit.cameras["squares"]) for share in (0.0, 0.5, 1.0, 2.0)]
    trusted = [trust(one) for one in noisy]
    assert trusted == sorted(trusted)
    assert trusted[0] < trusted[1] < trusted[2]
    assert len({rank(one) for one in noisy}) == 1


def test_a_rank_is_finite_for_a_fit_without_pieces():
    none = dict.fromkeys(("expected", "usable", "inliers", "squares", "blur"), 0.0)
    assert math.isfinite(rank(with_cameras(made_fit(), **none)))


def test_poses_far_from_the_arena_are_refused():
    arena, fit = Arena(), made_fit()
    for place in ([0.3, 0.0, 0.03], [0.0, -0.26, 0.03], [0.0, 0.0, 0.25]):
        beyond = dataclasses.replace(fit, inside=arena.holds(np.array(place), 0.0))
        assert refusal(beyond) is Status.INCONSISTENT_VIEWS
        assert not settled(beyond)


def test_a_clear_fit_is_sure_and_settled_and_one_camera_settles_nothing():
    fit, one = made_fit(), made_fit(cameras=1)
    assert trust(fit) > SURE
    assert settled(fit)
    assert trust(one) > 0.95
    assert alone(one)
    assert not settled(one)
    for doubtful in (made_fit(sure=False), dataclasses.replace(fit, converged=False)):
        assert not settled(doubtful)


def test_a_camera_counts_from_some_weight_of_pieces_on():
    fit = made_fit()
    for weight, expected in ((MIN_VIEW, False), (0.99 * MIN_VIEW, True), (0.0, True)):
        cameras = fit.cameras.copy()
        cameras["inliers"][1:] = 0.0, weight
        assert alone(dataclasses.replace(fit, cameras=cameras)) is expected


def test_confidence_is_trust_times_accuracy_and_a_rival_halves_it_at_most():
    fit = made_fit()
    assert confidence(fit) == pytest.approx(trust(fit) * nearness(fit.covariance, False))
    assert trust(dataclasses.replace(fit, lead=0.0)) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("odds", [1e3, 1e5])
def test_whatever_speaks_against_a_fit_leaves_a_number(odds):
    fit = made_fit()
    for field in ("body", "nothing", "resized"):
        other = dataclasses.replace(fit, evidence=fit.evidence._replace(**{field: odds}))
        assert trust(other) < 1e-200
        assert refusal(other) is not None
    assert trust(dataclasses.replace(fit, lead=-odds)) < 1e-200


@pytest.mark.parametrize("single", [False, True])
def test_a_pose_that_is_stated_to_be_nearer_is_nearer(single):
    spreads = [np.diag(np.repeat(np.square([shift, 0.02]), 3)) for shift in (3e-4, 1e-3, 2e-3, 4e-3, 0.1)]
    found = [nearness(spread, single) for spread in spreads]
    assert found == sorted(found, reverse=True)
    assert found[0] > 0.99
    assert found[-1] < 0.01
    assert nearness(np.full((6, 6), np.nan), single) == 0.0


def test_odds_of_being_near_are_as_stated_and_greater_for_a_single_camera():
    covariance = np.diag(np.repeat(np.square([2e-3, 0.02]), 3))
    near, single = nearness(covariance, False), nearness(covariance, True)
    assert near == pytest.approx(probably_near(covariance))
    assert single / (1.0 - single) == pytest.approx(SINGLE * near / (1.0 - near))
