"""`tracker calibrate`: calibrations made, mended and checked."""

from __future__ import annotations

import click

from tracker.cli.calibrate_table import table_command


@click.group(no_args_is_help=False)
def calibrate() -> None:
    """Mend a calibration by what recordings of a known object show.

    No command changes a file: what is found goes to a folder of its own, which then stands wherever
    --calibration does.
    """


calibrate.add_command(table_command)
