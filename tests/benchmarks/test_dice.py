import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from benchmarks.data.dice import DiceScene
from benchmarks.data.scenes import SIZE, rig
from benchmarks.judge.results import read_results
from benchmarks.measure.dice import recorded_row, time_rows
from benchmarks.score.dice import RIGHT, cross_pixels, judge_mask, judge_positions, visible_fractions
from tests.benchmarks.made_up import figures_of, printed_by
from tests.helpers import random_rotations
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.tasks.rearrange_dice import DIE_WIDTH

RIG = rig()
THROWN = {"group": "thrown", "object": "dice"}


def die(position, probability=0.9) -> SimpleNamespace:
    """What of a reported die is judged."""
    return SimpleNamespace(position=np.asarray(position, float), yaw=0.1, probability=probability)


def scene_of(positions, rotations, labels=None) -> DiceScene:
    images = (np.zeros((SIZE, SIZE, 3), np.uint8),) * 3
    labels = labels or (np.zeros((SIZE, SIZE), np.uint8),) * 3
    bars = np.empty((0, 3, 2))
    return DiceScene(4, images, labels, np.array(positions, float), np.array(rotations, float), bars)


def labels_of(positions, rotations) -> tuple[np.ndarray, ...]:
    """What a renderer would label of dice that do not hide each other: rays of pixels' centres meet them."""
    layers, pixels = [], np.indices((SIZE, SIZE))[::-1].reshape(2, -1).T
    for camera in RIG:
        labels, rays = np.zeros(len(pixels), np.uint8), camera.rays(pixels)
        for k, (position, rotation) in enumerate(zip(positions, rotations, strict=True)):
            start = (camera.position - position) @ rotation
            with np.errstate(divide="ignore"):
                ends = (np.array([-1, 1])[:, None, None] * DIE_WIDTH / 2 - start) / (rays @ rotation)
            labels[ends.min(axis=0).max(axis=1) <= ends.max(axis=0).min(axis=1)] = k + 1
        layers.append(labels.reshape(SIZE, SIZE))
    return tuple(layers)


def test_a_die_alone_is_wholly_visible(rng):
    positions = [[0.0, 0.0, 0.011], [0.1, -0.08, 0.011], [-0.12, 0.1, 0.03]]
    rotations = random_rotations(rng, 3)
    scene = scene_of(positions, rotations, labels_of(positions, rotations))
    np.testing.assert_allclose(visible_fractions(RIG.cameras, scene), 1.0, atol=0.02)


def test_what_is_hidden_counts_over_all_cameras_together():
    positions, rotations = [[0.0, 0.0, 0.011], [0.1, 0.0, 0.011]], [np.eye(3)] * 2
    labels = labels_of(positions, rotations)
    whole = sum(np.count_nonzero(layer == 1) for layer in labels)
    left = np.count_nonzero(labels[0] == 1)
    labels[1][:], labels[2][:] = 0, 0
    seen = visible_fractions(RIG.cameras, scene_of(positions, rotations, labels))
    assert seen[0] == pytest.approx(left / whole, abs=0.02)
    assert (seen < 0.6).all()
    positions[1][0] = 30.0  # out of view
    assert visible_fractions(RIG.cameras, scene_of(positions, rotations)).tolist() == [0.0, 0.0]


def test_the_cross_is_where_the_cameras_own_projection_has_it():
    bar = np.array([[-0.03, 0.03], [-0.004, 0.004], [0.0, 0.0002]])
    for camera in RIG:
        meets = cross_pixels(camera, bar[None])
        for reach, y in ((0.028, 0.0), (0.05, 0.012)):
            points = np.column_stack([np.linspace(-reach, reach, 9), np.full(9, y), np.zeros(9)])
            columns, rows = np.rint(camera.project(points)).astype(int).T
            assert (meets[rows, columns] == (y == 0)).all()
        assert not cross_pixels(camera, bar[None][:0]).any()


def test_as_many_dice_as_can_be_are_paired_and_those_that_are_left_over_are_invented():
    true = np.array([[0.0, 0.0, 0.011], [0.1, 0.0, 0.011]])
    found = [die([0.1, 0.001, 0.011]), die([0.1, 0.004, 0.011], 0.6), die([-0.1, 0.0, 0.011], 0.3)]
    answer = judge_positions(true, found)
    assert math.isnan(answer.error[0])
    assert answer.error[1] == pytest.approx(0.001)
    assert answer.right.tolist() == [True, False, False]
    assert answer.probability.tolist() == [0.9, 0.6, 0.3]
    # Distance is in space, and half an edge is near enough.
    for distance, right in ((RIGHT - 1e-6, True), (RIGHT + 1e-6, False)):
        assert judge_positions(np.zeros((1, 3)), [die([0.0, 0.0, distance])]).right.tolist() == [right]
    true = np.array([[0.0, 0.0, 0.0], [0.012, 0.0, 0.0]])
    # The first is nearest to the second true die, but the other is near no other: no pair is given up.
    answer = judge_positions(true, [die([0.009, 0.0, 0.0]), die([0.02, 0.0, 0.0])])
    assert answer.right.all()
    assert answer.error == pytest.approx([0.009, 0.008])


def test_nothing_reported_and_nothing_true_are_answers_too():
    for count in (0, 3):
        answer = judge_positions(np.zeros((count, 3)) + np.arange(count)[:, None], [])
        assert np.isnan(answer.error).all()
        assert answer.error.shape == (count,)
        assert answer.right.shape == (0,)
    assert not judge_positions(np.zeros((0, 3)), [die(np.zeros(3))]).right.any()


def test_pixels_of_masks_are_counted_once_and_where_they_belong():
    labels, image = np.zeros((40, 40), np.uint8), np.full((40, 40, 3), 90, np.uint8)
    cross = np.zeros((40, 40), bool)
    labels[5:15, 5:15] = 3
    cross[8:12, 10:30] = True
    image[cross] = (100, 50, 20)
    image[8:12, 28:] = 90  # hidden
    mask = np.zeros((40, 40), np.uint8)
    mask[5:15, 5:17] = 255  # two columns too many
    mask[8:12, 20:24] = 255  # of the cross
    mask[30:32, 30:33] = 255
    view = judge_mask(mask, image, labels, cross)
    # Of the cross columns 18 to 27: more than 3 px from column 14, the die's last.
    expected = {"true": 100, "found": 120 + 16 + 6, "both": 100, "cross": 40, "cross_taken": 16}
    assert view == expected | {"elsewhere": 6, "total": 1600}


def test_figures_are_of_all_pixels_together_and_of_dice_by_what_is_seen_of_them():
    keys = ("true", "found", "both", "cross", "cross_taken", "elsewhere", "total")
    counts = (10, 10, 10, 0, 0, 0, 100), (90, 100, 60, 8, 2, 10, 100)
    views = [THROWN | dict(zip(keys, one, strict=True)) for one in counts]
    (row,) = figures_of(views, "dice, masks")
    found = [row[key] for key in ("iou", "precision", "recall", "cross_taken", "elsewhere")]
    assert found == pytest.approx([70 / 140, 70 / 110, 0.7, 25, 5])
    dice = [(1.0, 1.0), (0.4, 3.0), (0.35, np.nan), (0.1, np.nan)]
    seen, hidden = figures_of([THROWN | {"visible": v, "mm": mm} for v, mm in dice], "dice, positions")
    assert (seen["n"], hidden["n"], hidden["found"]) == (3, 1, 0)
    assert (seen["found"], seen["median_mm"], seen["p90_mm"]) == pytest.approx((200 / 3, 2.0, 2.8))
    dice = [(True, 0.97), (True, 0.96), (False, 0.2)]
    reported = [THROWN | {"right": right, "probability": share} for right, share in dice]
    (row,) = figures_of(reported, "dice, reported")
    assert row["invented"] == pytest.approx(100 / 3)
    assert row["brier"] == pytest.approx((0.03**2 + 0.04**2 + 0.2**2) / 3)


def test_every_kind_of_work_is_timed_and_a_recorded_picture_is_compared_with_its_mask(tmp_path):
    rows = time_rows(RIG, [np.full((SIZE, SIZE, 3), 80, np.uint8)] * 3)
    assert len({row["group"] for row in rows}) == 4
    assert all(row["ms"] > 0 and row["ratio"] > 0 for row in rows)
    assert recorded_row(tmp_path) == []
    (tmp_path / "dice").mkdir()
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[100:140, 100:140] = 255
    cv2.imwrite(str(tmp_path / "dice" / "test_image.png"), np.full((SIZE, SIZE, 3), 80, np.uint8))
    cv2.imwrite(str(tmp_path / "dice" / "test_mask.png"), mask)
    (row,) = figures_of([THROWN | one for one in recorded_row(tmp_path)], "dice, masks")
    assert (row["recall"], row["iou"]) == (0.0, 0.0)
    assert math.isnan(row["precision"])


@pytest.mark.usefixtures("sketched")
def test_a_smoke_run_of_the_command(tmp_path):
    skip_without_platform()
    out, cache = tmp_path / "out", tmp_path / "cache"
    places = ("--cache", cache, "--real", tmp_path / "nowhere", "-o", out)
    assert "## Dice" in printed_by("dice", "--scenes", 1, "--workers", 1, "--seed", 5, *places)
    results = read_results(out)
    assert (results.about["seed"], results.about["draw"]) == (5, "other")
    rows = {(row["table"], row["group"]): row for row in results.figures}
    for kind in ("thrown", "laid"):
        assert rows["dice, masks", kind]["n"] == 3
        assert 0.5 < rows["dice, masks", kind]["iou"] <= 1
    assert len(results.frames["dice, positions"]) == 2 * 2 * 25
    assert len(list(cache.rglob("*.npz"))) == 2
