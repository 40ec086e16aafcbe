import base64
import io
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from tests.helpers import opencv_pixels
from tests.helpers.boards import BOARD, LENS, photo, pose_towards
from tracker.calibration.board.board import Board, page_image, page_of, printed
from tracker.calibration.board.sighting import (
    find_board,
    pattern_seen,
    photo_blur,
    require_size,
    squares_shown,
    why_no_board,
)
from tracker.errors import CalibrationError

EVEN = Board(6, 8, 0.02, 0.015, "DICT_4X4_50")


def test_the_frame_is_centred_with_its_z_axis_out_of_the_print():
    assert BOARD.corners.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert BOARD.corners[0] == pytest.approx([-0.06, 0.10, 0.0])  # above on the left
    assert BOARD.corners[1] - BOARD.corners[0] == pytest.approx([0.04, 0, 0])
    assert BOARD.corners[4] - BOARD.corners[0] == pytest.approx([0, -0.04, 0])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ((2, 7, 0.04, 0.03), ["2x7", "3 to"]),
        ((5, 7, 0.0, 0.03), ["squares of 0 m", "at least 0.002"]),
        ((5, 7, 4.0, 3.0), ["squares of 4 m", "at most 1 m"]),
        ((5, 7, float("nan"), 0.03), ["squares of nan"]),
        ((5, 7, 0.04, 0.039), ["markers of 0.039 m", "0.008 to 0.038, less than"]),
        ((5, 7, 0.04, 0.03, "DICT_5X7"), ["DICT_5X7", "DICT_APRILTAG_16h5"]),
        ((9, 9, 0.04, 0.03), ["9x9", "40 markers", "has 30"]),
    ],
)
def test_a_board_that_cannot_be_is_refused(values, words):
    with pytest.raises(CalibrationError) as error:
        Board(*values)
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize("board", [BOARD, EVEN, replace(EVEN, legacy=True), Board(8, 5, 0.0333, 0.021)])
def test_squares_are_printed_where_the_board_says_to_a_dot(board):
    page = page_of(board)
    image, scale = page_image(page, 600), 600 / 25.4
    assert image.shape == (round(page.height * scale), round(page.width * scale))
    first = 1 if board.two_patterns and board.legacy else 0
    edges = [scale * (page.origin[0] + 1000 * board.square * k) for k in range(board.columns + 1)]
    middle = round(scale * (page.origin[1] + 500 * board.square))
    black = np.flatnonzero(np.diff((image[middle] < 128).astype(int)))
    for k in range(first, board.columns, 2):
        for edge in edges[k : k + 2]:
            assert np.abs(black + 1 - edge).min() <= 1.0


def test_corners_lie_on_the_printed_page_where_the_board_says():
    page = page_of(BOARD)
    found = find_board("", page_image(page, 101.6), BOARD)  # four pixels a millimetre
    assert found is not None
    places = (found.pixels + 0.5) / 4 - page.origin
    expected = BOARD.corners[:, :2] * (1000, -1000) + (100, 140)
    assert np.abs(places - expected).max() < 0.05


def test_every_format_has_the_pages_size_and_picture():
    page = page_of(Board(3, 3, 0.02, 0.015))
    png = printed(page, ".png")
    picture = Pillow.open(io.BytesIO(png))
    assert picture.info["dpi"] == pytest.approx((600, 600), abs=0.01)
    assert (picture.size, picture.mode) == ((4961, 7016), "1")
    pdf = printed(page, ".pdf").decode("latin-1")
    box = re.search(r"/MediaBox \[ 0 0 (\S+) (\S+) \]", pdf)
    assert box is not None
    assert np.array(box.groups(), float) * 25.4 / 72 == pytest.approx([210, 297], abs=0.05)
    assert re.search(r"/Width 4961\b", pdf)
    assert "/CCITTFaxDecode" in pdf  # without loss
    svg = printed(page, ".svg").decode()
    assert 'width="210.0mm" height="297.0mm"' in svg
    assert base64.b64decode(svg.partition("base64,")[2].partition('"')[0]) == png
    below = np.asarray(picture)[round(294 / 25.4 * 600) :, :]
    assert not below.all()  # what the board is stands there


@pytest.mark.parametrize(
    ("board", "size"),
    [
        (BOARD, (210, 297)),
        (Board(7, 5, 0.04, 0.03), (297, 210)),
        (Board(5, 7, 0.05, 0.03), (297, 420)),
        (Board(5, 5, 0.2, 0.1), (1020, 1020)),
    ],
)
def test_the_page_is_the_smallest_that_holds_the_board(board, size):
    page = page_of(board)
    assert (page.width, page.height) == pytest.approx(size)


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
        errors.append(found.pixels - opencv_pixels(LENS, found.points, pose))
    together = np.concatenate(errors)
    assert np.abs(together.mean(axis=0)).max() < 0.03  # pixel centres are at whole numbers
    assert np.median(np.linalg.norm(together, axis=1)) < 0.12


def test_corners_of_slanting_squares_are_found_where_they_are():
    page, angle = page_of(BOARD), np.radians(40)
    slanting = 0.42 * np.array([[1.0, np.cos(angle), 48], [0.0, np.sin(angle), 48]])
    flat = cv2.GaussianBlur(page_image(page, 101.6), (0, 0), 2.0)  # four pixels a millimetre
    found = find_board("photo", cv2.warpAffine(flat, slanting, (900, 600)), BOARD)
    assert found is not None
    printed_at = 4 * (found.points[:, :2] * (1000, -1000) + (100, 140) + page.origin) - 0.5
    expected = printed_at @ slanting[:, :2].T + slanting[:, 2]
    assert np.linalg.norm(found.pixels - expected, axis=1).max() < 0.3


@pytest.mark.parametrize("blur", [0.5, 0.8, 1.1])
def test_blur_is_given_in_pixels(blur, photos):
    image = photo(photos[0][0], np.random.default_rng(72), blur=blur)
    pixels = np.sqrt(blur**2 + 1 / 12)  # a pixel's own width
    found = find_board("photo", image, BOARD)
    assert found is not None
    assert found.blur == pytest.approx(pixels, rel=0.25)
    assert photo_blur(image[:, :, 0]) == pytest.approx(pixels, rel=0.25)


def test_an_image_with_edges_along_one_axis_has_a_blur():
    steps = np.repeat(np.uint8([20, 200]), 50)[:, None].repeat(100, axis=1)
    assert photo_blur(steps) == photo_blur(steps.T) < 1.0


@pytest.mark.parametrize("angle", [20, 45, 60, 80])
def test_a_slanting_edge_is_no_more_blurred(angle):
    y, x = np.mgrid[:200, :200] - 99.5
    beyond = np.cos(np.radians(angle)) * x + np.sin(np.radians(angle)) * y
    edge = cv2.GaussianBlur(np.where(beyond > 0, np.uint8(210), np.uint8(40)), (0, 0), 1.8)
    assert photo_blur(edge) == pytest.approx(1.8, rel=0.2)


@pytest.mark.parametrize("more", [(), ((5, 2),)])
def test_corners_in_a_line_with_or_without_another_give_no_pose(more):
    page = page_of(BOARD)
    whole, (left, top) = page_image(page, 101.6), np.array(page.origin) * 4  # four pixels a millimetre
    image = np.full_like(whole, 110)
    for row, column in ((0, 1), (1, 0), (2, 1), (3, 0), (4, 1), *more):  # squares that are not hidden
        below, right = round(top) + 160 * row, round(left) + 160 * column
        part = slice(below, below + 160), slice(right, right + 160)
        image[part] = whole[part]
    assert find_board("", image, BOARD) is None
    assert f"of its {4 + len(more)} corners all, or all but one, lie" in why_no_board(image, BOARD)


@pytest.mark.parametrize(
    ("change", "board", "why"),
    [
        (lambda image: np.ascontiguousarray(image[:, ::-1]), BOARD, "the photo is mirrored"),
        (lambda image: cv2.GaussianBlur(image, (0, 0), 4), BOARD, "the photo is blurred"),
        (lambda image: cv2.blur(image, (21, 1)), BOARD, "the photo is blurred"),
        (np.zeros_like, BOARD, "no marker of DICT_APRILTAG_16h5 found"),
        (lambda image: image[:, :1].copy(), BOARD, "no marker of DICT_APRILTAG_16h5 found"),
        (lambda image: image[:1, :1].copy(), BOARD, "no marker of DICT_APRILTAG_16h5 found"),
        (np.copy, Board(5, 7, 0.04, 0.03, "DICT_5X5_100"), "no marker of DICT_5X5_100 found"),
        *[
            (np.copy, Board(*size, 0.04, 0.03), f"{size[0]}x{size[1]} squares, or it is seen too obliquely")
            for size in ((7, 5), (6, 6), (4, 7))
        ],
    ],
)
def test_why_a_board_is_not_found_is_reported(change, board, why, photos):
    image = change(photos[1][1])
    assert find_board("photo", image, board) is None
    assert why in why_no_board(image, board)


def test_a_board_that_is_part_of_the_one_seen_is_refused(photos):
    part, image = Board(5, 5, 0.04, 0.03), photos[2][1]
    assert find_board("photo", image, part) is not None
    with pytest.raises(CalibrationError, match=r"photo: .* which are not on a board of 5x5 squares"):
        require_size("photo", image, part)
    require_size("photo", image, BOARD)


@pytest.mark.parametrize("legacy", [False, True])
def test_only_the_pattern_of_the_photos_is_found(legacy):
    rng = np.random.default_rng(73)
    board = Board(5, 6, 0.04, 0.03, legacy=legacy)
    other = replace(board, legacy=not legacy)
    image = photo(pose_towards(rng), rng, board=board)
    assert find_board("", image, other) is None
    assert pattern_seen([image], board) == pattern_seen([image], other) == board


def test_what_is_shown_of_a_board_is_counted_in_squares(photos):
    found = find_board("photo", photos[0][1], BOARD)
    assert found is not None
    assert squares_shown([found], BOARD) == (5, 7)
    assert squares_shown([found.without(found.corners >= 8)], BOARD) == (5, 3)
