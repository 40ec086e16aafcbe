"""Bundle adjustment against geometry that is known exactly."""

import dataclasses

import numpy as np
import pytest

from tests.helpers import make_camera, random_rotations
from tests.helpers.moving_cube import knocked, relative_errors
from tracker.calibration.by_object.bundle import OWN, Posed, Prior, Unknowns, relative_covariance, solve
from tracker.calibration.by_object.edges import Contour, seen_motion
from tracker.calibration.rig import CameraRig
from tracker.geometry import so3

TRUE = CameraRig(tuple(make_camera(azimuth) for azimuth in (60, 180, 300)))
RIM = 0.2e-3, 0.3e-3
PIECES = 45


class World:
    """Poses of points on a cube, and what cameras would measure of them."""

    def __init__(self, rng, frames, noise):
        self.true = TRUE
        self.positions = rng.uniform([-0.1, -0.1, 0.03], [0.1, 0.1, 0.12], (frames, 3))
        self.rotations = random_rotations(rng, frames)
        size = (frames, len(TRUE), PIECES)
        self.points = rng.uniform(-0.0325, 0.0325, (*size, 3))
        angle = rng.uniform(0, 2 * np.pi, size)
        self.normals = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.edges = rng.integers(0, 9, size)
        self.rims = rng.uniform(-600, -200, size)
        common = rng.normal(0, OWN, (*size[:2], 9))
        white = rng.normal(0, 0.1, size)
        self.noise = noise * (white + np.take_along_axis(common, self.edges, axis=2))

    def view(self, f, cameras, rotation, position):
        contours = []
        for c, camera in enumerate(cameras):
            points = self.points[f, c] @ rotation.T + position
            pixels, slopes = camera.project_with_jacobian(points)
            normal = self.normals[f, c]
            along = np.einsum("ni,nij->nj", normal, slopes)
            truth = self.true[c].project(self.points[f, c] @ self.rotations[f].T + self.positions[f])
            offset = np.einsum("ni,ni->n", normal, truth - pixels) + self.rims[f, c] * 0.1e-3
            contours.append(
                Contour(
                    pixel=pixels - camera.matrix[:2, 2],
                    normal=normal,
                    jacobian=np.concatenate([along, np.cross(points - position, along)], axis=1),
                    bloom=np.zeros(PIECES),
                    rim=self.rims[f, c],
                    offset=offset + self.noise[f, c],
                    variance=np.full(PIECES, 0.1**2),
                    edge=self.edges[f, c],
                    foot=np.zeros(PIECES),
                    scale=1.0,
                )
            )
        return Posed(position, contours)


def adjusted(world, start, *, focal=False, steps=6, rim=RIM):
    """Unknowns after some steps, and the last of these."""
    now, prior = Unknowns.of(start.cameras, rim[0]), Prior.of(start.cameras, rim, focal=focal)
    poses = list(zip(world.rotations, world.positions, strict=True))
    for _ in range(steps):
        step = solve([world.view(f, now.cameras, *pose) for f, pose in enumerate(poses)], now, prior)
        poses = [(so3.exp(d[3:]) @ r, p + d[:3]) for (r, p), d in zip(poses, step.poses, strict=True)]
        now = now.moved(step.change, step.rim)
    return now, step


def test_without_noise_cameras_and_rim_are_found(rng):
    start = knocked(TRUE, seed=2)
    now, _ = adjusted(World(rng, 30, noise=0.0), start)
    found = CameraRig(now.cameras)
    assert np.abs(relative_errors(start, TRUE)[:, :3]).max() > 1e-3
    assert np.abs(relative_errors(found, TRUE)[:, :3]).max() < 0.02e-3
    assert np.degrees(np.abs(relative_errors(found, TRUE)[:, 3:]).max()) < 0.002
    assert now.rim == pytest.approx(0.1e-3, abs=0.005e-3)
    mean = now.errors[:, :6].mean(axis=0)  # what moves all cameras alike stays as it was
    assert np.abs(mean[:3]).max() < 0.05e-3
    assert np.degrees(np.abs(mean[3:]).max()) < 0.005


def test_lenses_are_found_where_they_may_be_wrong(rng):
    world = World(rng, 40, noise=0.0)
    wrong = []
    for c, camera in enumerate(TRUE):
        matrix = camera.matrix.copy()
        matrix[(0, 1), (0, 1)] *= 1.0 + 0.003 * (c - 1)
        matrix[0, 2] += 1.0
        wrong.append(dataclasses.replace(camera, matrix=matrix))
    start = CameraRig(tuple(wrong))
    now, _ = adjusted(world, start, focal=True)
    for camera, true in zip(now.cameras, TRUE, strict=True):
        assert camera.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=3e-4)
        assert camera.matrix[0, 2] == pytest.approx(true.matrix[0, 2], abs=0.1)
    kept, _ = adjusted(world, start)
    for camera, before in zip(kept.cameras, start, strict=True):
        np.testing.assert_allclose(camera.matrix, before.matrix, rtol=1e-9)


def test_the_covariance_covers_the_errors():
    values = []
    for seed in range(12):
        world = World(np.random.default_rng([3, seed]), 20, noise=1.0)
        now, step = adjusted(world, TRUE, steps=2, rim=(0.1e-3, 1e-5))
        covariances = relative_covariance(step.covariance)
        for error, covariance in zip(relative_errors(CameraRig(now.cameras), TRUE), covariances, strict=True):
            values.append(error @ np.linalg.solve(covariance, error))
    # Six unknowns of each camera.
    assert 4.0 < np.mean(values) < 8.0


def test_edges_that_are_off_as_a_whole_make_the_cameras_less_certain(rng):
    world = World(rng, 20, noise=1.0)
    known = (0.1e-3, 1e-5)
    _, sharp = adjusted(world, TRUE, steps=3, rim=known)
    common = rng.normal(0, 0.2, (*world.edges.shape[:2], 9))
    world.noise = world.noise + np.take_along_axis(common, world.edges, axis=2)
    _, worn = adjusted(world, TRUE, steps=3, rim=known)
    assert worn.own == pytest.approx(0.2**2 + OWN**2, rel=0.3)
    assert sharp.own == pytest.approx(OWN**2, rel=0.5)
    assert np.trace(relative_covariance(worn.covariance)[0]) > np.trace(
        relative_covariance(sharp.covariance)[0]
    )


def test_a_rim_that_is_not_known_leaves_the_distances_open(rng):
    world = World(rng, 20, noise=1.0)
    stds = []
    for rim_std in (1e-5, 3e-4):
        _, step = adjusted(world, TRUE, steps=1, rim=(0.1e-3, rim_std))
        stds.append(np.sqrt([np.trace(one[:3, :3]) for one in relative_covariance(step.covariance)]))
    assert (stds[1] > 1.1 * stds[0]).all()


def test_eliminating_the_poses_changes_nothing(rng):
    """Against all unknowns solved for at once."""
    world, frames = World(rng, 4, noise=1.0), 4
    now, prior = Unknowns.of(TRUE.cameras, RIM[0]), Prior.of(TRUE.cameras, RIM, focal=True)
    views = [world.view(f, now.cameras, world.rotations[f], world.positions[f]) for f in range(frames)]
    step = solve(views, now, prior)
    size = 6 * frames + 31
    matrix, right = np.zeros((size, size)), np.zeros(size)
    for f, view in enumerate(views):
        for c, contour in enumerate(view.contours):
            rows = np.zeros((PIECES, size))
            rows[:, 6 * f : 6 * f + 6] = contour.jacobian
            its = 6 * frames + 10 * c
            rows[:, its : its + 6] = contour.jacobian @ seen_motion(view.position)
            rows[:, its + 7] = np.einsum("ni,ni->n", contour.normal, contour.pixel)
            rows[:, its + 8 : its + 10] = contour.normal
            rows[:, -1] = contour.rim
            left = contour.offset - contour.rim * now.rim
            weight = np.clip(1.0 - (left / max(0.4, 4.685 * step.residual)) ** 2, 0.0, None) ** 2
            found = contour.information(np.column_stack([rows, left]), weight, step.own)
            matrix += found[:-1, :-1]
            right += found[:-1, -1]
        held = slice(6 * f, 6 * f + 6)
        matrix[held, held] += np.diag(np.repeat([2e-2**-2.0, 0.3**-2.0], 3))
    for c, information in enumerate(prior.information):
        its = slice(6 * frames + 10 * c, 6 * frames + 10 * c + 10)
        matrix[its, its] += information
    matrix[-1, -1] += RIM[1] ** -2.0
    unit = 1.0 / np.sqrt(np.diag(matrix))
    expected = unit * np.linalg.solve(matrix * np.outer(unit, unit), unit * right)
    np.testing.assert_allclose(step.poses.ravel(), expected[: 6 * frames], rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(step.change.ravel(), expected[6 * frames : -1], rtol=1e-5, atol=1e-10)
    assert step.rim - now.rim == pytest.approx(expected[-1], rel=1e-5)
