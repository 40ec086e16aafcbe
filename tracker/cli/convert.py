"""`tracker convert`: recordings from one format to another."""

from __future__ import annotations

from pathlib import Path

import click

from tracker.cli.calibration import Cameras, calibration_options, rig_of
from tracker.cli.part import part_options, refuse_no_part
from tracker.cli.progress import bar
from tracker.cli.protect import refuse_overwriting
from tracker.errors import LogError


@click.command()
@click.argument("source", metavar="LOG", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FILE|DIR",
    type=click.Path(path_type=Path),
    help="An HDF5 log (.h5), a film of all cameras side by side (.mp4), or a new folder of images.",
)
@calibration_options
@part_options
@click.option("--recover", is_flag=True, help="Leave out what is damaged of the recording.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def convert(
    source: Path,
    output: Path,
    cameras: Cameras,
    first: int,
    last: int | None,
    recover: bool,
    quiet: bool,
) -> None:
    """Write a recording in another format.

    An HDF5 log is one of the platform, version 2.1: raw pixels, stamps and poses are kept to the bit, and
    the calibration goes into it; images in colour become the mosaic that such cameras would have recorded.
    A folder of images (one for each camera, PNG) has the stamps as names, and the calibration in it.
    """
    from tracker.logs import open_log
    from tracker.logs.convert import write_folder, write_hdf5
    from tracker.viz.log_film import write_log_film

    refuse_no_part(first, last)
    cameras.refuse_pattern_alone()
    refuse_overwriting({"-o": output}, (source,), cameras.calibration, new_folders=not output.suffix)
    suffix = output.suffix.lower()
    if suffix not in (".h5", ".hdf5", ".mp4", ""):
        raise click.UsageError(
            f"-o {output}: found suffix {suffix!r}, expected .h5, .mp4, or none for a folder"
        )
    if output.exists():
        raise click.UsageError(f"-o {output}: there is one already, expected a new one")
    with open_log(source, recover=recover) as log:
        if first and first >= len(log):
            raise LogError(
                f"{source}: found {len(log)} frames, expected the first one wanted, {first}, below"
            )
        part = log[first:last]
        with bar(source.name, len(part), quiet) as progress:
            if suffix == ".mp4":
                write_log_film(output, part, progress)
            else:
                rig = rig_of(source, log, cameras)
                write = write_folder if not suffix else write_hdf5
                write(output, part, rig, progress)
        fault = log.fault
    if fault is not None:
        click.echo(f"tracker: warning: {fault}", err=True)
