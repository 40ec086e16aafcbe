from __future__ import annotations

import dataclasses
import math

import pytest

from tests.test_belief import made_fit
from tracker.pose.hypotheses.positions import ARENA_BOTTOM
from tracker.pose.judge import possible, rank, refusal
from tracker.pose.result import Status


def rough(fit, rms):
    """A fit whose edges are off by `rms` [px] at the reference focal length."""
    cameras = fit.cameras.copy()
    cameras["squares"] = rms**2 * cameras["inliers"]
    return dataclasses.replace(fit, cameras=cameras)


@pytest.mark.parametrize(("cameras", "status"), [(3, Status.INCONSISTENT_VIEWS), (1, Status.AMBIGUOUS)])
def test_an_object_below_the_table_is_refused(cameras, status):
    fit = made_fit(cameras=cameras)
    assert refusal(fit) is None
    for depth in (0.0, -ARENA_BOTTOM):
        assert possible(dataclasses.replace(fit, lowest=-depth))
    below = dataclasses.replace(fit, lowest=ARENA_BOTTOM - 1e-3)
    assert not possible(below)
    assert refusal(below) is status


def test_pieces_speak_for_a_fit_the_less_the_rougher_they_are():
    ranks = [rank(rough(made_fit(), rms)) for rms in (0.05, 0.1, 0.2, 0.4, 0.8)]
    assert ranks == sorted(ranks, reverse=True)
    for rms in (0.05, 0.3, 1.5):
        fit = rough(made_fit(), rms)
        fewer = fit.cameras.copy()
        for name in ("inliers", "squares"):
            fewer[name] *= 0.7
        assert rank(dataclasses.replace(fit, cameras=fewer)) < rank(fit)


def test_a_rank_is_finite_for_a_fit_without_pieces():
    fit = made_fit()
    cameras = fit.cameras.copy()
    for name in ("expected", "usable", "inliers", "squares", "blur"):
        cameras[name] = 0.0
    assert math.isfinite(rank(dataclasses.replace(fit, cameras=cameras)))
