import dataclasses
import math

import numpy as np
import pytest

from tests.helpers.fits import made_fit
from tracker.geometry import so3
from tracker.pose import rivals
from tracker.pose.rivals import lead, turned_about_face

RADIUS = 0.05


def turned(quarters, rank):
    """A fit at a turn by quarters, and how it ranks."""
    rotation = so3.exp(np.array([0.0, 0.0, quarters * math.pi / 2]))
    return dataclasses.replace(made_fit(), rotation=rotation, stands=rank)


@pytest.fixture
def ranked(monkeypatch):
    monkeypatch.setattr(rivals, "rank", lambda fit: fit.stands)


def test_a_lead_is_over_all_other_poses_together(ranked):
    best, *others = fits = [turned(0, 5.0), turned(1, 4.0), turned(2, 4.0), turned(3, 3.0)]
    odds = math.exp(5.0) / sum(math.exp(fit.stands) for fit in others)
    assert lead(best, fits, RADIUS) == pytest.approx(math.log(odds))
    assert lead(best, fits[:2], RADIUS) == pytest.approx(1.0)


def test_the_same_pose_counts_once(ranked):
    fits = [turned(0, 5.0), turned(0, 4.9), turned(1, 4.0), turned(1, 4.0)]
    assert lead(fits[0], fits, RADIUS) == pytest.approx(1.0)
    assert lead(fits[0], fits[:2], RADIUS) == math.inf


@pytest.mark.parametrize("half", [(0.03, 0.03, 0.03), (0.01, 0.01, 0.04), (0.02, 0.03, 0.04)])
@pytest.mark.parametrize("face", range(3))
def test_turns_about_the_one_face_in_view_look_the_same(half, face):
    found = list(turned_about_face(np.eye(3), np.zeros(3), np.array(half), 0.5 * np.eye(3)[face]))
    one, other = np.delete(half, face)
    assert len(found) == (3 if one == other else 1)
    for rotation in found:
        np.testing.assert_allclose(rotation[:, face], np.eye(3)[face], atol=1e-12)
        np.testing.assert_allclose(np.abs(rotation) @ half, half, atol=1e-12)
        assert so3.angle_between(rotation, np.eye(3)) > 1


def test_two_faces_in_view_leave_one_turn_only():
    assert not list(turned_about_face(np.eye(3), np.zeros(3), np.full(3, 0.03), np.array([0.4, 0.3, 0.0])))
