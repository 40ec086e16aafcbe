import numpy as np
import pytest

from tracker.geometry import so3
from tracker.pose.rivals import turned_about_face


@pytest.mark.parametrize("half", [(0.03, 0.03, 0.03), (0.01, 0.01, 0.04), (0.02, 0.03, 0.04)])
@pytest.mark.parametrize("face", range(3))
def test_turns_about_the_one_face_in_view_look_the_same(half, face):
    half = np.array(half)
    camera = np.zeros(3)
    camera[face] = 0.5
    turned = list(turned_about_face(np.eye(3), np.zeros(3), half, camera))
    others = [half[k] for k in range(3) if k != face]
    assert len(turned) == (3 if others[0] == others[1] else 1)
    for rotation in turned:
        np.testing.assert_allclose(rotation[:, face], np.eye(3)[face], atol=1e-12)
        np.testing.assert_allclose(np.abs(rotation) @ half, half, atol=1e-12)
        assert so3.angle_between(rotation, np.eye(3)) > 1


def test_two_faces_in_view_leave_one_turn_only():
    assert not list(turned_about_face(np.eye(3), np.zeros(3), np.full(3, 0.03), np.array([0.4, 0.3, 0.0])))
