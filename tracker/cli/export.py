"""`tracker export`: files of poses in the formats of others, without tracking again."""

from __future__ import annotations

from pathlib import Path

import click

from tracker.cli.names import object_option
from tracker.cli.progress import bar
from tracker.cli.protect import check_suffix, refuse_overwriting
from tracker.cli.track_outputs import Outputs, write_film

_FILE = click.Path(path_type=Path)


@click.command(short_help="Write poses as CSV, Parquet, TUM, BOP, film or plot.")
@click.argument("source", metavar="POSES", type=_FILE)
@click.option("--csv", metavar="FILE", type=_FILE, help="A table, one line a frame.")
@click.option("--parquet", metavar="FILE", type=_FILE, help="The same in Parquet.")
@click.option("--tum", metavar="FILE", type=_FILE, help="A trajectory in the TUM format.")
@click.option("--bop", metavar="FILE", type=_FILE, help="BOP results of the --camera.")
@click.option("--camera", metavar="NAME", help="Camera of the BOP results, e.g. camera60.")
@click.option("--plot", metavar="FILE", type=_FILE, help="A plot of the poses over time (.png).")
@click.option(
    "--video", metavar="FILE", type=_FILE, help="A film with the pose drawn in (.mp4); needs --log."
)
@click.option("--log", metavar="LOG", type=_FILE, help="The recording of the POSES, for its images.")
@object_option("that of the POSES")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def export(
    source: Path,
    csv: Path | None,
    parquet: Path | None,
    tum: Path | None,
    bop: Path | None,
    camera: str | None,
    plot: Path | None,
    video: Path | None,
    log: Path | None,
    object_name: str | None,
    quiet: bool,
) -> None:
    """Write the poses of a file that `tracker track` made in other formats. Nothing is tracked."""
    from tracker.poses.file import read_poses

    outputs = Outputs(csv, tum, bop, camera, video, plot)
    files = {**outputs.files, **({"--parquet": parquet} if parquet else {})}
    if not files:
        raise click.UsageError(
            "found no file to write, expected --csv, --parquet, --tum, --bop, --plot or --video"
        )
    if (video is None) != (log is None):
        raise click.UsageError("--video and --log belong together: a film is made of the recording's images")
    refuse_overwriting(files, (source, *([log] if log else [])))
    outputs.check()
    if parquet is not None:
        check_suffix("--parquet", parquet, ".parquet", ".pq")
    poses = read_poses(source)
    outputs.check_camera(poses.about.rig)
    outputs.write(poses)
    if parquet is not None:
        from tracker.poses.exports import write_parquet

        write_parquet(parquet, poses)
    if video is not None and log is not None:
        from tracker.logs import open_log
        from tracker.logs.cameras import fitted_to
        from tracker.objects.model import load_object
        from tracker.recordings.outcome.origin import refuse_others

        model = load_object(object_name or poses.about.object_name)
        with open_log(log, recover=True) as opened, bar("film", len(poses), quiet) as progress:
            fitted_to(log, opened, poses.about.rig)
            refuse_others(source, poses, log, opened)
            write_film(video, opened, model, poses, progress)
