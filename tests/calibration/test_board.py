"""The board: its frame and patterns, the page to print, and boards found in photos."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np
import pytest

from tests.helpers.boards import BOARD, LENS, photo, pose_towards, seen_pixels
from tracker.calibration.board import Board
from tracker.calibration.board_absence import photo_blur, require_size, why_no_board
from tracker.calibration.board_print import Page, black, page_image, page_of, printed
from tracker.calibration.board_sighting import find_board, pattern_seen, squares_shown
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
        ((5, 7, 0.0, 0.03), ["squares of 0 m"]),
        ((5, 7, float("nan"), 0.03), ["squares of nan"]),
        ((5, 7, 0.03, 0.03), ["markers of 0.03", "less than"]),
        ((5, 7, 0.04, 0.03, "DICT_5X7"), ["DICT_5X7", "DICT_APRILTAG_16h5"]),
        ((9, 9, 0.04, 0.03), ["9x9", "40 markers", "has 30"]),
    ],
)
def test_a_board_that_cannot_be_is_refused(values, words):
    with pytest.raises(CalibrationError) as error:
        Board(*values)
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize("board", [BOARD, EVEN, EVEN.with_pattern(True), Board(8, 5, 0.02, 0.01)])
def test_the_print_is_opencvs_board(board):
    pixels = round(1000 * board.square) * 6  # markers' cells are whole pixels, their insets too
    across, down = (1000 * edge for edge in board.size)
    mine = page_image(Page(board, across, down), 25.4 * pixels / (1000 * board.square))
    reference = board.opencv.generateImage((board.columns * pixels, board.rows * pixels))
    assert mine.shape == reference.shape
    # OpenCV rounds where a marker's cells begin.
    assert cv2.erode(np.asarray(mine != reference, np.uint8), np.ones((3, 3))).sum() == 0


@pytest.mark.parametrize("legacy", [False, True])
def test_only_the_pattern_printed_is_found(legacy):
    image = page_image(page_of(EVEN.with_pattern(legacy)), 150)
    assert len(find_board("", image, EVEN.with_pattern(legacy)) or ()) == 35
    assert find_board("", image, EVEN.with_pattern(not legacy)) is None


def test_corners_lie_on_the_printed_page_where_the_board_says():
    page = page_of(BOARD)
    found = find_board("", page_image(page, 101.6), BOARD)  # four pixels a millimetre
    assert found is not None
    places = (found.pixels + 0.5) / 4 - page.origin
    expected = BOARD.corners[:, :2] * (1000, -1000) + (100, 140)
    assert np.abs(places - expected).max() < 0.05


def on_page(page):
    """(N, 4) black rectangles on the page [mm]."""
    return np.add(list(black(page.board)), (*page.origin, 0, 0))


def test_a_pdf_holds_the_boards_rectangles_in_points():
    page = page_of(BOARD)
    text = printed(page, ".pdf").decode("latin-1")
    sizes = re.search(r"/MediaBox \[0 0 (\S+) (\S+)\]", text)
    assert sizes is not None
    assert np.array(sizes.groups(), float) * 25.4 / 72 == pytest.approx([210, 297], abs=1e-3)
    found = np.array(re.findall(r"^(\S+) (\S+) (\S+) (\S+) re$", text, re.M), float)
    assert found == pytest.approx(on_page(page), abs=1e-4)
    start = int(text[text.index("startxref") :].split()[1])
    assert text[start:].startswith("xref")
    places = [int(line[:10]) for line in text[start:].splitlines() if line.endswith(" n ")]
    assert [text[place:].split()[0] for place in places] == ["1", "2", "3", "4", "5"]


def test_an_svg_holds_the_same_rectangles():
    page = page_of(BOARD)
    text = printed(page, ".svg").decode()
    assert 'width="210.0mm" height="297.0mm"' in text
    found = np.array(re.findall(r"M(\S+) (\S+)h(\S+)v(\S+)h\S+z", text.replace("zM", "z M")), float)
    assert found == pytest.approx(on_page(page), abs=1e-4)


def test_a_png_says_its_resolution_and_can_be_read():
    content = printed(page_of(Board(3, 3, 0.02, 0.015)), ".png")
    place = content.index(b"pHYs")
    across, down, metres = struct.unpack(">IIB", content[place + 4 : place + 13])
    assert (across, down, metres) == (23622, 23622, 1)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (7016, 4961)


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
