import dataclasses

import numpy as np
import pytest

from tests.helpers.fits import made_fit, with_cameras
from tracker.pose.judge import log_odds, rank, refusal
from tracker.pose.result import Status

NO_EDGES = {"usable": 0.0, "inliers": 0.0, "squares": 0.0}
NOTHING = {"agree": 0, "missing": 410, "extra": 0} | NO_EDGES

REFUSED = {
    "hardly a pixel": (with_cameras(made_fit(), agree=2, missing=408, **NO_EDGES), Status.TOO_FEW_PIXELS),
    "one face of three in another colour": (
        with_cameras(made_fit(), agree=270, wrong=140),
        Status.OTHER_OBJECT,
    ),
    "no edge beside faces": (with_cameras(made_fit(), **NO_EDGES), Status.OTHER_OBJECT),
    "seen elsewhere": (
        with_cameras(with_cameras(made_fit(), elsewhere=2000, **NOTHING), 0, agree=60, missing=350),
        Status.INCONSISTENT_VIEWS,
    ),
    "outside the arena": (dataclasses.replace(made_fit(), inside=False), Status.INCONSISTENT_VIEWS),
    "a few pixels of a face": (
        with_cameras(with_cameras(made_fit(), **NOTHING), 0, agree=60, missing=350),
        Status.POOR_FIT,
    ),
    "no finite covariance": (
        dataclasses.replace(made_fit(), covariance=np.full((6, 6), np.inf)),
        Status.POOR_FIT,
    ),
    "better elsewhere": (dataclasses.replace(made_fit(), lead=-2.0), Status.AMBIGUOUS),
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
        Status.OTHER_OBJECT,
        Status.POOR_FIT,
        Status.AMBIGUOUS,
    }


@pytest.mark.parametrize(
    ("less", "more"),
    [
        ({"wrong": 0}, {"wrong": 50}),
        ({"usable": 40.0}, {"usable": 20.0}),
        ({"squares": 0.5}, {"squares": 36.0}),
        ({"missing": 10, "agree": 400}, {"missing": 370, "agree": 40}),
    ],
)
def test_what_speaks_against_a_fit_makes_it_less_likely(less, more):
    less_likely, likelier = (with_cameras(made_fit(), **fields) for fields in (more, less))
    assert rank(likelier) > rank(less_likely)
    # Where all speaks for the object's colours, what is left is how rare other bodies are.
    assert log_odds(likelier) > log_odds(less_likely) - 1e-3


def test_colours_outside_the_object_speak_against_it():
    fits = [with_cameras(made_fit(), elsewhere=count).evidence.nothing for count in (0, 200, 1000)]
    assert fits == sorted(fits)
