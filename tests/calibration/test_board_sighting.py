"""Boards found in photos, and why they are not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.boards import BOARD, LENS, photo, pose_towards, seen_pixels
from tracker.calibration.board import Board
from tracker.calibration.board_absence import photo_blur, require_size, why_no_board
from tracker.calibration.board_sighting import find_board, pattern_seen, squares_shown
from tracker.errors import CalibrationError


@pytest.fixture(scope="module")
def photos():
    rng = np.random.default_rng(71)
    poses = [pose_towards(rng) for _ in range(8)]
    return [(pose, photo(pose, rng)) for pose in poses]


def test_corners_are_found_where_they_are(photos):
    errors = []
    for pose, image in photos:
        found = find_board("photo", image, BOARD)
        assert found is not None
        assert len(found) >= 20
        assert found.points == pytest.approx(BOARD.corners[found.corners])
        errors.append(found.pixels - seen_pixels(found.points, pose, LENS))
    together = np.concatenate(errors)
    assert np.abs(together.mean(axis=0)).max() < 0.03  # pixel centres are at whole numbers
    assert np.median(np.linalg.norm(together, axis=1)) < 0.12


@pytest.mark.parametrize("blur", [0.5, 0.8, 1.1])
def test_blur_is_told_in_pixels(blur, photos):
    rng = np.random.default_rng(72)
    image = photo(photos[0][0], rng, blur=blur)
    pixels = np.sqrt(blur**2 + 1 / 12)  # a pixel's own width
    found = find_board("photo", image, BOARD)
    assert found is not None
    assert found.blur == pytest.approx(pixels, rel=0.25)
    assert photo_blur(image[:, :, 0]) == pytest.approx(pixels, rel=0.25)


@pytest.mark.parametrize(
    ("change", "board", "why"),
    [
        (lambda image: np.ascontiguousarray(image[:, ::-1]), BOARD, "the photo is mirrored"),
        (lambda image: cv2.GaussianBlur(image, (0, 0), 4), BOARD, "the photo is blurred"),
        (lambda image: cv2.blur(image, (21, 1)), BOARD, "the photo is blurred"),
        (np.zeros_like, BOARD, "no marker of DICT_APRILTAG_16h5 found"),
        (lambda image: np.full_like(image, 200), BOARD, "no marker of DICT_APRILTAG_16h5 found"),
        (np.copy, Board(5, 7, 0.04, 0.03, "DICT_5X5_100"), "no marker of DICT_5X5_100 found"),
        *[(np.copy, Board(*size, 0.04, 0.03), "a board of 5x7 squares") for size in ((7, 5), (6, 6), (4, 7))],
    ],
)
def test_why_a_board_is_not_found_is_told(change, board, why, photos):
    image = change(photos[1][1])
    assert find_board("photo", image, board) is None
    assert why in why_no_board(image, board)


def test_a_board_that_is_part_of_the_one_seen_is_refused(photos):
    part, image = Board(5, 5, 0.04, 0.03), photos[2][1]
    assert find_board("photo", image, part) is not None
    with pytest.raises(CalibrationError, match=r"photo: .* a board of 5x7 squares, expected 5x5"):
        require_size("photo", image, part)
    require_size("photo", image, BOARD)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("expected", [False, True])
def test_the_pattern_is_that_of_the_photos(legacy, expected):
    rng = np.random.default_rng(73)
    board = Board(5, 6, 0.04, 0.03, legacy=legacy)
    image = photo(pose_towards(rng), rng, board=board)
    assert pattern_seen([image], board.with_pattern(expected)) == board


def test_what_is_shown_of_a_board_is_counted_in_squares(photos):
    found = find_board("photo", photos[0][1], BOARD)
    assert found is not None
    assert squares_shown([found], BOARD) == (5, 7)
    assert squares_shown([found.without(found.corners >= 8)], BOARD) == (5, 3)
