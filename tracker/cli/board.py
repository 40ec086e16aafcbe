"""`tracker calibrate board` and `intrinsics`: a board to print, and a camera's lens from photos of it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tracker
from tracker.cli.options import gathered, option
from tracker.cli.outputs import PICTURE, Command, Recording, file_option
from tracker.cli.pictures import silent_libraries
from tracker.cli.terminal import listing, table
from tracker.errors import CalibrationError

if TYPE_CHECKING:
    from tracker.calibration.board.board import Board
    from tracker.calibration.board.intrinsics import Lens
    from tracker.calibration.board.sighting import BoardView
    from tracker.calibration.files.platform import Calibrated
    from tracker.conventions import FloatArray


@dataclass(frozen=True)
class Printed:
    """The board that the options say."""

    squares: str = option(
        "--squares", required=True, metavar="CxR", help="Columns and rows of squares, black and white: 5x7."
    )
    square: float = option("--square", required=True, type=float, metavar="M", help="Edge of a square [m].")
    marker: float = option("--marker", required=True, type=float, metavar="M", help="Edge of a marker [m].")
    dictionary: str = option(
        "--dictionary",
        default="DICT_APRILTAG_16h5",
        show_default=True,
        metavar="NAME",
        help="Set of markers, by OpenCV's name.",
    )

    def board(self, legacy: bool = False) -> Board:
        """It; UsageError where --squares cannot be read, CalibrationError where there is no such board."""
        from tracker.calibration.board.board import Board

        sizes = re.fullmatch(r"(\d{1,4})[x×X](\d{1,4})", self.squares)
        if sizes is None:
            raise click.UsageError(f"--squares {self.squares!r}: expected columns and rows, e.g. 5x7")
        return Board(int(sizes[1]), int(sizes[2]), self.square, self.marker, self.dictionary, legacy)


board_options = gathered(Printed)


def sightings_of(paths: Sequence[Path], board: Board) -> tuple[Board, list[BoardView | None], dict[str, str]]:
    """The board in the pattern seen, what each photo shows of it, and why those without show none."""
    from tracker.calibration.board.sighting import (
        MOST_BLUR,
        find_board,
        pattern_seen,
        require_size,
        why_no_board,
    )
    from tracker.color_learning.labelled import read_image

    photos = [str(path) for path in paths]
    with silent_libraries():
        images = [read_image(path) for path in paths]
    board = pattern_seen(images, board)
    found: list[BoardView | None] = []
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
        why = "; ".join(f"{fault} ({count} ×)" for fault, count in Counter(faults.values()).most_common(3))
        raise CalibrationError(
            f"board: found in none of {len(photos)} photos: {why}; expected photos of the board that "
            "--dictionary, --squares, --square and --marker say"
        )
    clearest = max(range(len(found)), key=lambda n: len(found[n] or ()))
    require_size(photos[clearest], images[clearest], board)
    return board, found, faults


@contextmanager
def named(faults: Mapping[str, str]) -> Iterator[None]:
    """A CalibrationError names the photos, too, that are not used, and why."""
    try:
        yield
    except CalibrationError as error:
        why = (f"{photo}: {fault}" for photo, fault in faults.items())
        raise CalibrationError("; ".join([str(error), *why])) from error


def draw(path: Path, calibrated: Calibrated, photos: Sequence[tuple[FloatArray, FloatArray, bool]]) -> None:
    """Draw what is missed where in the photos of a camera, see `residual_picture`."""
    from tracker.viz.calibration import residual_picture

    camera, used = calibrated.camera, sum(counts for *_, counts in photos)
    title = f"{camera.name}, {used} photos"
    tracker.viz.write_image(path, residual_picture(title, (camera.width, camera.height), photos))


def told_pattern(board: Board) -> str:
    """The pattern of a board, as far as it is known."""
    if not board.two_patterns:
        return f"{board} (with {board.rows} rows the old and the new pattern are the same)"
    return f"{board}" if board.legacy else f"{board}, today's pattern"


def _part(_: click.Context, option: click.Parameter, value: str | None) -> tuple[int, ...] | None:
    """Width, height, left and top [px] of --crop; UsageError where it cannot be read."""
    if value is None:
        return None
    part = re.fullmatch(r"(\d{1,5})x(\d{1,5})\+(\d{1,5})\+(\d{1,5})", value)
    if part is None:
        raise click.UsageError(f"{option.opts[0]} {value!r}: expected WxH+L+T, e.g. 540x540+88+0")
    return tuple(int(number) for number in part.groups())


@dataclass(frozen=True)
class Smaller:
    """Which smaller images files are written of, besides those of the photos' size."""

    crop: tuple[int, ...] | None = option(
        "--crop",
        callback=_part,
        metavar="WxH+L+T",
        help="Write NAME_cropped.yml too, of the photos' part of W×H px that starts at (L, T): on the "
        "platform 540x540+88+0.",
    )
    halve: bool = option(
        "--halve",
        is_flag=True,
        help="Write NAME_downsampled.yml too, with --crop NAME_cropped_and_downsampled.yml: of halved "
        "images, the quarter pixel right.",
    )

    def write(self, cameras: Iterable[tuple[Calibrated, Path]]) -> str:
        """Write files of cameras and those beside; which. CalibrationError where the part is not inside."""
        from tracker.calibration.files.platform import write_calibrated

        files: dict[Path, Calibrated] = {}
        for calibrated, path in cameras:
            files[path], last, suffix = calibrated, calibrated, ""
            if self.crop is not None:
                width, height, left, top = self.crop
                last, suffix = calibrated.cropped(left, top, width, height), "_cropped"
                files[path.with_stem(path.stem + suffix)] = last
            if self.halve:
                suffix += "_and_downsampled" if suffix else "_downsampled"
                size = last.camera.width // 2, last.camera.height // 2
                files[path.with_stem(path.stem + suffix)] = last.resized(*size)
        for path, calibrated in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_calibrated(calibrated, path)
        return ", ".join(map(str, files))


size_options = gathered(Smaller)


@click.command(cls=Command)
@board_options
@file_option("-o", ".pdf", ".svg", ".png", required=True, help="The page (.pdf, .svg or .png).")
@click.option("--legacy", is_flag=True, help="Use the pattern of OpenCV before 4.6 [even rows].")
def board(printed: Printed, output: Path, legacy: bool) -> None:
    """Write a ChArUco board as a page to print at its true size.

    Print at 100 %, without fitting to the page, on something that stays flat. Then measure a row of squares:
    its length, divided by their number, is --square of the other commands.
    """
    from tracker.calibration.board.board import page_of
    from tracker.calibration.board.board import printed as content_of
    from tracker.files import write_whole

    page = page_of(printed.board(legacy))
    write_whole(output, content_of(page, output.suffix.lower()))
    click.echo(f"{output}: {page.board}, on a page of {page.width:g}x{page.height:g} mm")


@click.command(cls=Command)
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...", type=Recording())
@board_options
@click.option("--name", required=True, metavar="NAME", help="The camera's, e.g. camera60.")
@file_option("-o", ".yml", ".yaml", required=True, new_folders=True, help="Calibration file (.yml).")
@size_options
@file_option("--plot", *PICTURE, help="Draw the residuals (.png, .jpg).")
def intrinsics(
    images: tuple[Path, ...], printed: Printed, name: str, output: Path, smaller: Smaller, plot: Path | None
) -> None:
    """Find the lens of a camera from photos of a ChArUco board.

    That is focal length, principal point and distortion, with the standard deviation of each. `tracker
    calibrate extrinsics` adds where the camera is.

    Take at least six photos, better fifteen, of the whole image's size: the board tilted by 30° to 45° in all
    directions, near and far, out to the image's corners; sharp, with the focus that the camera will keep.
    Each photo is checked against a lens fitted without it. Those that do not fit are named and left out.
    """
    from tracker.calibration.board.intrinsics import fit_lens
    from tracker.geometry.camera import check_name

    check_name(name, "--name", CalibrationError)
    board = printed.board()
    board, found, faults = sightings_of(images, board)
    with named(faults):
        lens = fit_lens(name, [one for one in found if one is not None], board)
    files = smaller.write([(lens.calibrated, output)])
    if plot is not None:
        draw(plot, lens.calibrated, [(p.sighting.pixels, p.residuals, p.fault is None) for p in lens.photos])
    summary = listing([["board", told_pattern(board)], *_found(lens), ["files", files]])
    click.echo(f"{_photo_table(lens, faults)}\n\n{summary}")


def _photo_table(lens: Lens, faults: dict[str, str]) -> str:
    from tracker.calibration.board.sighting import rms

    rows = [["photo", "corners", "dropped", "blur [px]", "RMS [px]", "left out [px]"]]
    for one in lens.photos:
        numbers = [len(one.sighting), one.dropped]
        sizes = [one.sighting.blur, rms([one.residuals]), one.left_out]
        rows.append([one.sighting.photo, *map(str, numbers), *(f"{size:.2f}" for size in sizes)])
    return photo_table(rows, {one.sighting.photo: one.fault for one in lens.photos if one.fault} | faults)


def photo_table(rows: Sequence[Sequence[str]], faults: Mapping[str, str]) -> str:
    """A table of photos, and the reasons why others are not used."""
    return "\n".join([table(rows), *(f"not used: {photo}: {fault}" for photo, fault in faults.items())])


def _found(lens: Lens) -> list[list[str]]:
    def with_std(values: FloatArray, std: FloatArray | None, digits: int) -> str:
        assert std is not None
        pairs = zip(values, std, strict=True)
        return ", ".join(f"{value:.{digits}f} ± {deviation:.{digits}f}" for value, deviation in pairs)

    camera, spread = lens.calibrated.camera, lens.calibrated.matrix_std
    assert spread is not None
    bent = with_std(camera.distortion, lens.calibrated.distortion_std, 4)
    rows = [
        ["focal lengths", f"{with_std(camera.matrix.diagonal()[:2], spread.diagonal()[:2], 2)} px"],
        ["principal point", f"{with_std(camera.matrix[:2, 2], spread[:2, 2], 2)} px"],
        ["distortion", f"{bent} (k1 k2 p1 p2 k3)"],
        ["photos used", str(sum(one.fault is None for one in lens.photos))],
        ["RMS", f"{lens.rms:.3f} px; with a lens fitted without them {lens.left_out:.3f} px"],
    ]
    if lens.reach < 0.9:
        beyond = f"beyond {lens.reach:.0%} of the way from the centre to the image's corners"
        rows.append(["note", f"no corner {beyond}: beyond that the distortion is a guess"])
    return rows
