"""The options that say which board is in the photos, and the photos read."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tracker.cli.read_images import silent_libraries
from tracker.errors import CalibrationError

if TYPE_CHECKING:
    from tracker.calibration.board import Board
    from tracker.calibration.board_sighting import Sighting
    from tracker.conventions import Image

_Command = TypeVar("_Command", bound=Callable[..., Any])

_OPTIONS = (
    click.option(
        "--squares", required=True, metavar="CxR", help="Columns and rows of squares, black and white: 5x7."
    ),
    click.option("--square", required=True, type=float, metavar="M", help="Edge of a square [m]."),
    click.option("--marker", required=True, type=float, metavar="M", help="Edge of a marker [m]."),
    click.option(
        "--dictionary",
        default="DICT_APRILTAG_16h5",
        show_default=True,
        metavar="NAME",
        help="Set of markers, as OpenCV calls it.",
    ),
)


def board_options(command: _Command) -> _Command:
    """Add the options to a command; their values are what `board_of` takes."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def board_of(squares: str, square: float, marker: float, dictionary: str, legacy: bool = False) -> Board:
    """The board of the options.

    Raises:
        click.UsageError: --squares cannot be read.
        CalibrationError: there is no such board.
    """
    from tracker.calibration.board import Board

    sizes = re.fullmatch(r"(\d{1,4})[x×X](\d{1,4})", squares)
    if sizes is None:
        raise click.UsageError(f"--squares {squares!r}: expected columns and rows, e.g. 5x7")
    return Board(int(sizes[1]), int(sizes[2]), square, marker, dictionary, legacy)


def read_photos(paths: Sequence[Path]) -> list[Image]:
    """The photos (H, W, 3) BGR; ImageError names the file that cannot be read."""
    from tracker.segmentation.labelled import read_image

    with silent_libraries():
        return [read_image(path) for path in paths]


def sightings_of(
    photos: Sequence[str], images: Sequence[Image], board: Board
) -> tuple[Board, list[Sighting | None], dict[str, str]]:
    """The board in the pattern seen, what each photo shows of it, and why those without show none.

    Raises:
        CalibrationError: no photo shows the board, or the photos show another.
    """
    from tracker.calibration.board_absence import MOST_BLUR, require_size, why_no_board
    from tracker.calibration.board_sighting import find_board, pattern_seen

    board = pattern_seen(images, board)
    found: list[Sighting | None] = []
    faults: dict[str, str] = {}
    for photo, image in zip(photos, images, strict=True):
        one = find_board(photo, image, board)
        if one is None:
            faults[photo] = why_no_board(image, board)
        elif one.blur > MOST_BLUR:
            faults[photo] = f"the photo is blurred, its edges by {one.blur:.1f} px"
            one = None
        found.append(one)
    if all(one is None for one in found):
        told = "; ".join(f"{why} ({count} ×)" for why, count in Counter(faults.values()).most_common(3))
        raise CalibrationError(
            f"board: found in none of {len(photos)} photos: {told}; expected photos of the board that "
            "--dictionary, --squares, --square and --marker say"
        )
    clearest = max(range(len(found)), key=lambda n: len(found[n] or ()))
    require_size(photos[clearest], images[clearest], board)
    return board, found, faults


def told_pattern(board: Board) -> str:
    """Which pattern a board is of, as far as it can be told."""
    if not board.two_patterns:
        return f"{board} (with {board.rows} rows the old pattern and today's are the same)"
    return f"{board}" if board.legacy else f"{board}, today's pattern"
