"""Each reason for which a fit is no pose, in a fit that is right but for one thing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.helpers.fits import made_fit
from tracker.pose.judge import MIN_LEAD, features, log_odds, refusal
from tracker.pose.result import Status


def fit_with(**seen):
    """A good fit, but every camera saw this of it."""
    fit = made_fit()
    cameras = fit.cameras.copy()
    for name, value in seen.items():
        cameras[name] = value
    return dataclasses.replace(fit, cameras=cameras)


REFUSED = {
    "hardly a pixel": (fit_with(agree=9), Status.TOO_FEW_PIXELS),
    "a small part of what it predicts": (fit_with(agree=55), Status.TOO_FEW_PIXELS),
    "as many pixels of other colours": (fit_with(wrong=410), Status.INCONSISTENT_VIEWS),
    "pixels of its colours all around": (fit_with(extra=210), Status.INCONSISTENT_VIEWS),
    "outside the arena": (dataclasses.replace(made_fit(), inside=False), Status.INCONSISTENT_VIEWS),
    "no edge": (fit_with(inliers=1.5), Status.POOR_FIT),
    "no finite covariance": (
        dataclasses.replace(made_fit(), covariance=np.full((6, 6), np.inf)),
        Status.POOR_FIT,
    ),
    "edges elsewhere": (fit_with(usable=8.0, inliers=2.0, squares=9.0), Status.POOR_FIT),
    "as good elsewhere": (dataclasses.replace(made_fit(), lead=0.9 * MIN_LEAD), Status.AMBIGUOUS),
    "anywhere": (dataclasses.replace(made_fit(), covariance=np.diag([1e-2] * 6)), Status.AMBIGUOUS),
}


def test_a_good_fit_is_accepted():
    assert refusal(made_fit()) is None


@pytest.mark.parametrize(("fit", "status"), REFUSED.values(), ids=REFUSED)
def test_a_fit_is_refused_for_what_is_wrong_with_it(fit, status):
    assert refusal(fit) is status


def test_every_refusal_is_in_the_table():
    assert {status for _, status in REFUSED.values()} == {
        Status.TOO_FEW_PIXELS,
        Status.INCONSISTENT_VIEWS,
        Status.POOR_FIT,
        Status.AMBIGUOUS,
    }


@pytest.mark.parametrize(
    ("name", "less", "more"),
    [
        ("wrong", {"wrong": 0}, {"wrong": 100}),
        ("extra", {"extra": 0}, {"extra": 100}),
        ("unusable", {"usable": 40, "inliers": 20}, {"usable": 20, "inliers": 10}),
        ("outliers", {"inliers": 38}, {"inliers": 10}),
        ("rms", {"squares": 1.0}, {"squares": 36.0}),
    ],
)
def test_what_speaks_against_a_fit_makes_it_less_likely(name, less, more):
    better, worse = fit_with(**less), fit_with(**more)
    assert features(better)[name] < features(worse)[name]
    assert log_odds(better) > log_odds(worse)
