from __future__ import annotations

import numpy as np

from tests.helpers import make_camera, numerical_jacobian, random_rotations
from tracker.geometry import so3
from tracker.geometry.cuboid import corners
from tracker.pose import edges
from tracker.pose.lens import project
from tracker.pose.views import stack_lenses

CAMERA = make_camera()
LENSES = stack_lenses([CAMERA])
HALF = np.array([0.01, 0.04, 0.015])
LABELS = np.array([1, 5, 2, 6, 3, 4], dtype=np.uint8)


def samples_at(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    out = np.empty((edges.MAX_SAMPLES, edges.COLUMNS))
    n = edges.edge_samples(LENSES, 0, HALF, LABELS, rotation, position, 2.0, 3.0, out)
    return out[:n]


def test_jacobian_is_the_motion_along_the_normal(rng):
    for rotation in random_rotations(rng, 5):
        position = np.array([0.02, -0.03, 0.05])
        samples = samples_at(rotation, position)
        # Which point of the object a sample shows: the one on an edge that projects there.
        ends = corners(2 * HALF)
        for row in samples[:: max(1, len(samples) // 10)]:
            candidates = [
                ends[a] + t * (ends[b] - ends[a]) for a, b, *_ in edges.EDGES for t in np.linspace(0, 1, 4001)
            ]
            world = np.array(candidates) @ rotation.T + position
            pixels = CAMERA.project(world)
            best = np.argmin(np.linalg.norm(pixels - row[[edges.U, edges.V]], axis=1))
            point = candidates[best]

            def along(x, point=point, row=row, rotation=rotation, position=position):
                moved = so3.exp(x[3:]) @ rotation @ point + position + x[:3]
                u, v, _ = project(LENSES, 0, *moved)
                return np.array([u * row[edges.NU] + v * row[edges.NV]])

            numeric = numerical_jacobian(along, np.zeros(6))[0]
            np.testing.assert_allclose(row[edges.J : edges.J + 6], numeric, rtol=2e-3, atol=0.3)


def test_normals_are_unit_and_point_out_of_the_face(rng):
    for rotation in random_rotations(rng, 10):
        samples = samples_at(rotation, np.array([0.0, 0.0, 0.05]))
        normals = samples[:, [edges.NU, edges.NV]]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
        centre = CAMERA.project(np.array([[0.0, 0.0, 0.05]]))[0]
        silhouette = samples[samples[:, edges.OUTSIDE] == 0]
        outward = np.sum(
            (silhouette[:, [edges.U, edges.V]] - centre) * silhouette[:, [edges.NU, edges.NV]], axis=1
        )
        assert (outward > 0).all()


def test_samples_count_stays_within_the_work_space():
    big = stack_lenses([CAMERA.resized(1080, 1080)])
    out = np.empty((edges.MAX_SAMPLES, edges.COLUMNS))
    for rotation in random_rotations(np.random.default_rng(3), 10):
        n = edges.edge_samples(big, 0, HALF, LABELS, rotation, np.array([0.0, 0.0, 0.1]), 0.5, 1.0, out)
        assert 0 < n <= edges.MAX_SAMPLES
