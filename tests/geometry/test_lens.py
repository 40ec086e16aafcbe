import dataclasses

import cv2
import numpy as np
import pytest

from tests.helpers import LENSES, image_grid, make_camera
from tracker.geometry import lens
from tracker.geometry.lens import stack_lenses
from tracker.geometry.linear import factorise, median, solve_positive, substitute


@pytest.mark.parametrize("coefficients", LENSES.values(), ids=map(str, LENSES))
def test_every_lens_of_opencv_is_projected_by_camera_and_compiled_code(coefficients, rng):
    camera = dataclasses.replace(make_camera(), distortion=np.array(coefficients))
    lenses, jacobian = stack_lenses([make_camera(180.0), camera]), np.empty((2, 3))
    points = rng.uniform([-0.18, -0.18, 0], [0.18, 0.18, 0.15], size=(40, 3))
    turn, _ = cv2.Rodrigues(np.array(camera.camera_from_world[:3, :3]))
    move = np.array(camera.camera_from_world[:3, 3])
    expected, slopes = cv2.projectPoints(points, turn, move, np.array(camera.matrix), np.array(coefficients))
    # Derivatives by the translation in the camera's frame, which turning takes to those by the point.
    slopes = slopes[:, 3:6].reshape(-1, 2, 3) @ camera.camera_from_world[:3, :3]
    pixels, derivatives = camera.project_with_jacobian(points)
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(derivatives, slopes, rtol=1e-8, atol=1e-7)
    for point, pixel, slope in zip(points, expected[:, 0], slopes, strict=True):
        np.testing.assert_allclose(lens.project(lenses, 1, *point)[:2], pixel, atol=1e-9)
        found = lens.project_with_jacobian(lenses, 1, *point, jacobian)[:2]
        np.testing.assert_allclose(found, pixel, atol=1e-9)
        np.testing.assert_allclose(jacobian, slope, rtol=1e-8, atol=1e-7)
    on_image = rng.uniform(0, 269, size=(60, 2))
    ahead = camera.position + 0.5 * camera.rays(on_image)
    np.testing.assert_allclose(camera.project(ahead), on_image, atol=1e-8)


def test_points_of_the_image_are_projected_as_ever_and_those_folded_into_it_have_no_pixel(rng):
    camera = make_camera()
    points = camera.position + 0.5 * camera.rays(image_grid(camera))
    np.testing.assert_array_equal(camera.project_in_view(points), camera.project(points))
    corners = [(-0.5, -0.5), (269.5, -0.5), (-0.5, 269.5), (269.5, 269.5)]
    assert camera.largest_tangent == np.linalg.norm(camera.undistort(corners), axis=1).max()
    directions = rng.normal(size=(20_000, 3))
    points = camera.position + directions @ camera.camera_from_world[:3, :3]
    pixels = camera.project_in_view(points)
    seen = (pixels >= -0.5).all(axis=1) & (pixels <= 269.5).all(axis=1)
    assert seen.any()
    angles = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    assert np.tan(angles[seen]).max() <= camera.largest_tangent
    assert np.isnan(pixels[directions[:, 2] <= 0]).all()
    assert np.isnan(camera.project_in_view([camera.position])).all()


@pytest.mark.parametrize("size", [1, 3, 6, 8])
def test_factor_and_solution_are_numpys_and_only_lower_halves_are_read(rng, size):
    root, vector, out = rng.normal(size=(size, size)), rng.normal(size=size), np.empty(size)
    matrix = root @ root.T + np.eye(size)
    expected, factor = np.linalg.solve(matrix, vector), np.linalg.cholesky(matrix)
    lower = np.zeros((size, size))
    matrix[np.triu_indices(size, 1)] = np.nan
    assert factorise(matrix, lower)
    np.testing.assert_allclose(lower, factor, rtol=1e-9, atol=1e-12)
    lower[np.triu_indices(size, 1)] = np.nan
    substitute(lower, vector, out)
    np.testing.assert_allclose(out, expected, rtol=1e-9)
    assert solve_positive(matrix, vector, out)
    np.testing.assert_allclose(out, expected, rtol=1e-9)
    substitute(lower, vector, vector)  # which may be overwritten
    np.testing.assert_allclose(vector, expected, rtol=1e-9)
    # What is not positive definite is refused.
    for none in (np.diag([1.0, -1.0, 2.0]), np.ones((3, 3)), np.zeros((3, 3)), np.full((3, 3), np.nan)):
        assert not solve_positive(none, rng.normal(size=3), np.empty(3))
        assert not factorise(none, np.empty((3, 3)))


def test_median_is_numpys_with_ties_and_without(rng):
    for n in range(1, 60):
        for values in (rng.normal(size=n), rng.integers(0, n, n).astype(float)):
            assert median(values.copy(), n) == np.median(values)
