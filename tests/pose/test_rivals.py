import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tracker.geometry import so3
from tracker.pose.rivals import MOST, reversed_in_depth, turned_about_face

CAMERA = np.array([0.1, -0.3, 0.6])
POSITION = np.array([0.05, 0.02, 0.03])
HALF = np.array([0.01, 0.04, 0.01])
SIGHT = (CAMERA - POSITION) / np.linalg.norm(CAMERA - POSITION)


def rivals(rotation: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(reversed_in_depth(rotation, POSITION, HALF, CAMERA))


def facing(degrees: float) -> np.ndarray:
    """A rotation whose z axis points so far away from the line of sight."""
    across = np.cross(SIGHT, [0.3, 0.8, -0.1])
    across /= np.linalg.norm(across)
    basis = np.column_stack([across, np.cross(SIGHT, across), SIGHT])
    return so3.exp(np.radians(degrees) * across) @ basis @ so3.exp(np.array([0.0, 0.0, 0.7]))


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_rivals_are_rotations_that_show_the_same_outline_from_afar(vector):
    rotation = so3.exp(np.array(vector))
    plane = np.eye(3) - np.outer(SIGHT, SIGHT)
    for turned, _ in rivals(rotation):
        np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(turned) > 0
        assert np.degrees(so3.angle_between(turned, rotation)) > 1.9
        # One axis looks as long as before, and lies in the same direction or the opposite one.
        before, after = plane @ rotation, plane @ turned
        same = [
            min(np.abs(before[:, k] - after[:, k]).max(), np.abs(before[:, k] + after[:, k]).max())
            for k in range(3)
        ]
        assert min(same) < 1e-6


def test_a_face_that_is_turned_away_turns_to_the_other_side_about_its_middle():
    rotation = facing(10.0)
    middle = POSITION + HALF[2] * rotation[:, 2]
    mirrored = 2 * np.cos(np.radians(10)) * SIGHT - rotation[:, 2]
    (turned, moved), *others = [one for one in rivals(rotation) if np.allclose(one[0][:, 2], mirrored)]
    assert not others
    assert np.degrees(so3.angle_between(turned, rotation)) == pytest.approx(20.0)
    np.testing.assert_allclose(moved + HALF[2] * turned[:, 2], middle, atol=1e-12)


@pytest.mark.parametrize("degrees", [0.5, np.degrees(MOST) + 1, 45.0, 53.0])
def test_what_is_the_same_from_the_other_side_or_looks_different_is_no_rival(degrees):
    rotation = facing(degrees)
    mirrored = 2 * np.cos(np.radians(degrees)) * SIGHT - rotation[:, 2]
    assert not any(np.allclose(turned[:, 2], mirrored) for turned, _ in rivals(rotation))


@pytest.mark.parametrize("half", [(0.03, 0.03, 0.03), (0.01, 0.01, 0.04), (0.02, 0.03, 0.04)])
@pytest.mark.parametrize("face", range(3))
def test_turns_about_the_one_face_in_view_look_the_same(half, face):
    half = np.array(half)
    camera = np.zeros(3)
    camera[face] = 0.5
    turned = list(turned_about_face(np.eye(3), np.zeros(3), half, camera))
    others = [half[k] for k in range(3) if k != face]
    assert len(turned) == (3 if others[0] == others[1] else 1)
    for rotation, position in turned:
        np.testing.assert_allclose(rotation[:, face], np.eye(3)[face], atol=1e-12)
        np.testing.assert_allclose(np.abs(rotation) @ half, half, atol=1e-12)
        np.testing.assert_array_equal(position, 0)
        assert so3.angle_between(rotation, np.eye(3)) > 1


def test_two_faces_in_view_leave_one_turn_only():
    assert not list(turned_about_face(np.eye(3), np.zeros(3), np.full(3, 0.03), np.array([0.4, 0.3, 0.0])))
