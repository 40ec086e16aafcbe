from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from tests.helpers import RIG, exposed, look_at, veiled
from tests.helpers.dice_scenes import EDGE, dice_at, painted
from tracker.calibration.by_object.table import moved
from tracker.calibration.rig import CameraRig
from tracker.color_learning.fit import FitOptions, combine, image_histograms
from tracker.color_learning.labelled import LabelledImage, intersection_over_union
from tracker.errors import ImageError, TaskError
from tracker.geometry import so3
from tracker.geometry.arena import Arena
from tracker.tasks.rearrange_dice import locate, segment_dice

FINE = RIG.resized(540, 540)
DICE = dice_at([(-0.05, 0.03), (0.06, 0.08), (0.02, -0.09), (0.042, -0.09), (-0.11, -0.04)], turn=0.4)


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
    assert intersection_over_union(mask, truth)[255] > 0.9
    inside = cv2.erode(truth, np.ones((3, 3), np.uint8)) > 0
    assert mask[inside].all()


@pytest.mark.parametrize("gains", [(1.2, 1.0, 0.8), (0.8, 0.9, 1.2), (0.6, 0.6, 0.6), (1.3, 1.3, 1.3)])
def test_light_of_another_colour_or_brightness_hardly_changes_the_mask(view, gains):
    image, truth = view
    mask = segment_dice(exposed(image, gains))
    assert intersection_over_union(mask, truth)[255] > 0.88


@pytest.mark.parametrize("change", [lambda image: veiled(image, 90), lambda image: exposed(image, 0.2)])
@pytest.mark.parametrize("away", [1.0, 1.5])
def test_colours_of_images_as_they_are_find_the_dice_in_images_as_they_are(away, change):
    image, truth = painted(replace(RIG[0], camera_from_world=look_at(away * RIG[0].position)), DICE)
    image = change(image)
    taught = LabelledImage("as it is", image, np.where(truth > 0, np.uint8(3), np.uint8(0)))
    own = image_histograms(taught, FitOptions(draws=5000), normalise=False)
    mask = segment_dice(image, combine([own], normalise=False))
    assert intersection_over_union(mask, truth)[255] > 0.9


@pytest.mark.parametrize(("color", "gains"), [((190, 195, 200), 1.0), (255, (1.0, 1.4, 1.9))])
def test_a_light_finger_before_a_die_is_no_die_even_if_it_is_clipped(color, gains, view):
    image, truth = (one.copy() for one in view)
    places = np.argwhere(truth > 0)[:, ::-1]
    tip = places[np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1))].tolist()
    finger = np.zeros_like(truth)
    cv2.line(finger, tip, (tip[0], 0), 255, 9)
    image[finger > 0] = color
    truth[finger > 0] = 0
    mask = segment_dice(exposed(cv2.GaussianBlur(image, (0, 0), 0.6), gains))
    core = cv2.erode(finger, np.ones((3, 3), np.uint8)) > 0
    assert not mask[core].any()
    assert intersection_over_union(mask, truth)[255] > 0.88


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


def test_both_resolutions_give_the_same_mask(view):
    (fine, _), (coarse, truth) = painted(FINE[0], DICE), view
    reduced = 255 * (cv2.resize(segment_dice(fine), (270, 270), interpolation=cv2.INTER_AREA) >= 128)
    assert intersection_over_union(reduced, truth)[255] > 0.9
    assert intersection_over_union(reduced, segment_dice(coarse))[255] > 0.88


@pytest.mark.parametrize("level", [0, 90, 255])
def test_an_image_without_dice_has_an_empty_mask(level, rng):
    assert not segment_dice(exposed(level + rng.normal(0, 3, (270, 270, 3)))).any()


@pytest.mark.parametrize(
    ("bad", "words"),
    [(np.zeros((270, 270), np.uint8), "shape"), (np.zeros((270, 270, 3)), "float64"), ([[1]], "list")],
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


SCATTERED = dice_at(
    [(0.0, 0.01), (-0.09, 0.05), (0.06, 0.08), (0.02, -0.09), (0.1, -0.03), (-0.04, -0.05), (-0.11, -0.06)],
    0.37,
)
CROWD = dice_at([(0.02 + EDGE * k, 0.022 * row) for row in range(3) for k in range(4)])
STACK = dice_at([(0.03, 0.02), (0.033, 0.018, EDGE), (-0.06, 0.04), (-0.04, 0.05)], 0.2)


def views(dice: np.ndarray, rig: CameraRig = RIG) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Images and masks of every camera."""
    pairs = [painted(camera, dice) for camera in rig]
    return [image for image, _ in pairs], [mask for _, mask in pairs]


@pytest.fixture(scope="module")
def scattered() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Images and masks of dice that lie apart, which tests leave as they are."""
    return views(SCATTERED)


def centers(dice: np.ndarray) -> np.ndarray:
    return dice[:, :3] + np.array([0, 0, EDGE / 2])


def positions(found) -> np.ndarray:
    return np.array([die.position for die in found]).reshape(-1, 3)


def distances(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Of pairs; all must have a partner."""
    assert len(found) == len(true)
    table = np.linalg.norm(found[:, None] - true, axis=2)
    return table[linear_sum_assignment(table)]


@pytest.mark.parametrize(
    ("dice", "rig", "alone"),
    [(SCATTERED, RIG, True), (CROWD, RIG, False), (STACK, RIG, True), (SCATTERED, FINE, False)],
    ids=["scattered", "crowd", "stack", "larger images"],
)
def test_all_dice_are_found_where_they_are_by_masks_alone_unless_they_crowd(dice, rig, alone):
    images, masks = views(dice, rig)
    for given in (images, None) if alone else (images,):
        assert distances(positions(locate(rig, masks, given)), centers(dice)).max() < 1.5e-3


def test_yaws_are_those_of_the_dice(scattered):
    images, masks = scattered
    for die in locate(RIG, masks, images):
        nearest = np.argmin(np.linalg.norm(centers(SCATTERED) - die.position, axis=1))
        turn = (die.yaw - SCATTERED[nearest, 3] + np.pi / 4) % (np.pi / 2) - np.pi / 4
        assert abs(turn) < np.radians(6)
        assert -np.pi / 4 <= die.yaw <= np.pi / 4


def test_the_surest_come_first_and_say_how_sure():
    images, masks = views(CROWD)
    found = locate(RIG, masks, images)
    assert [die.gain for die in found] == sorted((die.gain for die in found), reverse=True)
    assert all(0.5 <= die.probability <= 1 for die in found)
    assert not found[0].position.flags.writeable
    assert len(locate(RIG, masks, images, most=3)) == 3
    assert locate(RIG, [np.zeros((270, 270), np.uint8)] * 3) == ()


def test_masks_of_every_kind_and_missing_images_give_the_same_bits_and_stay_as_they_were(scattered):
    masks = scattered[1]
    before = [mask.copy() for mask in masks]
    expected = locate(RIG, masks)
    for others in (masks, [mask // 255 for mask in masks], [mask > 0 for mask in masks]):
        np.testing.assert_array_equal(positions(locate(RIG, others)), positions(expected))
    without = locate(RIG, masks, [None] * 3)
    assert [die.probability for die in without] == [die.probability for die in expected]
    np.testing.assert_array_equal(masks, before)


def test_an_image_without_a_mask_changes_nothing(scattered):
    images, masks = scattered
    expected, found = (locate(RIG, [*masks[:2], None], given) for given in (None, [None, None, images[2]]))
    assert [die.probability for die in found] == [die.probability for die in expected]
    assert positions(found).tolist() == positions(expected).tolist()


def test_the_order_of_the_cameras_does_not_matter(scattered):
    images, masks = scattered
    order = (2, 0, 1)
    turned = CameraRig(tuple(RIG[c] for c in order))
    found = locate(turned, [masks[c] for c in order], [images[c] for c in order])
    assert distances(positions(found), positions(locate(RIG, masks, images))).max() < 1e-3


def test_a_camera_without_an_image_or_behind_a_finger_only_costs_accuracy(scattered):
    images, masks = scattered
    expected = centers(SCATTERED)
    found = locate(RIG, [masks[0], None, masks[2]], [images[0], None, images[2]])
    assert distances(positions(found), expected).max() < 4e-3
    pair = CameraRig((RIG[0], RIG[2]))
    alone = locate(pair, [masks[0], masks[2]], [images[0], images[2]])
    np.testing.assert_allclose(positions(alone), positions(found), atol=1e-9)
    covered = masks[0].copy()
    covered[:, :140] = 0
    found = locate(RIG, [covered, *masks[1:]], images)
    assert distances(positions(found), expected).max() < 4e-3


@pytest.mark.parametrize(("lift", "yaw"), [(-0.006, 0.0), (0.004, 0.0), (0.0, 1.1)])
def test_the_dice_move_with_the_world(lift, yaw, scattered):
    images, masks = scattered
    motion = so3.transform(so3.exp([0, 0, yaw]), [0, 0, lift])
    rig = moved(RIG, np.linalg.inv(motion))
    expected = centers(SCATTERED) @ motion[:3, :3].T + motion[:3, 3]
    assert distances(positions(locate(rig, masks, images)), expected).max() < 2e-3


def test_an_arena_is_refused_where_no_goal_is(scattered):
    masks = scattered[1]
    for table in (None, -0.011):
        same = positions(locate(replace(RIG, arena=Arena(table=table)), masks))
        np.testing.assert_array_equal(same, positions(locate(RIG, masks)))
    for arena, found in ((Arena(table=0.012), "table 0.012 m"), (Arena((0.0, 0.1)), r"centre \(0.0, 0.1")):
        with pytest.raises(TaskError, match=f"arena: found .*{found}.*, expected"):
            locate(replace(RIG, arena=arena), masks)


@pytest.mark.parametrize(
    ("masks", "images", "message"),
    [
        (lambda m: m[:2], lambda i: None, "found 2, expected one of each of camera60, camera180, camera300"),
        (lambda m: [m[0], m[1][:100], m[2]], lambda i: None, r"camera180: found shape \(100, 270\)"),
        (lambda m: [m[0], m[1], m[2] // 255 * 7], lambda i: None, "camera300.*found the values 0, 7"),
        (lambda m: m, lambda i: i[:1], "images: found 1"),
        (lambda m: m, lambda i: [i[0][:100], *i[1:]], "camera60: 270×100 px, but its .* 270×270"),
    ],
)
def test_what_does_not_belong_to_the_rig_is_refused(masks, images, message, scattered):
    with pytest.raises((TaskError, ImageError), match=message):
        locate(RIG, masks(scattered[1]), images(scattered[0]))
