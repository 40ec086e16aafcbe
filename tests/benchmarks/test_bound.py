from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

import tracker
from benchmarks.data.disturbances import SHIFT_STD, TURN_STD
from benchmarks.data.package.scenes import face_map
from benchmarks.score.bound import FIXED_SIGMA, edge_noise, information, root_traces
from benchmarks.score.edges import EdgeSamples, edge_samples
from tests.helpers import make_camera, numerical_jacobian, random_rotations
from tracker.geometry import so3

CUBE = tracker.load_object("cube_v2")
POSITION = np.array([0.02, -0.01, 0.05])
CAMERAS = [dataclasses.replace(make_camera(angle), distortion=np.zeros(5)) for angle in (60, 180, 300)]


def edges_of(camera, rotation, hidden=None):
    labels = face_map(camera, CUBE, POSITION, rotation)
    if hidden is not None:
        labels[hidden] = 0
    return edge_samples(camera, CUBE, labels, POSITION, rotation)


def straight_edge(count=200, angle=0.1):
    """Samples along a straight edge through the middle of an image of 270 px."""
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    pixels = np.array([135.0, 135.0]) + np.linspace(-count / 2, count / 2, count)[:, None] * along
    empty = np.zeros((count, 6))
    return EdgeSamples(pixels, np.tile(across, (count, 1)), np.ones(count, bool), empty, empty)


def step_image(rng, noise, width, contrast=100.0, angle=0.1):
    y, x = np.mgrid[:270, :270] - 135.0
    distance = -np.sin(angle) * x + np.cos(angle) * y
    level = 60 + contrast * 0.5 * (1 + np.tanh(distance / width))
    image = level[..., None] + rng.normal(0, noise, (270, 270, 3))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_a_whole_cube_shows_nine_edges_and_each_pixel_once(rng):
    rotation = random_rotations(rng, 1)[0]
    for camera in CAMERAS:
        seen = edges_of(camera, rotation)
        assert len(seen) in (4, 7, 9)
        for edge in seen:
            steps = np.linalg.norm(np.diff(edge.pixels, axis=0), axis=1)
            assert np.abs(steps - 1).max() < 0.25
            np.testing.assert_allclose(np.linalg.norm(edge.normals, axis=1), 1)
            assert edge.visible.mean() > 0.6


def test_covered_edges_are_not_seen(rng):
    rotation = random_rotations(rng, 1)[0]
    camera = CAMERAS[0]
    column = round(camera.project(POSITION[None])[0, 0])
    hidden = np.zeros((270, 270), bool)
    hidden[:, column:] = True
    for edge in edges_of(camera, rotation, hidden):
        assert (edge.pixels[edge.visible, 0] < column).all()


def test_jacobian_is_what_the_projection_does(rng):
    rotation = random_rotations(rng, 1)[0]
    camera = CAMERAS[1]
    edge = edges_of(camera, rotation)[0]
    # Points on the ray of each pixel, at the depth of the edge: recovered from three of the columns.
    step = 1e-4 * rng.normal(size=3)
    moved = edge_samples(
        camera, CUBE, face_map(camera, CUBE, POSITION + step, rotation), POSITION + step, rotation
    )[0]
    shift = ((moved.pixels - edge.pixels) * edge.normals).sum(axis=1)
    np.testing.assert_allclose(shift, edge.jacobian[:, :3] @ step, atol=1e-3)


def test_a_moved_camera_is_a_world_moved_the_other_way(rng):
    rotation = random_rotations(rng, 1)[0]
    for camera in CAMERAS:
        turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        for edge in edges_of(camera, rotation):
            # camera_from_world moved by (δt, ω) shows the object at p + Rᵀδt + Rᵀω × p, turned by Rᵀω.
            effect = np.zeros((6, 6))
            effect[:3, :3] = effect[3:, 3:] = turn.T
            effect[:3, 3:] = -so3.hat(POSITION) @ turn.T
            np.testing.assert_allclose(edge.by_camera, edge.jacobian @ effect, atol=1e-3, rtol=1e-4)
            assert shift.shape == (3,)


def test_bound_is_the_scatter_of_least_squares(rng):
    rotation = random_rotations(rng, 1)[0]
    sigma, rows, total = 0.3, [], np.zeros((6, 6))
    for camera in CAMERAS:
        edges = edges_of(camera, rotation)
        total += information(edges, np.full(len(edges), sigma))
        rows += [edge.jacobian[edge.visible] for edge in edges]
    design = np.concatenate(rows)
    noise = rng.normal(0, sigma, (len(design), 2000))
    found = np.linalg.lstsq(design, noise, rcond=None)[0]
    scatter = np.sqrt((found[:3] ** 2).sum(axis=0).mean()), np.sqrt((found[3:] ** 2).sum(axis=0).mean())
    np.testing.assert_allclose(root_traces(total), scatter, rtol=0.06)
    # What the design of the platform was reckoned with.
    assert 0.03e-3 < root_traces(total)[0] < 0.09e-3


def test_bound_falls_with_the_noise_and_with_more_cameras(rng):
    rotation = random_rotations(rng, 1)[0]
    edges = [edges_of(camera, rotation) for camera in CAMERAS]
    full = sum(information(e, np.full(len(e), 0.3)) for e in edges)
    less = sum(information(e, np.full(len(e), 0.3)) for e in edges[:2])
    fine = sum(information(e, np.full(len(e), 0.1)) for e in edges)
    assert root_traces(full)[0] < root_traces(less)[0]
    np.testing.assert_allclose(np.array(root_traces(fine)) * 3, root_traces(full))


def test_an_uncertain_calibration_is_a_floor_that_no_sharpness_removes(rng):
    rotation = random_rotations(rng, 1)[0]
    prior = np.repeat([SHIFT_STD**-2, TURN_STD**-2], 3)
    edges = [edges_of(camera, rotation) for camera in CAMERAS]

    def bound(sigma, prior):
        return root_traces(sum(information(e, np.full(len(e), sigma), prior) for e in edges))[0]

    assert bound(0.01, prior) > 10 * bound(0.01, None)
    assert bound(0.3, prior) > bound(0.01, prior) > 0.2e-3
    assert bound(0.3, 1e12 * prior) == pytest.approx(bound(0.3, None), rel=1e-3)


def test_nothing_in_view_has_no_bound():
    assert np.isnan(root_traces(np.zeros((6, 6)))).all()
    assert len(edge_noise(np.zeros((270, 270, 3), np.uint8), [])) == 0


@pytest.mark.parametrize(("noise", "width"), [(4.0, 1.5), (8.0, 1.5), (6.0, 3.0)])
def test_measured_edge_noise_is_that_of_a_fitted_edge(rng, noise, width):
    # The best estimate of the place of a profile I(t) in white noise of σ per pixel and channel.
    t = np.arange(-4, 4, 0.01)
    slope = 50.0 / width / np.cosh(t / width) ** 2
    expected = noise / np.sqrt(3 * (slope**2).sum() * 0.01)
    (found,) = edge_noise(step_image(rng, noise, width), [straight_edge()])
    # Interpolation between pixels takes away some of the noise.
    assert 0.65 * expected < found < 1.1 * expected


def test_edge_noise_grows_with_blur_and_falls_with_contrast(rng):
    sharp, blurred = step_image(rng, 6, 1.0), step_image(rng, 6, 3.0)
    faint = step_image(rng, 6, 1.0, contrast=30.0)
    edge = [straight_edge()]
    assert edge_noise(sharp, edge) < edge_noise(blurred, edge)
    assert edge_noise(sharp, edge) < edge_noise(faint, edge)


def test_short_edges_take_the_median_of_the_others(rng):
    image = cv2.merge([step_image(rng, 6, 1.0)[..., 0]] * 3)
    whole = straight_edge()
    short = dataclasses.replace(whole, visible=np.arange(len(whole.visible)) < 3)
    found = edge_noise(image, [whole, short])
    assert found[0] == found[1]
    assert edge_noise(image, [short]) == FIXED_SIGMA


def test_derivative_is_the_numerical_one():
    from benchmarks.score.edges import derivative

    def function(x):
        return np.stack([x @ np.arange(6.0), x[0] * x[1] + np.sin(x[2])])

    np.testing.assert_allclose(derivative(function), numerical_jacobian(function, np.zeros(6)), atol=1e-8)
