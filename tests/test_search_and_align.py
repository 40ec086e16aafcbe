from __future__ import annotations

import numpy as np
import pytest

from synthetic.raycast import render
from synthetic.sensor import Sensor
from synthetic.simple import random_scene
from synthetic.simple_rig import default_cameras
from tests.helpers import random_rotations
from tracker.geometry import so3
from tracker.geometry.arena import Arena
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.objects.model import load_object
from tracker.pose.edges.strips import MAX_STRIPS, STRIP
from tracker.pose.fit import SEEN
from tracker.pose.hypotheses.align import align
from tracker.pose.hypotheses.explain import explain, explanation_score
from tracker.pose.hypotheses.positions import PositionSearch
from tracker.pose.hypotheses.rotations import ROTATIONS, RotationSearch, even_rotations
from tracker.pose.scale import label_camera

MODEL = load_object("cube_v2")
BOX = Box.of(MODEL)
USED = np.ones(3, np.bool_)


@pytest.fixture(scope="module")
def scene():
    """Perfect label maps of the reduced images of a cube without fingers, and the truth."""
    rng = np.random.default_rng(5)
    cameras = default_cameras()
    truth = render(random_scene(MODEL, rng, occlusion=0), cameras, MODEL, Sensor.clean(), rng)
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
