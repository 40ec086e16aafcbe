"""`tracker calibrate`: calibrations made, mended and checked."""

from __future__ import annotations

import click

from tracker.cli.calibrate_board import board
from tracker.cli.calibrate_check import check
from tracker.cli.calibrate_extrinsics import extrinsics
from tracker.cli.calibrate_intrinsics import intrinsics
from tracker.cli.calibrate_refine import refine_command
from tracker.cli.calibrate_table import table_command


@click.group(no_args_is_help=False, short_help="Calibrate cameras; check and mend calibrations.")
def calibrate() -> None:
    """Make the calibration of cameras from photos of a board, or mend one by recordings of a known object.

    What mends a calibration changes no file: what is found goes to a folder of its own, which then stands
    wherever --calibration does.
    """


calibrate.add_command(board)
calibrate.add_command(intrinsics)
calibrate.add_command(extrinsics)
calibrate.add_command(refine_command)
calibrate.add_command(table_command)
calibrate.add_command(check)
