from pathlib import Path

import numpy as np
import pytest

import tracker
from benchmarks.data.recorded import POSED, labelled_images, triplet
from benchmarks.measure.recorded import inside_distances, light_changes
from tracker.color_learning.labelled import intersection_over_union


@pytest.fixture(scope="module", params=POSED)
def posed(real: Path, request: pytest.FixtureRequest):
    """Tracker and labelled images of a triplet, the calibration of halved images corrected."""
    return triplet(real, request.param, corrected=request.param == "cuboid_2x2x8_v2")


def test_labelled_pixels_lie_in_the_faces_of_their_colour_and_the_face_on_the_table_is_level(posed):
    assert np.mean(inside_distances(*posed) >= 0) >= 0.99
    detector, images = posed
    pose = detector.detect([i.image for i in images]).object_pose
    assert np.abs(pose.rotation[2]).max() > np.cos(np.radians(2))


def test_changed_light_does_not_move_the_pose(posed):
    detector, images = posed
    near, draws = 0, 50
    for shift, turn, confidence in light_changes(detector, [i.image for i in images], draws):
        right = shift < 3 and turn < 3
        near += right
        assert right or confidence <= 0.5
    assert near >= 0.98 * draws


@pytest.mark.parametrize(
    ("name", "mean", "least"),
    [("cube_v1", 0.90, 0.5), ("cube_v2", 0.90, 0.5), ("cube_v3", 0.88, 0.5), ("cuboid_2x2x8_v2", 0.75, 0.4)],
)
def test_segmentation_agrees_with_hand_made_masks(real, name, mean, least):
    images = labelled_images(real, name)
    colors = tracker.load_colors(name)
    scores = [intersection_over_union(tracker.segment(i.image, colors), i.labels) for i in images]
    values = [value for score in scores for value in score.values()]
    assert np.mean(values) >= mean
    assert min(values) > least
