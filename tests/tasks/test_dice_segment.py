"""Laws of the dice's mask in one image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.dice_scenes import RIG, dice_at, painted
from tracker.errors import ImageError
from tracker.tasks.rearrange_dice import segment_dice

DICE = dice_at([(-0.05, 0.03), (0.06, 0.08), (0.02, -0.09), (0.042, -0.09), (-0.11, -0.04)], turn=0.4)


def overlap(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union."""
    a, b = first > 0, second > 0
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


@pytest.fixture(scope="module")
def view() -> tuple[np.ndarray, np.ndarray]:
    """An image with dice on a dark table before a light wall, and the true mask."""
    return painted(RIG[0], DICE)


def test_the_mask_covers_the_dice_with_their_pips_and_nothing_else(view):
    image, truth = view
    before = image.copy()
    mask = segment_dice(image)
    np.testing.assert_array_equal(segment_dice(image), mask)
    np.testing.assert_array_equal(image, before)
    assert mask.dtype == np.uint8
    assert set(np.unique(mask)) == {0, 255}
    assert overlap(mask, truth) > 0.9
    inside = cv2.erode(truth, np.ones((3, 3), np.uint8)) > 0
    assert mask[inside].all()


@pytest.mark.parametrize("gains", [(1.2, 1.0, 0.8), (0.8, 0.9, 1.2), (0.6, 0.6, 0.6), (1.3, 1.3, 1.3)])
def test_light_of_another_colour_or_brightness_hardly_changes_the_mask(view, gains):
    image, truth = view
    lit = np.clip(np.rint(image * np.array(gains)), 0, 255).astype(np.uint8)
    assert overlap(segment_dice(lit), truth) > 0.88


def test_a_light_finger_before_a_die_is_no_die(view):
    image, truth = view
    image, truth = image.copy(), truth.copy()
    middle = np.argwhere(truth > 0).mean(axis=0)[::-1]
    rows, columns = np.nonzero(truth)
    nearest = np.argmin(np.hypot(columns - middle[0], rows - middle[1]))
    tip = int(columns[nearest]), int(rows[nearest])
    finger = np.zeros_like(truth)
    cv2.line(finger, tip, (tip[0], 0), 255, 9)
    image[finger > 0] = (190, 195, 200)
    truth[finger > 0] = 0
    mask = segment_dice(cv2.GaussianBlur(image, (0, 0), 0.6))
    core = cv2.erode(finger, np.ones((3, 3), np.uint8)) > 0
    assert not mask[core].any()
    assert overlap(mask, truth) > 0.88


def test_dark_blue_paint_on_the_table_is_no_die(view):
    image, truth = view
    image = image.copy()
    free = cv2.distanceTransform((truth == 0).astype(np.uint8), cv2.DIST_L2, 3)
    free[:100] = free[180:] = free[:, :90] = free[:, 180:] = 0
    j, i = np.unravel_index(np.argmax(free), free.shape)
    for dx, dy in ((7, 2), (2, 7)):
        image[j - dy : j + dy + 1, i - dx : i + dx + 1] = (100, 45, 18)
    mask = segment_dice(cv2.GaussianBlur(image, (0, 0), 0.6))
    assert not mask[j - 7 : j + 8, i - 7 : i + 8].any()


def test_both_resolutions_give_the_same_mask():
    fine, _ = painted(RIG[0].resized(540, 540), DICE)
    coarse, truth = painted(RIG[0], DICE)
    reduced = cv2.resize(segment_dice(fine), (270, 270), interpolation=cv2.INTER_AREA) >= 128
    assert overlap(reduced, truth) > 0.9
    assert overlap(reduced, segment_dice(coarse)) > 0.88


@pytest.mark.parametrize("level", [0, 90, 255])
def test_an_image_without_dice_has_an_empty_mask(level, rng):
    image = np.clip(np.rint(level + rng.normal(0, 3, (270, 270, 3))), 0, 255).astype(np.uint8)
    assert not segment_dice(image).any()


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (np.zeros((270, 270), np.uint8), "shape"),
        (np.zeros((270, 270, 3)), "float64"),
        ([[1]], "list"),
    ],
)
def test_anything_but_an_image_is_refused(bad, words):
    with pytest.raises(ImageError, match=words):
        segment_dice(bad)


def test_the_recorded_dice_are_found(real):
    image = cv2.imread(str(real / "dice" / "test_image.png"))
    truth = cv2.imread(str(real / "dice" / "test_mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    mask = segment_dice(image) > 0
    right = np.count_nonzero(mask & truth)
    assert right / np.count_nonzero(mask) >= 0.99
    assert right / np.count_nonzero(truth) >= 0.85
