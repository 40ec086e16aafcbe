"""`tracker export` and `tracker convert`: poses and recordings in other formats."""

from __future__ import annotations

from pathlib import Path

import click

import tracker
from tracker.cli import options
from tracker.cli.outputs import Command, InFile, Recording, file_option, refuse_overwriting, require_folder
from tracker.cli.render import bar
from tracker.cli.track_outputs import Outputs, output_options, write_tracked_film


@click.command(cls=Command, short_help="Write poses as CSV, Parquet, TUM, BOP, film or plot.")
@click.argument("source", metavar="POSES", type=InFile())
@output_options
@file_option("--parquet", ".parquet", ".pq", help="The table in Parquet.")
@click.option("--keypoints", is_flag=True, help="Add the object's corners to --csv and --parquet.")
@click.option(
    "--log", metavar="LOG", type=Recording(), help="The recording of the POSES, for the images of --video."
)
@options.object_name("that of the POSES")
@options.quiet("No progress bar.")
def export(
    source: Path,
    outputs: Outputs,
    parquet: Path | None,
    keypoints: bool,
    log: Path | None,
    object_name: str | None,
    quiet: bool,
) -> None:
    """Write the poses of a file that `tracker track` made in other formats. Nothing is tracked."""
    video = outputs.video
    if not outputs and parquet is None:
        raise click.UsageError(
            "found no file to write, expected --csv, --parquet, --tum, --bop, --plot or --video"
        )
    if (video is None) != (log is None):
        raise click.UsageError("--video and --log belong together: a film is made of the recording's images")
    if keypoints and outputs.csv is None and parquet is None:
        raise click.UsageError("--keypoints: found no table to add them to, expected --csv or --parquet")
    poses = tracker.read_poses(source)
    outputs.check_camera(poses.about.rig)
    corners_of = tracker.load_object(object_name or poses.about.object_name) if keypoints else None
    outputs.write(poses, corners_of)
    if parquet is not None:
        from tracker.poses.exports import write_parquet

        write_parquet(parquet, poses, keypoints_of=corners_of)
    if video is not None and log is not None:
        from tracker.logs.cameras import fitted_to
        from tracker.summaries.rewards import refuse_others

        model = tracker.load_object(object_name or poses.about.object_name)
        with tracker.open_log(log, recover=True) as opened, bar("film", len(poses), quiet) as progress:
            fitted_to(log, opened, poses.about.rig)
            refuse_others(source, poses, log, opened)
            write_tracked_film(video, opened, model, poses, progress)


@click.command(cls=Command)
@click.argument("source", metavar="LOG", type=Recording())
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FILE|DIR",
    type=click.Path(path_type=Path),
    help="An HDF5 log (.h5), a film of all cameras side by side (.mp4), or a new folder of images.",
)
@options.cameras
@options.part
@options.quiet("No progress bar.")
def convert(
    source: Path,
    output: Path,
    cameras: options.Cameras,
    part: options.Part,
    quiet: bool,
) -> None:
    """Write a recording in another format.

    An HDF5 log is one of the platform, version 2.1: raw pixels, stamps and poses are kept to the bit, and
    the calibration goes into it; images in colour become the mosaic that such cameras would have recorded.
    A folder of images (one for each camera, PNG) has the stamps as names, and the calibration in it.
    """
    from tracker.logs.convert import write_folder, write_hdf5
    from tracker.viz.image_files import write_log_film

    refuse_overwriting({"-o": output}, (source,), cameras.calibration)
    suffix = output.suffix.lower()
    if suffix not in (".h5", ".hdf5", ".mp4", ""):
        raise click.UsageError(
            f"-o {output}: found suffix {suffix!r}, expected .h5, .mp4, or none for a folder"
        )
    require_folder("-o", output, made=False)
    if output.exists():
        raise click.UsageError(f"-o {output}: there is one already, expected a new one")
    with tracker.open_log(source, recover=part.recover) as log:
        part.refuse_beyond(source, len(log))
        frames = log[part.first : part.last]
        with bar(source.name, len(frames), quiet) as progress:
            if suffix == ".mp4":
                write_log_film(output, frames, progress)
            else:
                rig = cameras.rig_of(source, log)
                write = write_folder if not suffix else write_hdf5
                write(output, frames, rig, progress)
        fault = log.fault
    if fault is not None:
        click.echo(f"tracker: warning: {fault}", err=True)
