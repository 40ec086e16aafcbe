import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.kept_stills import bare
from tests.helpers.pushed_cube import bits
from tracker.errors import ImageError

MODEL = tracker.load_object("cube_v2")
TRACKER = tracker.ObjectTracker(MODEL, RIG)
SHAPE = (270, 270)


@pytest.fixture(scope="module")
def truth():
    return bare(MODEL, RIG.cameras, 31)


@pytest.mark.parametrize("hidden", [[None] * 3, [np.zeros(SHAPE, bool)] * 3, dict.fromkeys(RIG.names)])
def test_masks_of_nothing_change_no_bit(truth, hidden):
    seen = []
    for masks in (None, hidden):
        TRACKER.reset()
        answers = [TRACKER.update(truth.images, 0.1 * k, masks) for k in range(3)]
        seen.append(bits(*answers, TRACKER.detect(truth.images, masks)))
    assert seen[0] == seen[1]


def labelled(images, hidden):
    """What the estimator is given of images with masks."""
    reader = TRACKER._estimator.reader
    return reader.labelled(images, reader.lit(images), hidden=hidden)


def counted(truth, images, hidden):
    """What the label maps show of the true pose."""
    sight = labelled(images, hidden)
    return TRACKER._estimator.search.counted(sight, truth.rotation, truth.position)


def test_colours_of_hidden_pixels_do_not_count_against(truth):
    # A finger in a face's colour is before half of the object in each camera.
    images, masks = [image.copy() for image in truth.images], []
    for image, labels in zip(images, truth.labels, strict=True):
        rows, columns = np.nonzero(labels)
        mask = np.abs(np.arange(270)[:, None] - np.median(rows)) < 12
        masks.append(mask & (np.arange(270) <= int(np.median(columns))))
        image[masks[-1]] = image[labels == labels[labels > 0][0]].mean(axis=0)
    shown = ((images, None), (images, masks), (truth.images, None))
    counts = [counted(truth, *one) for one in shown]
    without, known, clean = ((one["wrong"] + one["extra"] + one["elsewhere"]).sum() for one in counts)
    assert known < 0.2 * without
    assert clean < 0.2 * without
    pose = TRACKER.detect(images, masks).object_pose
    assert np.linalg.norm(pose.position - truth.position) < 1e-3


def test_hidden_pixels_are_left_out_of_the_counts_and_edges_below_a_mask_or_beside_it_not_expected(truth):
    # Down to the middle of the object, and all but the object and the pixels beside it.
    rows = [int(np.nonzero(labels)[0].mean()) for labels in truth.labels]
    upper = [np.tile(np.arange(270)[:, None] < row, (1, 270)) for row in rows]
    around = [cv2.dilate((labels > 0).astype(np.uint8), np.ones((3, 3))) == 0 for labels in truth.labels]
    all_seen, half_seen = (counted(truth, truth.images, one) for one in (None, upper))
    for name in ("predicted", "agree", "missing"):
        assert (half_seen[name] <= all_seen[name]).all()
    share = half_seen["predicted"] / all_seen["predicted"]
    assert ((share > 0.2) & (share < 0.8)).all()
    assert (half_seen["agree"] > 0.85 * half_seen["predicted"]).all()
    assert (half_seen["missing"] + half_seen["wrong"] + half_seen["agree"] == half_seen["predicted"]).all()
    sights = (labelled(truth.images, hidden) for hidden in (None, upper, around))
    whole, *parts = (TRACKER._estimator.refiner(one, truth.rotation, truth.position) for one in sights)
    for part in parts:
        share = part.cameras["expected"] / whole.cameras["expected"]
        assert ((share > 0.1) & (share < 0.8)).all()
        assert np.linalg.norm(part.position - truth.position) < 1e-3


def test_a_mask_of_all_hides_the_object_from_its_camera_and_at_its_moment_only(truth):
    for masks in (None, [np.ones(SHAPE, bool)] * 3):
        TRACKER.reset()
        TRACKER.update(truth.images, 0.0)
        TRACKER.update(truth.images, 0.1, masks)
        after = TRACKER.update(truth.images, 0.2)
        assert np.linalg.norm(after.object_pose.position - truth.position) < 1e-3
    # What is hidden altogether is not found.
    answer = TRACKER.detect(truth.images, [np.ones(SHAPE, bool)] * 3)
    assert answer.object_pose is None
    assert answer.status == "no_object_colors"
    one = TRACKER.detect(truth.images, [None, np.ones(SHAPE, bool), None])
    pair = TRACKER.detect([truth.images[0], None, truth.images[2]])
    assert np.linalg.norm(one.object_pose.position - pair.object_pose.position) < 1e-3


@pytest.mark.parametrize("c", range(3))
def test_a_camera_from_which_the_object_is_hidden_says_nothing_of_its_wear(truth, c):
    refine, start = TRACKER._estimator.refiner, (truth.rotation, truth.position)
    others = [np.ones(SHAPE, bool) if k != c else None for k in range(3)]
    hidden = refine(labelled(truth.images, others), *start)
    alone = refine(labelled([truth.images[k] if k == c else None for k in range(3)], None), *start)
    # A camera by itself sees the depth so poorly that the refinements may end where wear seems different.
    np.testing.assert_allclose(np.diag(hidden.covariance), np.diag(alone.covariance), rtol=0.3)


@pytest.mark.parametrize(
    ("hidden", "says"),
    [
        (np.zeros(SHAPE, bool), r"hidden: found bool of shape \(270, 270\), expected a mask"),
        ([None, None], "hidden: found 2, expected a mask .* camera60, camera180, camera300"),
        ([None, None, np.zeros(SHAPE, np.uint8)], "hidden of camera300: found uint8 .*, expected bool"),
        ([np.zeros((270, 540), bool), None, None], r"camera60: found bool of shape \(270, 540\)"),
        ([None, "mask.png", None], "hidden of camera180: found 'mask.png'"),
        ({"camera60": None}, "hidden by camera: missing camera180, camera300"),
    ],
)
def test_what_are_no_masks_is_named(truth, hidden, says):
    for call in (TRACKER.detect, lambda images, hidden: TRACKER.update(images, 0.0, hidden)):
        TRACKER.reset()
        with pytest.raises(ImageError, match=says):
            call(truth.images, hidden)
