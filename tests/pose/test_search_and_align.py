from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from tests.helpers import look_at, make_camera, random_rotations
from tests.helpers.kept_stills import take
from tests.helpers.stills import bare_scene
from tracker.geometry import so3
from tracker.geometry.arena import Arena
from tracker.geometry.lens import project, stack_lenses
from tracker.objects.box import Box
from tracker.objects.model import load_object
from tracker.pose.edges.strips import MAX_STRIPS, STRIP
from tracker.pose.fit import SEEN
from tracker.pose.hypotheses.align import align
from tracker.pose.hypotheses.explain import explain, explanation_score
from tracker.pose.hypotheses.positions import ALMOST, MIN_SHARE, MIN_VOTE, PositionSearch, vote
from tracker.pose.hypotheses.rotations import ROTATIONS, RotationSearch, even_rotations
from tracker.pose.scale import label_camera, label_factors

MODEL = load_object("cube_v2")
BOX = Box.of(MODEL)
USED = np.ones(3, np.bool_)


@pytest.fixture(scope="module")
def scene():
    """Perfect label maps of the reduced images of a cube without fingers, and the truth."""
    rng = np.random.default_rng(5)
    cameras = default_cameras()
    truth = take(bare_scene(MODEL, rng), cameras, Sensor.clean(), rng)
    small = [label_camera(camera, 2) for camera in cameras]
    # The middle one of each 2×2 block would shift by half a pixel; any of the four is as good here.
    labels = np.stack([image[::2, ::2] for image in truth.labels])
    return stack_lenses(small), labels, truth


def test_rotations_are_even():
    rotations = even_rotations(ROTATIONS)
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.eye(3) + 0 * rotations, atol=1e-12
    )
    traces = np.einsum("nij,mij->nm", random_rotations(np.random.default_rng(1), 300), rotations)
    nearest = np.degrees(np.arccos(np.clip((traces.max(axis=1) - 1) / 2, -1, 1)))
    assert nearest.max() < 25
    assert np.median(nearest) < 15


def test_search_finds_position_and_rotation(scene):
    lenses, labels, truth = scene
    search = PositionSearch(lenses, BOX, Arena())
    integrals, pixels = search.integrals(labels, USED)
    assert pixels == np.count_nonzero(labels)
    positions = list(search.positions(labels, integrals, USED, 3))
    assert np.linalg.norm(positions[0] - truth.position) < 0.015
    rotations, costs = RotationSearch(lenses, BOX)(labels, USED, positions[0], 5)
    assert (np.diff(costs) >= 0).all()
    turned = [so3.angle_between(r, truth.rotation) for r in rotations]
    assert np.degrees(min(turned)) < 30


def all_votes(search, integrals, used):
    """Votes of all points of the finest grid in the arena."""
    parts = round(search._size / search._leaf)
    places = (np.arange(parts) - (parts - 1) / 2) * search._leaf
    finest = np.stack(np.meshgrid(places, places, places, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (search._cells[:, None] + finest).reshape(-1, 3)
    x, y, radius, bottom, top = search._inside
    inside = (np.hypot(points[:, 0] - x, points[:, 1] - y) <= radius) & (points[:, 2] >= bottom)
    points = points[inside & (points[:, 2] <= top)]
    return np.array(
        [vote(integrals, search.lenses, used, *p, search.radius, search.area_share, 0.0) for p in points]
    )


def scattered(rng, lenses, small):
    """Label maps that show an object somewhere in the arena, and patches in its colours that are none of it.

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
            labels[c][np.hypot(columns - u, rows - v) < radius] = rng.integers(1, 7)
        labels[c, camera.height :], labels[c, :, camera.width :] = 0, 0
    return labels


@pytest.mark.parametrize("distance", [None, 0.12, 0.22, 0.3])
def test_votes_from_coarse_to_fine_find_what_the_whole_grid_shows(distance):
    rng, found = np.random.default_rng(6), 0
    for _ in range(10):
        cameras = list(default_cameras())
        for c in range(len(cameras) if distance is not None else 0):
            angle = rng.uniform(0, 2 * np.pi)
            place = distance * np.array([0.7 * np.cos(angle), 0.7 * np.sin(angle), 0.71])
            cameras[c] = dataclasses.replace(make_camera(), name=f"c{c}", camera_from_world=look_at(place))
        cameras = cameras[rng.integers(3) :]
        factors = label_factors(cameras, BOX, Arena())
        small = [label_camera(camera, factor) for camera, factor in zip(cameras, factors, strict=True)]
        search, used = PositionSearch(stack_lenses(small), BOX, Arena()), np.ones(len(small), np.bool_)
        integrals, _ = search.integrals(scattered(rng, search.lenses, small), used)
        every = all_votes(search, integrals, used)
        best = max(every.max(), MIN_VOTE)
        for share in (ALMOST, MIN_SHARE):
            scores = search._votes(integrals, used, share)[1]
            expected, least = every[every >= share * best], max(MIN_VOTE, share * best)
            assert scores.max(initial=0.0) == expected.max(initial=0.0)
            # Bounds are those of the middle of a picture; towards its corners a few are too low.
            seen, there = np.count_nonzero(scores >= least), np.count_nonzero(every >= least)
            assert 0.95 * there <= seen <= there
            assert distance is not None or seen == there
        found += every.max() >= MIN_VOTE
    assert found >= 7


def test_alignment_reaches_the_truth_from_far_away(scene):
    truth = scene[2]
    lenses, labels = stack_lenses(default_cameras()), np.stack(truth.labels)
    rng = np.random.default_rng(2)
    strips = np.empty(MAX_STRIPS, STRIP)
    errors = []
    for _ in range(20):
        axis = rng.normal(size=3)
        rotation = so3.exp(np.radians(20) * axis / np.linalg.norm(axis)) @ truth.rotation
        position = truth.position + rng.normal(0, 0.004, 3)
        reaches = np.array([10, 10, 8, 6, 5])
        align(lenses, labels, USED, BOX.half, BOX.face_labels, rotation, position, reaches, strips)
        errors.append(
            [np.linalg.norm(position - truth.position), so3.angle_between(rotation, truth.rotation)]
        )
    far = np.array(errors)
    assert np.median(far[:, 0]) < 0.4e-3
    assert np.mean((far[:, 0] < 5e-3) & (far[:, 1] < np.radians(5))) >= 0.9


def test_explanation_counts_what_the_truth_shows(scene):
    lenses, labels, truth = scene
    seen = np.zeros(3, SEEN)
    explain(lenses, labels, USED, BOX.half, BOX.face_labels, truth.rotation, truth.position, seen)
    for c in range(3):
        shown = np.count_nonzero(labels[c])
        assert abs(seen["predicted"][c] - shown) < 0.06 * shown
        assert seen["agree"][c] > 0.93 * shown
    inside = seen["agree"] + seen["missing"] + seen["wrong"]
    np.testing.assert_array_equal(inside, seen["predicted"])


def test_a_worse_pose_scores_less(scene):
    lenses, labels, truth = scene
    seen = np.zeros(3, SEEN)

    def score(position, rotation):
        explain(lenses, labels, USED, BOX.half, BOX.face_labels, rotation, position, seen)
        return explanation_score(seen)

    best = score(truth.position, truth.rotation)
    for step in np.eye(3):
        assert score(truth.position + 0.01 * step, truth.rotation) < best
        assert score(truth.position, so3.exp(0.3 * step) @ truth.rotation) < best
