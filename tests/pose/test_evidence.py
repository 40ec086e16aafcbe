import numpy as np
import pytest

from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from tests.helpers.kept_stills import bare
from tracker import load_object
from tracker.geometry.lens import stack_lenses
from tracker.objects.box import Box
from tracker.pose.evidence import NUMBERS, RESIZED, evidence_at, resized_at
from tracker.pose.fit import SEEN
from tracker.pose.scale import label_camera
from tracker.pose.views import PICTURE


@pytest.fixture(scope="module")
def scene():
    """Perfect label maps of a cube without fingers, its truth, the cube and lenses."""
    model, cameras = load_object("cube_v2"), default_cameras()
    truth = bare(model, cameras, 5, Sensor.clean())
    labels = np.stack([image[::2, ::2] for image in truth.labels])
    return labels, truth, Box.of(model), stack_lenses([label_camera(camera, 2) for camera in cameras])


def gain(labels, lenses, faces, truth, moved=(0.0, 0.0, 0.0)):
    """By how much another body explains more than a box that is moved along its axes from the truth."""
    pictures, seen = np.zeros(3, PICTURE), np.zeros(3, SEEN)
    pictures["used"], pictures["colored"] = True, (labels > 0).sum(axis=(1, 2))
    place = truth.rotation, truth.position + truth.rotation @ moved, np.zeros((3, 6))
    sight = lenses, labels, pictures, faces, place
    evidence_at(*sight, stands=0.0, left_out=np.zeros(3, bool), seen=seen)
    return (resized_at(*sight, seen=seen) - NUMBERS.resized) / NUMBERS.end


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("factor", [RESIZED[0][0], RESIZED[1][0]])
def test_a_body_of_which_an_edge_is_shorter_or_longer_is_known(scene, axis, factor):
    labels, truth, box, lenses = scene
    assert gain(labels, lenses, (box.half, box.face_labels), truth) < 0.0
    half, moved = box.half.copy(), np.zeros(3)
    half[axis] /= factor
    for side in (1.0, -1.0):
        moved[axis] = side * (half[axis] - box.half[axis])
        assert gain(labels, lenses, (half, box.face_labels), truth, moved) > 5.0


def test_what_one_camera_lacks_alone_may_be_hidden(scene):
    labels, truth, box, lenses = scene
    faces = box.half, box.face_labels
    for c in range(3):
        columns = np.flatnonzero(labels[c].any(axis=0))
        some = labels.copy()
        some[c, :, : columns[len(columns) // 3]] = 0
        assert gain(some, lenses, faces, truth) < 1.0
