"""`tracker calibrate board`: a board to print."""

from __future__ import annotations

from pathlib import Path

import click

from tracker.cli.board_options import board_of, board_options


@click.command()
@board_options
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The page (.pdf, .svg or .png).",
)
@click.option("--legacy", is_flag=True, help="The pattern that OpenCV printed before 4.6 [even rows].")
def board(squares: str, square: float, marker: float, dictionary: str, output: Path, legacy: bool) -> None:
    """Write a ChArUco board as a page to print at its true size.

    Print at 100 %, without fitting to the page, on something that stays flat, and measure a row of
    squares afterwards: its length, divided by their number, is --square of the other commands.
    """
    from tracker.calibration.board_print import SUFFIXES, page_of, printed
    from tracker.files import write_whole

    if output.suffix.lower() not in SUFFIXES:
        raise click.UsageError(
            f"-o {output}: found suffix {output.suffix!r}, expected one of {', '.join(SUFFIXES)}"
        )
    page = page_of(board_of(squares, square, marker, dictionary, legacy))
    write_whole(output, printed(page, output.suffix.lower()))
    click.echo(f"{output}: {page.board}, on a page of {page.width:g}x{page.height:g} mm")
