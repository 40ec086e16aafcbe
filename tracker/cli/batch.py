"""`tracker batch`: thousands of recordings, and how far they are."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tracker.cli.calibration import Cameras, calibration_options
from tracker.cli.names import colors_option, object_option
from tracker.cli.part import part_options, refuse_no_part
from tracker.cli.protect import refuse_file
from tracker.cli.table import listing
from tracker.errors import LogError

if TYPE_CHECKING:
    from tracker.recordings.many.batch import Batch, Told
    from tracker.recordings.many.tables import State

_FOLDER = click.Path(path_type=Path)


class _WithParts(click.Command):
    """A command that another one takes the place of if its name comes first."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """See click.Command."""
        if args and args[0] in _PARTS:
            return _PARTS[args[0]].make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


@click.command(cls=_WithParts)
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...")
@object_option()
@click.option("-o", "--output", required=True, metavar="DIR", type=_FOLDER, help="Folder of the results.")
@calibration_options
@colors_option()
@part_options
@click.option("--recover", is_flag=True, help="Leave out what is damaged of a recording.")
@click.option(
    "--workers", metavar="N", type=click.IntRange(1), help="Processes here.  [default: one for each core]"
)
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, whose workers do it instead.")
@click.option("--htcondor", is_flag=True, help="Submit what is missing to HTCondor.")
@click.option("--slurm", is_flag=True, help="Submit what is missing to Slurm.")
@click.option("--dry-run", is_flag=True, help="Print what --htcondor or --slurm would submit.")
@click.option("--csv", "as_csv", is_flag=True, help="Write the table as CSV, too.")
@click.option("-q", "--quiet", is_flag=True, help="No progress, and no summary.")
def batch(
    recordings: tuple[str, ...],
    object_name: str,
    output: Path,
    cameras: Cameras,
    colors_name: str | None,
    first: int,
    last: int | None,
    recover: bool,
    workers: int | None,
    scheduler: str | None,
    htcondor: bool,
    slurm: bool,
    dry_run: bool,
    as_csv: bool,
    quiet: bool,
) -> None:
    """Find an object's pose in every frame of many recordings.

    RECORDING is what `tracker track` takes, or a pattern in quotes: 'episodes/*'. Each gets a file of poses
    in DIR under its own path, and a line in DIR/summary.parquet; what could not be done is in
    DIR/failures.json, with the reason.

    The same command again does what is missing, changed or damaged, and nothing else, whatever ended the run
    before. `tracker batch status DIR` tells how far it is, also of what HTCondor or Slurm are doing. The work
    is shared by Dask: python3 -m pip install '.[cluster]'. docs/batch.md tells more.
    """
    from tracker.recordings import Options
    from tracker.recordings.many.batch import Batch

    refuse_no_part(first, last)
    cameras.refuse_pattern_alone()
    refuse_file("-o", output)
    engines = {"--workers": workers, "--scheduler": scheduler, "--htcondor": htcondor, "--slurm": slurm}
    chosen = [name for name, value in engines.items() if value]
    if len(chosen) > 1:
        raise click.UsageError(f"found {' and '.join(chosen)}, expected one of them")
    if dry_run and not (htcondor or slurm):
        raise click.UsageError(
            "--dry-run prints what --htcondor or --slurm would submit, expected one of them"
        )
    options = Options(
        *(object_name, colors_name, *cameras),
        *(first, last, recover),
    )
    wanted = Batch.of(recordings, output, options)
    if htcondor or slurm:
        _submit(wanted, "htcondor" if htcondor else "slurm", dry_run, quiet)
    else:
        _run(wanted, workers, scheduler, as_csv, quiet)


def _run(wanted: Batch, workers: int | None, scheduler: str | None, as_csv: bool, quiet: bool) -> None:
    from tracker.recordings import Recipe
    from tracker.recordings.many.batch import only_run, run_batch, write_batch
    from tracker.recordings.many.engine import Cluster, cores
    from tracker.recordings.many.results import FAILURES
    from tracker.recordings.many.tables import state, write_tables

    Recipe.of(wanted.options)  # what is wrong with it is told before anything begins
    count = min(workers or cores(), len(wanted.pairs))
    failures: dict[str, str] = {}
    fault = None
    with only_run(wanted.folder):
        write_batch(wanted)
        try:
            with _progress(len(wanted.pairs), quiet, failures) as told:
                run_batch(wanted, lambda: Cluster(count, scheduler), told)
        except BaseException:
            with suppress(LogError):  # what ended the run is what is told
                write_tables(wanted, state(wanted, failures), as_csv=as_csv)
            raise
        found = state(wanted, failures)
        try:
            write_tables(wanted, found, as_csv=as_csv)
        except LogError as error:
            fault = error
    if not quiet:
        click.echo(_text(found))
    if failures:
        first = f"the first: {next(iter(failures.values()))}"
        where = first if fault else f"see {wanted.folder / FAILURES}"
        click.echo(f"tracker: {len(failures)} of {len(wanted.pairs)} recordings failed, {where}", err=True)
    if fault is not None:
        raise fault
    if failures:
        click.get_current_context().exit(2)


def _submit(wanted: Batch, scheduler: Any, dry_run: bool, quiet: bool) -> None:
    from tracker.recordings import Recipe
    from tracker.recordings.many.batch import only_run, unfinished, write_batch
    from tracker.recordings.many.schedulers import compile_kernels, describe
    from tracker.recordings.many.work import agreed

    recipe = Recipe.of(wanted.options)
    tasks = list(unfinished(wanted.tasks(agreed(recipe)), recipe, lambda: None))
    if not tasks:
        if not quiet:
            click.echo(f"all {len(wanted.pairs)} recordings are done")
        return
    description = describe(wanted, tasks, scheduler)
    if dry_run:
        click.echo(f"# {description.path}\n{description.text}", nl=False)
        return
    with only_run(wanted.folder):
        write_batch(wanted)
        description.write()
        compile_kernels(wanted.folder)
        said = description.submit()
    if not quiet:
        click.echo(
            f"{said}\n{len(tasks)} recordings; tracker batch status {wanted.folder} tells how far they are"
        )


@click.command()
@click.argument("folder", metavar="DIR", type=_FOLDER)
@click.option("--write", is_flag=True, help="Write the table and the failures as they are now.")
@click.option("--csv", "as_csv", is_flag=True, help="Write the table as CSV, too.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(folder: Path, write: bool, as_csv: bool, as_json: bool) -> None:
    """Tell how far the recordings of a folder of results are, whoever works on them."""
    from tracker.recordings.many.batch import read_batch
    from tracker.recordings.many.tables import state, write_tables

    wanted = read_batch(folder)
    found = state(wanted)
    if write or as_csv:
        write_tables(wanted, found, as_csv=as_csv)
    if as_json:
        numbers = {"recordings": found.total, "done": len(found.lines), "failed": len(found.failures)}
        numbers |= {"missing": found.missing, "running": found.running}
        click.echo(json.dumps({**numbers, "recordings_per_second": found.rate, "failures": found.failures}))
    else:
        click.echo(_text(found))


@click.command()
@click.argument("list_path", metavar="LIST", type=_FOLDER)
@click.argument("number", metavar="N", type=int)
def work(list_path: Path, number: int) -> None:
    """Do the Nth job of a LIST; what jobs of HTCondor and Slurm run."""
    from tracker.recordings.many.schedulers import work as do

    failed = do(list_path, number)
    if failed:
        click.echo(f"tracker: {failed} recordings failed", err=True)
        click.get_current_context().exit(2)


_PARTS = {"status": status, "work": work}


@contextmanager
def _progress(total: int, quiet: bool, failures: dict[str, str]) -> Iterator[Told]:
    """To be told of recordings, and keep why they failed; a line on stderr shows how far they are.

    That line is there if stderr is a terminal.
    """
    from tracker.recordings.many.batch import Pace

    pace = Pace(total, began=time.monotonic())

    def count(result: dict[str, Any] | None) -> None:
        pace.tell(result, time.monotonic())
        if result is not None and result["failure"] is not None:
            failures[result["recording"]] = result["failure"]

    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield count
        return
    from tqdm import tqdm

    tqdm.monitor_interval = 0
    line = "{percentage:3.0f}%|{bar}| {desc}"
    with tqdm(total=total, bar_format=line, leave=False, dynamic_ncols=True, file=sys.stderr) as shown:

        def told(result: dict[str, Any] | None) -> None:
            count(result)
            shown.set_description_str(str(pace), refresh=False)
            shown.update(1)

        yield told


def _text(found: State) -> str:
    from tracker.recordings.many.batch import duration

    rows = [
        ["recordings", str(found.total)],
        ["done", str(len(found.lines))],
        ["failed", str(len(found.failures))],
        ["missing", str(found.missing)],
    ]
    if found.running:
        rows.append(["running", str(found.running)])
    if found.rate is not None:
        rows.append(["pace", f"{60 * found.rate:.1f} a minute"])
        if found.missing:
            rows.append(["time left", duration(found.missing / found.rate)])
    for recording, why in list(found.failures.items())[:5]:
        rows.append(["", why if recording in why else f"{recording}: {why}"])
    return listing(rows)
