import cv2
import numpy as np
import pytest

from tests.helpers import opencv_pixels
from tests.viz.test_overlays import GAP, black
from tracker.calibration.rig import CameraRig
from tracker.tasks import rearrange_dice as dice
from tracker.viz import dice_overlay, goal_picture
from tracker.viz.dice import DIE, INSIDE, OUTSIDE


def square(rig: CameraRig, left: int, right: int) -> list[np.ndarray]:
    """Masks with columns `left` to `right` of rows 100 to 140 set."""
    masks = [np.zeros((camera.height, camera.width), np.uint8) for camera in rig]
    for mask in masks:
        mask[100:140, left:right] = 255
    return masks


def assert_hue(found, color):
    """Check that a colour is another but for its brightness."""
    np.testing.assert_allclose(found / np.max(found), np.array(color) / max(color), atol=0.02)


def test_views_above_a_caption_colour_dice_by_whether_they_are_in_the_goal(rig):
    goals, seen = square(rig, 100, 140), square(rig, 120, 160)
    picture = dice_overlay(black(rig), rig, goals, seen)
    assert 540 + 60 < picture.shape[0] < 540 + 300
    for index in range(3):
        panel = picture[:540, index * (540 + GAP) :]
        row = 2 * 120
        assert_hue(panel[row, 2 * 130], INSIDE)
        assert_hue(panel[row, 2 * 150], OUTSIDE)
        free = panel[row, 2 * 110]
        assert 0 < free.max() < 60
        assert free.min() == free.max()
        assert not panel[row, [2 * 90, 2 * 170]].any()


def test_the_goals_border_is_drawn_where_its_pixels_end(rig):
    goals, nothing = square(rig, 100, 140), square(rig, 0, 0)
    panel = dice_overlay(black(rig), rig, goals, nothing)[:540, :540].min(axis=2)
    # The outer border of pixel u is at u + ½, of the doubled image at 2u + 1½.
    for places, before in zip(np.nonzero(panel[70:] > 128), (70, 0), strict=True):
        assert np.abs(np.array([places.min(), places.max()]) + before - [199.5, 279.5]).max() <= 1.5
    assert (panel[240, 197:203].max(), panel[240, 277:283].max()) > (200, 200)


def test_all_kinds_of_masks_give_the_same_picture(rig):
    goals, seen = square(rig, 100, 140), square(rig, 120, 160)
    expected = dice_overlay(black(rig), rig, goals, seen)
    for kind in (lambda m: m > 0, lambda m: m // 255):
        found = dice_overlay(black(rig), rig, [kind(m) for m in goals], [kind(m) for m in seen])
        np.testing.assert_array_equal(found, expected)


def test_without_a_goal_all_dice_have_one_colour_and_there_is_no_error(rig):
    picture = dice_overlay(black(rig), rig, None, square(rig, 120, 160))
    assert_hue(picture[240, 300], INSIDE)
    assert not picture[240, 220].any()
    other = dice_overlay(black(rig), rig, square(rig, 0, 270), square(rig, 120, 160))
    assert (picture[540:] != other[540 : picture.shape[0]]).any()


def test_the_caption_tells_the_error_the_dice_that_are_placed_and_the_title(rig):
    goal, goals, seen = dice.sample_goal(0), square(rig, 100, 140), square(rig, 120, 140)
    moved = goal.copy()
    moved[:1] += 0.01
    given = [(seen, goal, "t"), (square(rig, 120, 141), goal, "t"), (seen, moved, "t"), (seen, goal, "u")]
    plain, *others = (
        dice_overlay(black(rig), rig, goals, masks, positions=at, assignment=dice.assign(goal, at), title=to)
        for masks, at, to in given
    )
    for other in others:
        assert (plain[540:] != other[540:]).any()


def test_dice_found_are_dots_where_opencv_projects_them(rig):
    centers = np.array([[0.05, -0.02, 0.011], [-0.1, 0.06, 0.033]])
    picture = dice_overlay(black(rig), rig, None, square(rig, 0, 0), positions=centers)
    for index, camera in enumerate(rig):
        panel = picture[:540, index * (540 + GAP) : index * (540 + GAP) + 540].min(axis=2).astype(float)
        for column, row in 2 * opencv_pixels(camera, centers) + 0.5:
            left, top = round(column) - 10, round(row) - 10
            dot = panel[top : top + 21, left : left + 21]
            rows, columns = np.mgrid[top : top + 21, left : left + 21]
            assert dot.max() == 255
            assert abs((columns * dot).sum() / dot.sum() - column) < 0.15
            assert abs((rows * dot).sum() / dot.sum() - row) < 0.15


def test_dice_out_of_sight_are_no_dots(rig):
    camera = rig[0]
    one = CameraRig((camera,))
    behind = camera.position - 0.5 * camera.camera_from_world[2, :3]
    pictures = [
        dice_overlay(black(one), one, None, square(one, 0, 0), positions=positions)
        for positions in (np.empty((0, 3)), [behind], [behind + camera.camera_from_world[0, :3]])
    ]
    for picture in pictures[1:]:
        np.testing.assert_array_equal(picture[:540], pictures[0][:540])


def test_a_camera_without_an_image_has_an_empty_panel_and_does_not_count(rig):
    goals, seen = square(rig, 100, 140), square(rig, 120, 160)
    everything = dice_overlay(black(rig), rig, goals, seen)
    images, seen = [*black(rig)[:2], None], [*seen[:2], None]
    picture = dice_overlay(images, rig, goals, seen)
    last = slice(2 * (540 + GAP), None)
    assert (picture[:540, last] == picture[300, -1]).all(axis=2).mean() > 0.9
    assert (picture[540:] != everything[540:]).any()
    dice_overlay([None] * 3, rig, goals, [None] * 3)


def test_an_image_without_a_mask_of_dice_is_shown_as_it_is(rig, rng):
    images = [rng.integers(0, 256, image.shape, dtype=np.uint8) for image in black(rig)]
    picture = dice_overlay(images, rig, None, [None] * 3)
    expected = cv2.resize(images[0], (540, 540), interpolation=cv2.INTER_CUBIC)
    np.testing.assert_array_equal(picture[100:540, :540], expected[100:])


def at(picture: np.ndarray, x: float, y: float) -> np.ndarray:
    """The colour at a place [m] of a goal's picture, found from its square and its labels' width."""
    side = picture.shape[0] - 48
    scale = 38 / 0.022
    column, row = 48 + (side - 1) / 2 + scale * x, (side - 1) / 2 - scale * y
    return picture[round(row), round(column)].astype(int)


def test_a_goals_places_are_squares_with_x_to_the_right_and_y_upwards():
    goal = dice.sample_goal(0)
    picture = goal_picture(goal)
    assert picture.shape[0] == picture.shape[1]
    floor = at(picture, 0.19 - 0.001, 0.0)
    taken = {tuple(np.rint(place[:2] / 0.022).astype(int)) for place in goal}
    for x, y, _ in dice.cells():
        for dx, dy in ((0, 0), (0.008, 0.008), (-0.008, 0.008)):
            is_place = (round(x / 0.022), round(y / 0.022)) in taken
            color = at(picture, x + dx, y + dy)
            assert (color != floor).any() == is_place
            assert not is_place or color.argmax() == np.argmax(INSIDE)


def test_dice_are_squares_turned_by_their_yaw():
    straight, turned = (goal_picture([], [[0.05, 0.03, 0.011]], yaws=[yaw]) for yaw in (0.0, np.pi / 4))
    for picture in (straight, turned):
        assert at(picture, 0.05, 0.03).argmax() == np.argmax(DIE)
    assert at(straight, 0.05 + 0.0095, 0.03 + 0.0095).argmax() == np.argmax(DIE)
    floor = at(straight, 0.1, 0.1)
    np.testing.assert_array_equal(at(turned, 0.05 + 0.0095, 0.03 + 0.0095), floor)
    assert at(turned, 0.05, 0.03 + 0.0140).argmax() == np.argmax(DIE)
    np.testing.assert_array_equal(at(straight, 0.05, 0.03 + 0.0140), floor)


def test_a_line_goes_from_each_die_to_its_place():
    goal, positions = [[0.044, 0.066, 0.011]], [[-0.066, -0.11, 0.011]]
    picture = goal_picture(goal, positions, dice.assign(goal, positions).pairs)
    without = goal_picture(goal, positions)
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        x, y = (1 - share) * np.array(positions[0][:2]) + share * np.array(goal[0][:2])
        np.testing.assert_allclose(at(picture, x, y), OUTSIDE, atol=60)
        assert np.abs(at(without, x, y) - OUTSIDE).max() > 60


@pytest.mark.parametrize(("low", "high"), [(0.011, 0.033), (1.9, 5.0)])
def test_places_above_the_floor_are_marked_with_their_height_however_large(low, high):
    assert (goal_picture([[0.0, 0.0, low]]) != goal_picture([[0.0, 0.0, high]])).any()


def test_the_unit_of_marked_heights_stands_beside_the_number_of_places():
    corners = [goal_picture([[0.0, 0.0, z]])[:30, 500:] for z in (0.011, 0.033)]
    low, high = ((corner != corner[0, 0]).any(axis=2).sum() for corner in corners)
    assert high > 1.5 * low > 0


@pytest.mark.parametrize("far", [0.5, 7.0, 1e90])
def test_places_far_outside_do_not_disturb_the_picture(far):
    inside = dice.sample_goal(0)
    expected = goal_picture([*inside, [2.0, 2.0, 0.011]])
    np.testing.assert_array_equal(goal_picture([*inside, [far, -far, 0.011]]), expected)
