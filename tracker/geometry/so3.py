"""Rotations: matrices, rotation vectors and quaternions (x, y, z, w); and transforms made of them.

Functions of rotations work on one element or on a stack: leading axes broadcast. They do not check their
input: matrices must be rotations, quaternions non-zero.

The last three are compiled and take a single element, for use in compiled loops.
"""

import math

import numpy as np
import numpy.typing as npt

from tracker.compiled import compiled
from tracker.conventions import FloatArray


def hat(vector: npt.ArrayLike) -> FloatArray:
    """Return skew-symmetric matrices (..., 3, 3) of vectors a (..., 3): their product with b is a × b."""
    v = np.asarray(vector, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp(rotvec: npt.ArrayLike) -> FloatArray:
    """Return matrices (..., 3, 3) of rotation vectors (..., 3) [rad]; exact to rounding at any angle."""
    v = np.asarray(rotvec, dtype=np.float64)
    if v.ndim == 1:  # NumPy takes ten times as long
        one = np.empty((3, 3))
        exp_into.py_func(v.tolist(), one)
        return one
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    # sin θ/θ and (1 - cos θ)/θ² = ½ (sin(θ/2)/(θ/2))²: no division by zero, no cancellation near it.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    skew = hat(v)
    return np.asarray(np.eye(3) + first * skew + second * (skew @ skew))


def left_jacobian(rotvec: npt.ArrayLike) -> FloatArray:
    """(3, 3) J with exp(ω + δ) = exp(J δ) exp(ω) for small δ, for a rotation vector ω (3,) [rad]."""
    cross, angle = hat(rotvec), float(np.linalg.norm(rotvec))
    if angle < 1e-4:  # both quotients below cancel
        return np.asarray(np.eye(3) + cross / 2.0 + cross @ cross / 6.0)
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def log(rotation: npt.ArrayLike) -> FloatArray:
    """Return rotation vectors (..., 3) [rad], of length at most π, of rotation matrices (..., 3, 3).

    Accurate at every angle, even near 0 and π, where formulas based on the trace lose half the digits.
    """
    if np.ndim(rotation) == 2:
        one = np.empty(3)
        log_into.py_func(np.array(rotation, dtype=np.float64, order="C"), one)
        return one
    q = quaternion_from_matrix(rotation)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    cosine = q[..., 3:]
    tiny = sine < 1e-9
    # θ/sin(θ/2) tends to 2 for vanishing angles.
    factor = np.where(tiny, 2.0, 2 * np.arctan2(sine, cosine) / np.where(tiny, 1.0, sine))
    return factor * q[..., :3]


def matrix_from_quaternion(xyzw: npt.ArrayLike) -> FloatArray:
    """Return rotation matrices (..., 3, 3) of quaternions (..., 4), which need not be normalised."""
    q = np.asarray(xyzw, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    skew = hat(q[..., :3])
    return np.asarray(np.eye(3) + 2 * q[..., 3, None, None] * skew + 2 * (skew @ skew))


def quaternion_from_matrix(rotation: npt.ArrayLike) -> FloatArray:
    """Return unit quaternions (..., 4) xyzw of rotation matrices (..., 3, 3).

    The sign is canonical: w ≥ 0; for half turns (w = 0) the largest component is positive.
    """
    r = np.asarray(rotation, dtype=np.float64)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    # Row k is 4 q_k · (x, y, z, w); the row of the largest component never cancels (Shepperd 1978).
    products = np.empty((*r.shape[:-2], 4, 4))
    products[..., 0, 0] = 1 + xx - yy - zz
    products[..., 1, 1] = 1 - xx + yy - zz
    products[..., 2, 2] = 1 - xx - yy + zz
    products[..., 3, 3] = 1 + xx + yy + zz
    for i, j in ((0, 1), (0, 2), (1, 2)):
        products[..., i, j] = products[..., j, i] = r[..., i, j] + r[..., j, i]
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        products[..., k, 3] = products[..., 3, k] = r[..., i, j] - r[..., j, i]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q) + 0.0)  # + 0.0: no negative zeros


def angle_between(first: npt.ArrayLike, second: npt.ArrayLike) -> FloatArray:
    """Return angles (...) [rad] in [0, π] between rotation matrices `first` and `second` (..., 3, 3)."""
    relative = np.swapaxes(np.asarray(first, dtype=np.float64), -1, -2) @ np.asarray(second, np.float64)
    result: FloatArray = np.linalg.norm(log(relative), axis=-1)
    return result


def nearest_rotation(matrix: npt.ArrayLike) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) nearest to matrices (..., 3, 3) in the Frobenius norm."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    sign = np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)
    # Flip the direction of the smallest singular value to turn a reflection into the nearest rotation.
    u = np.concatenate([u[..., :2], u[..., 2:] * sign[..., None, None]], axis=-1)
    return np.asarray(u @ vt)


def transform(rotation: npt.ArrayLike, translation: npt.ArrayLike) -> FloatArray:
    """Return the transform (4, 4) of a rotation (3, 3) and a translation (3,)."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, translation
    return out


@compiled
def exp_into(vector, out):  # type: ignore[no-untyped-def]
    """Set out (3, 3) to the matrix of a rotation vector (3,)."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = math.sqrt(x * x + y * y + z * z)
    a = 1.0 - angle * angle / 6.0 if angle < 1e-4 else math.sin(angle) / angle
    b = 0.5 - angle * angle / 24.0 if angle < 1e-4 else (1.0 - math.cos(angle)) / (angle * angle)
    out[0, 0], out[1, 1] = 1.0 - b * (y * y + z * z), 1.0 - b * (x * x + z * z)
    out[2, 2] = 1.0 - b * (x * x + y * y)
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x


@compiled
def quaternion(rotation):  # type: ignore[no-untyped-def]
    """Return the unit quaternion (4,) xyzw, w ≥ 0, of a rotation (3, 3), like `quaternion_from_matrix`."""
    q = np.empty(4)
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    k = 3
    largest = trace
    for i in range(3):
        if rotation[i, i] > largest:
            k, largest = i, rotation[i, i]
    if k == 3:
        q[3] = 1.0 + trace
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            q[i] = rotation[b, a] - rotation[a, b]
    else:
        a, b = (k + 1) % 3, (k + 2) % 3
        q[k] = 1.0 + rotation[k, k] - rotation[a, a] - rotation[b, b]
        q[a] = rotation[a, k] + rotation[k, a]
        q[b] = rotation[b, k] + rotation[k, b]
        q[3] = rotation[b, a] - rotation[a, b]
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q / (length if q[3] >= 0.0 else -length)


@compiled(counted=True)  # frees the quaternion
def log_into(rotation, out):  # type: ignore[no-untyped-def]
    """Set out (3,) to the rotation vector of a rotation (3, 3), at any angle."""
    q = quaternion(rotation)
    sine = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, q[3]) / sine
    for i in range(3):
        out[i] = factor * q[i]
