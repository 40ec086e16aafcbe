import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.helpers import numerical_jacobian, random_rotations
from tracker.geometry import so3

# From the smallest to half a turn, with both ends sampled on purpose.
ANGLES = [0.0, 1e-300, 1e-12, 1e-9, 1e-8, 1e-5, 0.1, 1.5, 3.0, np.pi - 1e-5, np.pi - 1e-8, np.pi - 1e-12]

vectors = arrays(np.float64, 3, elements=st.floats(-100, 100))


def directions(rng: np.random.Generator) -> np.ndarray:
    axes = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(40, 3))])
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


@given(vectors, vectors)
def test_hat_is_the_cross_product_and_exp_a_rotation(a, b):
    np.testing.assert_allclose(so3.hat(a) @ b, np.cross(a, b), atol=1e-10)
    rotation = so3.exp(a)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0


@pytest.mark.parametrize("angle", ANGLES)
def test_logarithms_quaternions_and_angles_are_those_of_the_rotations_at_every_angle(angle, rng):
    rotvec = angle * directions(rng).reshape(2, 23, 3)
    rotations = so3.exp(rotvec)
    np.testing.assert_allclose(so3.log(rotations), rotvec, rtol=1e-12, atol=1e-14)
    quaternions = so3.quaternion_from_matrix(rotations)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=-1), 1, rtol=1e-14)
    np.testing.assert_allclose(so3.matrix_from_quaternion(quaternions), rotations, atol=1e-13)
    for index in np.ndindex(2, 23):
        np.testing.assert_allclose(so3.quaternion(rotations[index]), quaternions[index], atol=1e-15)
    first, one = random_rotations(rng, 46).reshape(2, 23, 3, 3), random_rotations(rng, 1)[0]
    for other in (first, one):
        np.testing.assert_allclose(so3.angle_between(other, rotations @ other), angle, rtol=1e-9, atol=3e-15)


def test_exp_inverts_log_of_exact_half_turns_whose_quaternion_may_have_either_sign(rng):
    axis = directions(rng)
    half_turns = 2 * axis[:, :, None] * axis[:, None, :] - np.eye(3)
    np.testing.assert_allclose(np.linalg.norm(so3.log(half_turns), axis=-1), np.pi, rtol=1e-14)
    np.testing.assert_allclose(so3.exp(so3.log(half_turns)), half_turns, atol=1e-13)
    for one, expected in zip(half_turns, so3.quaternion_from_matrix(half_turns), strict=True):
        found = so3.quaternion(one)
        assert found[3] >= 0
        np.testing.assert_allclose(found * np.sign(found @ expected), expected, atol=1e-15)
        assert np.linalg.norm(so3.log(one)) == pytest.approx(np.pi)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 1.0, 3.1])
def test_left_jacobian_is_the_derivative_of_the_turn_that_follows(angle, rng):
    turn = angle * random_rotations(rng, 1)[0, 0]
    jacobian = numerical_jacobian(lambda v: so3.log(so3.exp(v) @ so3.exp(turn).T), turn)
    np.testing.assert_allclose(so3.left_jacobian(turn), jacobian, atol=1e-8)


def test_quaternions_have_a_canonical_sign_and_multiply_in_the_order_of_xyzw(rng):
    q = rng.normal(size=(200, 4))
    back = so3.quaternion_from_matrix(so3.matrix_from_quaternion(q))
    assert (back[:, 3] >= 0).all()
    expected = q / np.linalg.norm(q, axis=1, keepdims=True) * np.sign(q[:, 3:])
    np.testing.assert_allclose(back, expected, atol=1e-13)
    half_turn_about_y = so3.quaternion_from_matrix(np.diag([-1.0, 1.0, -1.0]))
    np.testing.assert_array_equal(half_turn_about_y, [0, 1, 0, 0])
    quarter_about_z = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    np.testing.assert_allclose(so3.matrix_from_quaternion(quarter_about_z) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_nearest_rotation_mends_noise_keeps_rotations_and_is_nearer_than_any_other(rng):
    rotations = random_rotations(rng, 50)
    np.testing.assert_allclose(so3.nearest_rotation(rotations), rotations, atol=1e-14)
    noisy = rotations + 1e-4 * rng.normal(size=rotations.shape)
    assert so3.angle_between(so3.nearest_rotation(noisy), rotations).max() < 1e-3
    mirrored = so3.nearest_rotation(rotations * [1, 1, -1])
    np.testing.assert_allclose(np.linalg.det(mirrored), 1, rtol=1e-12)
    matrix = rng.normal(size=(3, 3))
    distance = np.linalg.norm(so3.nearest_rotation(matrix) - matrix)
    others = np.linalg.norm(random_rotations(rng, 2000) - matrix, axis=(1, 2))
    assert distance <= others.min()


def compiled_log(rotation):
    out = np.empty(3)
    so3.log_into(np.ascontiguousarray(rotation), out)
    return out


@given(st.floats(0, np.pi - 1e-7), st.integers(0, 2**31))
@example(np.pi - 1e-7, 0)
@example(1e-300, 0)
@example(0.999e-6, 0)
@example(1.001e-6, 0)
@example(0.999e-4, 0)
@example(1.001e-4, 0)
def test_exp_and_log_of_one_are_inverse_and_those_of_a_stack_to_the_digits_of_small_turns(angle, seed):
    axis = np.random.default_rng(seed).normal(size=3)
    vector = angle * axis / np.linalg.norm(axis)
    small, other = angle < 1e-2, so3.exp(vector[None])[0]  # that of a stack, which is not compiled
    other.flags.writeable = False
    compiled = np.empty((3, 3))
    so3.exp_into(vector, compiled)
    for rotation in (so3.exp(vector), compiled):
        np.testing.assert_allclose(rotation, other, rtol=1e-15 * small, atol=1e-16 if small else 1e-15)
        for found in (compiled_log(rotation), compiled_log(other), so3.log(rotation), -so3.log(other.T)):
            np.testing.assert_allclose(found, vector, rtol=1e-11, atol=1e-18 if small else 1e-11)
