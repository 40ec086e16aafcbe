from __future__ import annotations

import numpy as np

from tests.helpers import image_grid
from tracker.geometry.field_of_view import largest_tangent, project_in_view


def test_points_of_the_image_are_projected_as_the_camera_does(camera):
    pixels = image_grid(camera)
    points = camera.position + 0.5 * camera.rays(pixels)
    np.testing.assert_allclose(project_in_view(camera, points), pixels, atol=1e-9)
    np.testing.assert_array_equal(project_in_view(camera, points), camera.project(points))


def test_the_largest_tangent_is_that_of_a_corner(camera):
    corners = [(-0.5, -0.5), (269.5, -0.5), (-0.5, 269.5), (269.5, 269.5)]
    tangents = np.linalg.norm(camera.undistort(corners), axis=1)
    assert largest_tangent(camera) == tangents.max()


def test_points_that_the_lens_would_fold_into_the_image_have_no_pixel(camera, rng):
    directions = rng.normal(size=(20_000, 3))
    points = camera.position + directions @ camera.camera_from_world[:3, :3]
    pixels = project_in_view(camera, points)
    seen = (pixels >= -0.5).all(axis=1) & (pixels <= 269.5).all(axis=1)
    assert seen.any()
    angles = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    assert np.tan(angles[seen]).max() <= largest_tangent(camera)
    assert np.isnan(pixels[directions[:, 2] <= 0]).all()


def test_a_point_in_the_camera_has_no_pixel(camera):
    assert np.isnan(project_in_view(camera, [camera.position])).all()
