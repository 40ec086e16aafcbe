import dataclasses

import numpy as np
import pytest

from tests.helpers.fits import made_fit, with_cameras
from tracker.pose.judge import EXPECTED, confidence, contradicting, log_odds, supporters, unanimous


def blind(fit, c, elsewhere=0):
    """The fit, of which camera c shows nothing where the object should be."""
    return with_cameras(
        fit, c, agree=0, wrong=0, missing=fit.cameras["predicted"][c], extra=0, elsewhere=elsewhere,
        expected=40.0, usable=0.0, inliers=0.0, squares=0.0,
    )  # fmt: skip


def test_cameras_that_show_the_right_faces_support():
    assert contradicting(made_fit()) == (False, False, False)
    assert unanimous(made_fit())


def test_a_camera_that_shows_the_object_elsewhere_contradicts_and_one_that_shows_none_cannot_say():
    hidden, elsewhere = blind(made_fit(), 1), blind(made_fit(), 1, elsewhere=300)
    for fit in (hidden, elsewhere):
        assert (fit.cameras["shows"] > 0.5).tolist() == [True, False, True]
        assert not unanimous(fit)
        assert supporters(fit) == 2
    assert not any(contradicting(hidden))
    assert contradicting(elsewhere) == (False, True, False)
    assert confidence(elsewhere) < confidence(hidden) < confidence(made_fit())


def test_a_camera_that_shows_another_thing_there_is_broken_and_does_not_spoil_the_pose():
    fit = with_cameras(made_fit(), 2, agree=0, wrong=400, usable=0.0, inliers=0.0, squares=0.0)
    assert fit.cameras["broken"][2] > 0.5
    assert contradicting(fit) == (False, False, True)
    assert supporters(fit) == 2
    assert 0.2 < confidence(fit) < confidence(made_fit())


def test_a_pose_that_one_camera_supports_and_two_contradict_is_not_sure():
    fit = blind(blind(made_fit(), 0, elsewhere=300), 2, elsewhere=300)
    assert confidence(fit) < 0.5
    assert confidence(fit) < 0.8 * confidence(blind(blind(made_fit(), 0), 2))


def test_a_camera_in_whose_picture_the_object_is_not_has_no_say():
    fit = with_cameras(made_fit(), 2, predicted=0, agree=0, wrong=0, missing=0, elsewhere=500, extra=0)
    assert (fit.cameras["shows"] > 0.5).tolist() == [True, True, False]
    assert not any(contradicting(fit))
    assert unanimous(fit)
    assert not any(contradicting(with_cameras(fit, 2, predicted=EXPECTED - 1)))


@pytest.mark.parametrize("c", range(3))
def test_what_cameras_say_does_not_depend_on_their_order(c):
    fit = blind(made_fit(), c, elsewhere=200)
    turned = with_cameras(dataclasses.replace(fit, cameras=np.roll(fit.cameras, 1)))
    assert tuple(np.roll(contradicting(fit), 1)) == contradicting(turned)
    np.testing.assert_allclose(np.roll(fit.cameras["shows"], 1), turned.cameras["shows"])
    assert log_odds(fit) == pytest.approx(log_odds(turned))
