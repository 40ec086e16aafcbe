import cv2
import numpy as np
import pytest

from synthetic.camera.rigs import default_cameras
from tests.helpers.label_maps import pictures_of
from tests.helpers.pushed_cube import MODEL
from tracker.geometry import cuboid, so3
from tracker.geometry.lens import stack_lenses
from tracker.objects.model import Box
from tracker.pose.align import WHOLLY, align, count_labels, explanation_score
from tracker.pose.evidence import NUMBERS, RESIZED, resized
from tracker.pose.fit import SEEN
from tracker.pose.strips import MAX_STRIPS, STRIP

BOX = Box.of(MODEL)
FACES = BOX.half, BOX.face_labels
STILL = np.zeros((3, 6))


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
        align(lenses, labels, pictures_of(labels), FACES, rotation, position, reaches, strips)
        turned = so3.angle_between(rotation, truth.rotation)
        errors.append([np.linalg.norm(position - truth.position), turned])
    shifts, turns = np.transpose(errors)
    assert np.median(shifts) < 0.4e-3
    assert np.mean((shifts < 5e-3) & (turns < np.radians(5))) >= 0.9


def counted_at(scene, rotation, position, blur=0.0):
    cameras, labels, _ = scene
    seen, lenses = np.zeros(3, SEEN), stack_lenses(cameras)
    seen["blur"] = blur
    count_labels(lenses, labels, pictures_of(labels), FACES, rotation, position, STILL, seen)
    return seen


def test_explanation_counts_what_the_truth_shows_and_a_worse_pose_scores_less(scene):
    truth, shown = scene[2], (scene[1] > 0).sum(axis=(1, 2))
    counts = counted_at(scene, truth.rotation, truth.position)
    assert (np.abs(counts["predicted"] - shown) < 0.06 * shown).all()
    assert (counts["agree"] > 0.93 * shown).all()
    colored = counts["elsewhere"] + counts["extra"] + counts["agree"] + counts["wrong"]
    np.testing.assert_array_equal(colored, shown)
    inside = counts["agree"] + counts["missing"] + counts["wrong"]
    np.testing.assert_array_equal(inside, counts["predicted"])
    pictures = pictures_of(scene[1])
    best = explanation_score(counts, pictures)
    for step in np.eye(3):
        shifted = counted_at(scene, truth.rotation, truth.position + 0.01 * step)
        turned = counted_at(scene, so3.exp(0.3 * step) @ truth.rotation, truth.position)
        assert max(explanation_score(other, pictures) for other in (shifted, turned)) < best


@pytest.mark.parametrize("blur", [0.0, 0.9, 2.2])
def test_pixels_inside_a_face_keep_away_from_its_outline(scene, blur):
    cameras, labels, truth = scene
    counts = counted_at(scene, truth.rotation, truth.position, blur)
    corners, checked = cuboid.corners(MODEL.size) @ truth.rotation.T + truth.position, 0
    for c, camera in enumerate(cameras):
        pixels = camera.project(corners).astype(np.float32)
        for face in np.flatnonzero(counts["faces"][c].sum(axis=1)):
            outline = pixels[cuboid.FACE_CORNERS[face]]
            away = [
                cv2.pointPolygonTest(outline, (float(i), float(j)), True)
                for j, i in np.ndindex(camera.height, camera.width)
            ]
            inner = np.array(away).reshape(camera.height, camera.width) >= max(WHOLLY, blur / 2)
            found = labels[c, : camera.height, : camera.width][inner]
            np.testing.assert_array_equal(counts["inner"][c, face], np.bincount(found, minlength=7))
            checked += 1
    assert checked >= 6


def gain(scene, faces=FACES, moved=(0.0, 0.0, 0.0), labels=None, room=np.inf):
    """By how much another body explains more than a box that is moved along its axes from the truth."""
    cameras, shown, truth = scene
    labels = shown if labels is None else labels
    place, seen = (truth.rotation, truth.position + truth.rotation @ moved, STILL), np.zeros(3, SEEN)
    sight = stack_lenses(cameras), labels, pictures_of(labels), faces
    count_labels(*sight, *place, seen)
    return (resized(*sight, place, room, seen, NUMBERS) - NUMBERS.resized) / NUMBERS.end


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("factor", [factor for factor, _ in RESIZED])
def test_a_body_of_which_an_edge_is_shorter_or_longer_is_known(scene, axis, factor):
    assert gain(scene) < 0.0
    # What one camera lacks alone may be hidden.
    labels = scene[1].copy()
    columns = np.flatnonzero(labels[axis].any(axis=0))
    labels[axis, :, : columns[len(columns) // 3]] = 0
    assert gain(scene, labels=labels) < 1.0
    half, moved = BOX.half.copy(), np.zeros(3)
    half[axis] /= factor
    for side in (1.0, -1.0):
        moved[axis] = side * (half[axis] - BOX.half[axis])
        assert gain(scene, (half, BOX.face_labels), moved) > 5.0


def test_no_body_reaches_into_the_table(scene):
    truth, half, moved = scene[2], BOX.half.copy(), np.zeros(3)
    axis = int(np.argmax(abs(truth.rotation[2])))
    half[axis] /= RESIZED[-1][0]
    moved[axis] = np.sign(truth.rotation[2, axis]) * (BOX.half[axis] - half[axis])  # its upper end is right
    below = 2 * abs(moved @ truth.rotation[2])
    assert gain(scene, (half, BOX.face_labels), moved, room=below + 1e-6) > 5.0
    assert gain(scene, (half, BOX.face_labels), moved, room=below - 1e-6) < 1.0
