from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.helpers.fits import made_fit
from tracker.pose.judge import EXPECTED, confidence, log_odds, supporters, unanimous, witnesses


def with_camera(fit, c, **fields):
    """The fit with other values of camera c's record."""
    cameras = fit.cameras.copy()
    for name, value in fields.items():
        cameras[name][c] = value
    return dataclasses.replace(fit, cameras=cameras)


def blind(fit, c, elsewhere=0):
    """The fit, of which camera c shows nothing where the object should be."""
    return with_camera(
        fit, c, agree=0, wrong=0, missing=fit.cameras["predicted"][c], extra=0, elsewhere=elsewhere,
        expected=40.0, usable=0.0, inliers=0.0, squares=0.0,
    )  # fmt: skip


def test_cameras_that_show_the_right_faces_support():
    said = witnesses(made_fit())
    assert said.supporting == (True, True, True)
    assert said.contradicting == (False, False, False)
    assert unanimous(made_fit())


def test_a_camera_that_shows_the_object_elsewhere_contradicts_and_one_that_shows_none_cannot_say():
    hidden, elsewhere = blind(made_fit(), 1), blind(made_fit(), 1, elsewhere=300)
    for fit in (hidden, elsewhere):
        assert witnesses(fit).supporting == (True, False, True)
        assert not unanimous(fit)
        assert supporters(fit) == 2
    assert not any(witnesses(hidden).contradicting)
    assert witnesses(elsewhere).contradicting == (False, True, False)
    assert confidence(elsewhere) < confidence(hidden) < confidence(made_fit())


def test_a_pose_that_one_camera_supports_and_two_contradict_is_not_sure():
    fit = blind(blind(made_fit(), 0, elsewhere=300), 2, elsewhere=300)
    assert confidence(fit) < 0.5


def test_a_camera_in_whose_picture_the_object_is_not_has_no_say():
    fit = with_camera(made_fit(), 2, predicted=0, agree=0, wrong=0, missing=0, elsewhere=500, extra=0)
    said = witnesses(fit)
    assert said.supporting == (True, True, False)
    assert not any(said.contradicting)
    assert unanimous(fit)
    few = with_camera(fit, 2, predicted=EXPECTED - 1)
    assert not any(witnesses(few).contradicting)


@pytest.mark.parametrize("c", range(3))
def test_what_cameras_say_does_not_depend_on_their_order(c):
    fit = blind(made_fit(), c, elsewhere=200)
    turned = dataclasses.replace(fit, cameras=np.roll(fit.cameras, 1))
    said, again = witnesses(fit), witnesses(turned)
    assert tuple(np.roll(said.contradicting, 1)) == again.contradicting
    assert tuple(np.roll(said.supporting, 1)) == again.supporting
    assert log_odds(fit) == pytest.approx(log_odds(turned))
