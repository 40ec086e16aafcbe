import dataclasses
import itertools

import cv2
import numpy as np
import pytest

import tracker
from synthetic.camera.rigs import default_cameras
from tests.helpers import look_at, make_camera, random_rotations
from tests.helpers.kept_stills import bare
from tests.helpers.label_maps import drawn, pictures_of
from tests.helpers.pushed_cube import MODEL
from tracker import Arena
from tracker.geometry import cuboid, so3
from tracker.geometry.lens import project, stack_lenses
from tracker.objects.model import Box
from tracker.pose.fit import Fit
from tracker.pose.rotations import ROTATIONS, even_rotations, likely_rotations, rotation_grid
from tracker.pose.scale import label_camera, label_factors
from tracker.pose.votes import CELL, DOUBT, MOST_POINTS, TIGHT, PositionSearch, _grid, vote

BOX = Box.of(MODEL)
FACES = BOX.half, BOX.face_labels
LONG_BOX = tracker.load_object("cuboid_2x2x8_v2")


def test_rotations_are_even():
    rotations = even_rotations(ROTATIONS)
    squares = rotations @ rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=1e-12)
    traces = np.einsum("nij,mij->nm", random_rotations(np.random.default_rng(1), 300), rotations)
    nearest = np.degrees(np.arccos(np.clip((traces.max(axis=1) - 1) / 2, -1, 1)))
    assert nearest.max() < 25
    assert np.median(nearest) < 15


def test_search_finds_position_and_rotation(scene):
    cameras, labels, truth = scene
    pictures = pictures_of(labels)
    search = PositionSearch(cameras, BOX, Arena())
    positions = list(search(search.views(labels, pictures), labels, pictures, 3))
    assert np.linalg.norm(positions[0] - truth.position) < 0.015
    rotations = np.empty((5, 3, 3))
    likely_rotations(stack_lenses(cameras), labels, pictures, FACES, positions[0], rotation_grid(), rotations)
    turned = [so3.angle_between(r, truth.rotation) for r in rotations]
    assert np.degrees(min(turned)) < 30


def test_points_that_one_camera_views_do_not_outvote_the_place_that_all_view():
    cameras, labels, truth = drawn(LONG_BOX, 8)
    for radius in (0.4, 0.6):
        arena, pictures = Arena(radius=radius, height=radius, table=None), pictures_of(labels)
        search = PositionSearch(cameras, Box.of(LONG_BOX), arena)
        (place,) = search(search.views(labels, pictures), labels, pictures, 1)
        assert np.linalg.norm(place - truth.position) < 0.015


@pytest.mark.parametrize("degrees", [45, 55, 65, 75])
def test_cameras_that_look_aside_rank_no_rotation(scene, degrees):
    cameras, labels, truth = scene
    turn = so3.transform(so3.exp([0.0, np.radians(degrees), 0.0]), np.zeros(3))
    aside = [dataclasses.replace(one, camera_from_world=turn @ one.camera_from_world) for one in cameras]
    alone, wider = np.empty((2, 20, 3, 3))
    for rig, seen, out in (
        (cameras, labels, alone),
        ([*cameras, *aside], np.concatenate([labels, np.zeros_like(labels)]), wider),
    ):
        likely_rotations(
            stack_lenses(rig), seen, pictures_of(seen), FACES, truth.position, rotation_grid(), out
        )
    np.testing.assert_array_equal(wider, alone)


@pytest.mark.parametrize("label", [4, 6])
def test_a_block_in_a_faces_colour_beside_the_object_hides_no_rotation(label):
    cameras, clear, truth = drawn(LONG_BOX, 8)
    box, best = Box.of(LONG_BOX), np.empty((10, 3, 3))
    for angle in np.radians([0, 90, 180, 270]):
        away = np.array([np.cos(angle), np.sin(angle), 0.0])
        middle = truth.position + (abs(away @ truth.rotation) @ box.half + 0.03) * away
        middle[2] = 0.025
        block = cuboid.corners((0.06, 0.06, 0.05)) @ so3.exp(np.array([0, 0, angle])).T + middle
        labels = clear.copy()
        for camera, one in zip(cameras, labels, strict=True):
            outline = cv2.convexHull(np.rint(camera.project(block)).astype(np.int32))
            one[(cv2.fillConvexPoly(np.zeros_like(one), outline, 1) > 0) & (one == 0)] = label
        faces, lenses, pictures = (box.half, box.face_labels), stack_lenses(cameras), pictures_of(labels)
        likely_rotations(lenses, labels, pictures, faces, truth.position, rotation_grid(), best)
        assert min(so3.angle_between(one, truth.rotation) for one in best) < np.radians(25)


def counted(labels, camera, points):
    """Shares (N, 2) of the object in the wide and the tight square around points (N, 3), a third per colour.

    By the definition, from every pixel; and whether the camera sees the points (N,).
    """
    pixels, depth = camera.project_in_view(points), points @ camera.camera_from_world[2, :3]
    depth += camera.camera_from_world[2, 3]
    focal = camera.matrix[(0, 1), (0, 1)]
    surface = 8 * sum(np.prod(np.delete(BOX.half, k)) for k in range(3))
    height, width = camera.height // CELL * CELL, camera.width // CELL * CELL
    rows, columns = np.nonzero(labels[:height, :width])
    shown = labels[rows, columns] == np.arange(1, 7)[:, None]
    seen = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    pixels, result = np.where(seen[:, None], pixels, 0.0), []
    for share in (1.0, TIGHT):
        reach = share * BOX.radius * focal / depth[:, None]
        low, high = CELL * np.rint((pixels - reach) / CELL), CELL * np.rint((pixels + reach + 1) / CELL)
        inside = (columns >= low[:, :1]) & (columns < high[:, :1])
        inside &= (rows >= low[:, 1:]) & (rows < high[:, 1:])
        expected = np.maximum(surface / 4 * focal.prod() / depth**2, 1.0)
        result.append(np.minimum(inside.astype(int) @ shown.T / expected[:, None], 1 / 3).sum(axis=1))
    return np.stack(result, axis=1), seen & (depth > 1.5 * BOX.radius)


def scattered(rng, lenses, small):
    """Label maps that show three faces somewhere in the arena, and patches in their colours that are none.

    An object that no camera shows is none.
    """
    labels = np.zeros((len(small), max(c.height for c in small), max(c.width for c in small)), np.uint8)
    rows, columns = np.mgrid[: labels.shape[1], : labels.shape[2]]
    angle, away = rng.uniform(0, 2 * np.pi), 0.2 * np.sqrt(rng.uniform())
    place = away * np.cos(angle), away * np.sin(angle), rng.uniform(0.03, 0.15)
    for c, camera in enumerate(small):
        u, v, depth = project(lenses, c, *place)
        discs = [(u, v, 0.8 * BOX.radius * camera.matrix[0, 0] / depth)] if depth > BOX.radius else []
        discs += rng.uniform([0, 0, 1], [camera.width, camera.height, 6], (3, 3)).tolist()
        for u, v, radius in discs:
            sector = np.floor(1.5 * np.arctan2(rows - v, columns - u) / np.pi).astype(int) % 3
            inside = np.hypot(columns - u, rows - v) < radius
            labels[c][inside] = (sector[inside] + rng.integers(6)) % 6 + 1
        labels[c, camera.height :], labels[c, :, camera.width :] = 0, 0
    return labels


def test_votes_are_what_the_cameras_show_around_the_points():
    rng = np.random.default_rng(6)
    for count in (3, 2, 1):
        cameras = list(default_cameras())[:count]
        for c in range(count):
            angle = rng.uniform(0, 2 * np.pi)
            place = 0.3 * np.array([0.7 * np.cos(angle), 0.7 * np.sin(angle), 0.71])
            if c == 1:
                cameras[c] = dataclasses.replace(make_camera(), name="near", camera_from_world=look_at(place))
        factors = label_factors(cameras, BOX, Arena())
        small = [label_camera(camera, factor) for camera, factor in zip(cameras, factors, strict=True)]
        search = PositionSearch(small, BOX, Arena())
        labels = scattered(rng, search.lenses, small)
        pictures, votes = pictures_of(labels), np.empty(len(search.points), np.float32)
        views = search.views(labels, pictures)
        shown = [counted(*pair, search.points) for pair in zip(labels, small, strict=True)]
        for left_out in (None, *range(count if count > 1 else 0)):
            pictures["used"] = np.arange(count) != left_out
            most, total, seen = vote(views, pictures, votes), 0.0, DOUBT
            for shares, inside in itertools.compress(shown, pictures["used"]):
                total, seen = total + np.where(inside, shares.sum(axis=1), 0.0), seen + inside
            # A pixel on the border of a square is in or out by rounding.
            assert np.mean(np.abs(votes - DOUBT * total / seen) < 1e-5) > 0.999
            assert most == votes.max() > 0.5


def test_points_fill_the_arena_however_small_and_nothing_else():
    for radius in np.linspace(0.001, 0.05, 99):
        points = PositionSearch(default_cameras(), BOX, Arena(radius=float(radius))).points
        assert len(points) > 0
        assert np.hypot(points[:, 0], points[:, 1]).max() <= max(radius, 0.36 * BOX.radius)
    low = PositionSearch(default_cameras(), BOX, Arena(height=1e-17, table=1.0, table_std=(0.0, 0.0))).points
    assert len(low) > 0
    assert (low[:, 2] == 1.0).all()
    for height in np.geomspace(1e-6, 10.0, 40):
        wide = Arena(radius=10.0, height=float(height), table_std=(0.0, 0.0))
        assert 0.1 * MOST_POINTS < len(_grid(wide, 0.01)) <= MOST_POINTS
    arena = Arena(center=(0.1, -0.2), radius=0.3, height=0.2)
    points = PositionSearch(default_cameras(), BOX, arena).points
    away = points - [*arena.center, 0.0]
    assert np.hypot(away[:, 0], away[:, 1]).max() <= arena.radius
    step = np.unique(np.round(points[:, 0], 9))
    assert np.diff(step).max() < 0.6 * BOX.radius
    assert points[:, 2].min() < arena.lowest + 0.6 * BOX.radius
    assert points[:, 2].max() > arena.ground + arena.height - 0.6 * BOX.radius


@pytest.mark.parametrize("size", [(0.02, 0.3, 0.02), (0.2, 0.2, 0.01)])
def test_bars_and_plates_are_found_as_other_boxes_are(size):
    cameras = default_cameras()
    model = dataclasses.replace(LONG_BOX, size=size)
    one, errors = tracker.ObjectTracker(model, tracker.CameraRig(cameras)), []
    for k in range(4):
        truth = bare(model, cameras, [70, k])
        fit = one.fit(truth.images)
        assert isinstance(fit, Fit), k
        errors.append(np.linalg.norm(fit.position - truth.position))
    assert np.median(errors) < 0.05e-3
    assert max(errors) < 0.2e-3
