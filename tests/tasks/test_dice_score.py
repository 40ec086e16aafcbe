import itertools

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tests.helpers import RIG, make_camera, opencv_pixels
from tracker import Camera
from tracker.calibration.rig import CameraRig
from tracker.errors import TaskError
from tracker.geometry import so3
from tracker.tasks import rearrange_dice as dice

CORNERS = np.array(list(itertools.product((-0.013, 0.013), repeat=3)))
QUADS = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]


def free_goal(rng: np.random.Generator, count: int = 25) -> np.ndarray:
    """Places off the grid and above the floor."""
    angle, radius = rng.uniform(0, 2 * np.pi, count), 0.17 * np.sqrt(rng.uniform(size=count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.011, 0.1, count)], axis=1)


@pytest.mark.parametrize("size", [270, 540])
def test_goal_masks_are_the_faces_between_truncated_corners(size, rng):
    for goal in [*(dice.sample_goal(rng) for _ in range(10)), *(free_goal(rng) for _ in range(10))]:
        rig = RIG.resized(size, size)
        for mask, camera in zip(dice.goal_masks(rig, goal), rig, strict=True):
            expected = np.zeros((size, size), np.uint8)
            for place in goal:
                corners = np.trunc(opencv_pixels(camera, place + CORNERS)).astype(np.int32)
                for quad in QUADS:
                    cv2.fillConvexPoly(expected, corners[list(quad)], 255)
            np.testing.assert_array_equal(mask, expected)


def chords(camera, pixels, place) -> np.ndarray:
    """Length [m] that the rays of pixels (N, 2) run in the box at a place, by sampling them."""
    normalized = cv2.undistortPoints(pixels[:, None].astype(float), camera.matrix, camera.distortion)[:, 0]
    rays = np.concatenate([normalized, np.ones((len(normalized), 1))], axis=1)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ camera.camera_from_world[:3, :3]
    middle = np.linalg.norm(place - camera.position)
    depths = np.arange(middle - 0.03, middle + 0.03, 1e-4)
    points = camera.position + depths[:, None] * rays[:, None]
    return (np.abs(points - place) <= 0.013).all(axis=2).sum(axis=1) * 1e-4


def test_an_exact_pixel_is_set_where_its_ray_meets_a_box(rng):
    for camera, place in zip(RIG, free_goal(rng, 3), strict=True):
        (mask,) = dice.goal_masks([camera], [place], exact=True)
        column, row = opencv_pixels(camera, [place])[0].astype(int)
        around = np.stack(np.meshgrid(np.arange(column - 22, column + 23), np.arange(row - 22, row + 23)), -1)
        pixels = around.reshape(-1, 2)
        length = chords(camera, pixels, place)
        found = mask[pixels[:, 1], pixels[:, 0]] == 255
        assert found[length > 1e-3].all()
        assert np.count_nonzero(found[length == 0]) <= 2  # rays that graze an edge, between two samples
        assert np.count_nonzero(mask) == found.sum() > 100


def test_a_ray_in_the_plane_of_a_boxs_face_meets_it():
    matrix = np.array([[300.0, 0, 135], [0, 300, 135], [0, 0, 1]])
    down = Camera("down", 271, 271, matrix, np.zeros(5), so3.transform(np.diag([1.0, -1, -1]), [0, 0, 0.5]))
    for x, y in ((0.013, 0.0), (0.0, -0.013)):
        assert dice.goal_masks([down], [[x, y, 0.013]], exact=True)[0][135, 135]


def test_areas_are_those_of_all_places_in_any_order_and_truncated_ones_hold_the_exact_but_for_a_seam(rng):
    goal = dice.sample_goal(rng)
    areas = [dice.goal_masks(RIG, goal, exact=exact) for exact in (False, True)]
    for exact, together in enumerate(areas):
        shuffled = dice.goal_masks(RIG, rng.permutation(goal), exact=bool(exact))
        single = [dice.goal_masks(RIG, [place], exact=bool(exact)) for place in goal]
        np.testing.assert_array_equal(together, shuffled)
        np.testing.assert_array_equal(together, np.max(single, axis=0))
    for wide, exact in zip(*areas, strict=True):
        assert np.count_nonzero(exact & ~wide) < 0.02 * np.count_nonzero(exact)
        assert not (exact & ~cv2.dilate(wide, np.ones((3, 3), np.uint8))).any()
        assert not (wide & ~cv2.dilate(exact, np.ones((5, 5), np.uint8))).any()


@pytest.mark.parametrize("exact", [False, True])
def test_masks_are_new_images_of_the_cameras_sizes(exact):
    rig = CameraRig((RIG[0], RIG[1].resized(720, 540), RIG[2].cropped(100, 0, 1, 200)))
    masks = dice.goal_masks(rig, dice.sample_goal(0), exact=exact)
    assert [mask.shape for mask in masks] == [(270, 270), (540, 720), (200, 1)]
    for mask in masks:
        assert mask.dtype == np.uint8
        assert mask.flags.c_contiguous
        assert set(np.unique(mask)) <= {0, 255}


@pytest.mark.parametrize("exact", [False, True])
def test_a_place_that_no_camera_sees_sets_no_pixel_and_one_around_it_all(exact):
    camera = make_camera()
    forward, right = camera.camera_from_world[2, :3], camera.camera_from_world[0, :3]
    beside = (right, right + 0.1 * forward, 3 * right + forward, [0, 0, 9e99])
    for away in (-forward, -5 * forward + right, *beside):
        (mask,) = dice.goal_masks([camera], [camera.position + away], exact=exact)
        assert not mask.any()
    assert not np.any(dice.goal_masks(RIG, [], exact=exact))
    for x in (0, 0.005, 0.013, 0.02):
        (mask,) = dice.goal_masks([camera], [camera.position + x], exact=exact)
        assert not exact or x > 0.005 or mask.all()


KINDS = st.sampled_from([lambda m: m, lambda m: m.astype(np.uint8), lambda m: 255 * m.astype(np.uint8)])
MASKS = npst.arrays(np.bool_, st.just((2, 3, 5, 4)), elements=st.booleans())


@given(MASKS, KINDS, KINDS, st.booleans())
def test_the_error_counts_dice_pixels_outside_the_goal(masks, goal_kind, dice_kind, stacked):
    goals, seen = goal_kind(masks[0]), dice_kind(masks[1])
    expected = [np.count_nonzero(s & ~g) for g, s in zip(*masks, strict=True)]
    if not stacked:
        goals, seen = list(goals), tuple(seen)
    assert dice.error_per_camera(goals, seen) == tuple(expected)
    assert dice.error(goals, seen) == sum(expected)
    assert dice.reward(goals, seen) == -sum(expected)
    assert isinstance(dice.error(goals, seen), int)
    # A camera without an image does not count.
    without = [None, *seen[1:]]
    assert dice.error_per_camera(goals, without) == (None, *expected[1:])
    assert dice.error(goals, without) == sum(expected[1:])


def test_masks_of_any_layout_and_type_are_taken_and_not_changed(rng):
    goal, seen = rng.random((2, 60, 80)) < 0.4
    expected = np.count_nonzero(seen & ~goal)
    goal.flags.writeable = False
    for kind in (bool, np.int64, np.uint16, np.int8):
        big = np.zeros((120, 80, 3), kind)
        big[::-2, :, 1] = seen
        for area in (goal.astype(kind), np.asfortranarray(goal)):
            assert dice.error([area], [big[::-2, :, 1]]) == expected
        np.testing.assert_array_equal(big[::-2, :, 1], seen)


MASK = np.zeros((4, 5), np.uint8)


@pytest.mark.parametrize(
    ("goals", "seen", "message"),
    [
        ([MASK], [MASK, MASK], "found 1 of the goal and 2 of dice"),
        ([], [], "found 0 of the goal and 0 of dice, expected one of each"),
        ([MASK, MASK], [MASK, MASK[:3]], r"dice mask 1: found shape \(3, 5\), expected the goal's \(4, 5\)"),
        (MASK, MASK, r"goal mask 0: found shape \(5,\), expected \(height, width\)"),
        ([MASK[None]], [MASK[None]], "goal mask 0: found shape"),
        ([MASK[:0]], [MASK[:0]], "goal mask 0: found shape"),
        ([MASK], [MASK.astype(float)], "dice mask 0: found type float64, expected bool or whole numbers"),
        ([MASK.astype(int) - 1], [MASK], "goal mask 0: found the values -1"),
        ([MASK, MASK], [None, None], "dice masks: found None for all, expected at least one"),
        ([MASK], [np.full((4, 5), None)], "dice mask 0: found type object"),
        ([None], [MASK], "goal mask 0: found type object"),
        ([MASK], [[[0, 1], [0]]], "dice mask 0: found type object"),
        ([MASK], [[*MASK[:3], MASK[0] + 1, MASK[0] + 255]], "found the values 0, 1, 255, expected"),
        ([np.arange(20, dtype=np.uint8).reshape(4, 5)], [MASK], "found the values 0, 1, 2, 3, …, expected"),
    ],
)
def test_masks_that_are_none_or_do_not_belong_together_are_refused(goals, seen, message):
    with pytest.raises(TaskError, match=message):
        dice.error(goals, seen)


@given(npst.arrays(np.uint8, (3, 4), elements=st.sampled_from([0, 0, 0, 1, 2, 128, 254, 255])))
def test_only_masks_of_two_values_are_taken(mask):
    if set(mask.ravel().tolist()) in ({0}, {1}, {255}, {0, 1}, {0, 255}):
        assert dice.error([np.zeros_like(mask)], [mask]) == np.count_nonzero(mask)
    else:
        with pytest.raises(TaskError, match="dice mask 0: found the value"):
            dice.error([np.zeros_like(mask)], [mask])


@given(st.integers(0, 10**6), st.integers(0, 30), st.integers(0, 30))
def test_the_assignment_pairs_as_many_as_there_can_be(seed, places, count):
    rng = np.random.default_rng(seed)
    goal, positions = rng.uniform(-0.2, 0.2, (places, 3)), rng.uniform(-0.2, 0.2, (count, 3))
    found = dice.assign(goal, positions)
    pairs = found.pairs
    assert len(pairs) == min(places, count) == len({die for _, die in pairs})
    assert found.die.shape == found.distance.shape == (places,)
    for place, die in pairs:
        assert found.distance[place] == pytest.approx(np.linalg.norm(goal[place] - positions[die]))
    without = np.setdiff1d(np.arange(places), [place for place, _ in pairs])
    assert (found.die[without] == -1).all()
    assert np.isnan(found.distance[without]).all()
    assert found.total == pytest.approx(sum(found.distance[place] for place, _ in pairs))


@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(0, 5))
def test_no_other_assignment_is_shorter(seed, places, count):
    rng = np.random.default_rng(seed)
    goal, positions = rng.uniform(-0.2, 0.2, (places, 3)), rng.uniform(-0.2, 0.2, (count, 3))
    few, many = sorted((goal, positions), key=len)
    distances = np.linalg.norm(few[:, None] - many, axis=2)
    totals = [distances[range(len(few)), p].sum() for p in itertools.permutations(range(len(many)), len(few))]
    assert dice.assign(goal, positions).total == pytest.approx(min(totals))


def test_dice_moved_and_shuffled_a_little_find_their_places(rng):
    goal = dice.sample_goal(rng)
    order = rng.permutation(25)
    shift = so3.exp(rng.normal(size=3)) @ [0, 0, 0.003]
    found = dice.assign(goal, (goal + shift)[order])
    np.testing.assert_array_equal(order[found.die], np.arange(25))
    np.testing.assert_allclose(found.distance, 0.003)
    assert found.count_within() == 25
    assert found.count_within(0.002) == 0
    with pytest.raises(TaskError, match="distance: found 'far', expected a finite distance"):
        found.count_within("far")
    with pytest.raises(ValueError, match="read-only"):
        found.die[0] = 3
