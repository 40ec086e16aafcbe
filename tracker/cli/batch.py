"""`tracker batch`: track thousands of recordings, and show the progress."""

import json
import shlex
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import click

from tracker.batch.jobs import Scheduler, describe, do_share
from tracker.batch.results import FAILURES
from tracker.batch.run import Batch, forget, only_run, read_batch, run_batch, unfinished
from tracker.batch.stores import Retracking, are_stores
from tracker.batch.tables import State, state, write_tables
from tracker.batch.workers import cores, dask_workers, processes
from tracker.calibration.files import robots_in
from tracker.cli import options
from tracker.cli.options import argument, command, flag, option, several
from tracker.cli.outputs import InFile, OutFolder
from tracker.cli.terminal import bar, listing, say, table
from tracker.errors import LogError
from tracker.recordings import Options
from tracker.warm_up import warm_up


@click.group(no_args_is_help=False)
def batch() -> None:
    """Find an object's pose in thousands of recordings."""


@dataclass(frozen=True)
class Engine:
    """Options for where the work is done; UsageError if they contradict each other."""

    jobs: int | None = options.whole("Processes on this machine.  [default: one per core]")
    scheduler: str | None = option("ADDRESS", "Dask scheduler whose workers track instead.")
    htcondor: bool = flag("Submit what is missing to HTCondor.")
    slurm: bool = flag("Submit what is missing to Slurm.")
    dry_run: bool = flag("Print what --htcondor or --slurm would submit.")

    def __post_init__(self) -> None:
        every = ("jobs", "scheduler", "htcondor", "slurm")
        chosen = [f"--{name}" for name in every if getattr(self, name) not in (None, False)]
        if len(chosen) > 1:
            raise click.UsageError(f"found {' and '.join(chosen)}, expected one of them")
        if self.dry_run and self.submits is None:
            raise click.UsageError("--dry-run: expected --htcondor or --slurm, whose description it prints")

    @property
    def submits(self) -> Scheduler | None:
        """The scheduler to submit jobs to, or None."""
        return "htcondor" if self.htcondor else "slurm" if self.slurm else None


_as_csv = flag("Write the table as CSV, too.", name="--csv")


@command(batch)
def run(
    *,
    recordings: tuple[str, ...] = several("RECORDING", InFile(str)),
    output: Path = option("DIR", "Folder of the results.", OutFolder(), required=True),
    asked: options.Asked,
    robot: str | None = option("NAME", "Robot of image stores, e.g. r1.  [default: each episode's]"),
    engine: Engine,
    as_csv: bool = _as_csv,
    quiet: bool = flag("No progress, and no summary."),
) -> None:
    """Find an object's pose in every frame of many recordings.

    RECORDING is what `tracker track` takes, or a pattern in quotes: 'episodes/*'. Each gets a file of poses
    under its own path in DIR, and a row in DIR/summary.parquet. DIR/failures.json lists what failed, with
    the reason.

    For image stores, --calibration DIR may hold several robots' files (r1_camera60.yml, …). Each episode is
    then tracked with the calibration of its robot; docs/learning.md describes the results.

    Repeat the command to track what is missing, changed or damaged. `tracker batch status
    DIR` shows the progress, also of HTCondor and Slurm. Parquet and --scheduler need python3 -m pip install
    -e '.[cluster]'; without it, the table is DIR/summary.csv. See docs/batch.md.
    """
    planned = _planned(recordings, output, asked.options(), robot)
    if as_csv and engine.submits is not None:
        raise click.UsageError("--csv: expected with `tracker batch status`, when what is submitted is done")
    if engine.submits is None:
        _run(planned, engine, as_csv, quiet)
    elif isinstance(planned, Retracking):
        raise click.UsageError("image stores of several robots: expected --jobs or --scheduler")
    else:
        _submit(planned, engine.submits, engine.dry_run, quiet)


def _planned(recordings: tuple[str, ...], output: Path, asked: Options, robot: str | None) -> Batch:
    """Plan the work, by episodes if the recordings are image stores of several robots."""
    one_folder = len(asked.calibration) == 1 and asked.pattern is None
    if one_folder and robots_in(Path(asked.calibration[0])):
        if are_stores(recordings, output):
            return Retracking.of(recordings, output, asked, robot)
        if robot is not None:
            raise click.UsageError(f"--robot is for image stores; for others --pattern '{robot}_*'")
    elif robot is not None:
        raise click.UsageError("--robot: expected --calibration DIR with files like r1_camera60.yml")
    return Batch.of(recordings, output, asked)


def _run(batch: Batch, engine: Engine, as_csv: bool, quiet: bool) -> None:
    work = batch.work()  # report faults before anything begins
    count = min(engine.jobs or cores(), len(batch.pairs))
    failures: dict[str, str] = {}
    fault = None

    def tell(result: dict[str, Any] | None) -> None:
        advance(1)
        if result is not None and result["failure"] is not None:
            failures[result["recording"]] = result["failure"]

    with only_run(batch, work):
        try:
            with bar("recordings", len(batch.pairs), quiet, "recordings") as advance:
                workers = dask_workers(engine.scheduler) if engine.scheduler is not None else processes(count)
                run_batch(work, workers, tell)
        except BaseException:
            with suppress(LogError):  # report why the run ended instead
                write_tables(batch, state(batch, failures), as_csv=as_csv)
            raise
        found = state(batch, failures)
        try:
            write_tables(batch, found, as_csv=as_csv)
            reports = batch.write_tables() if isinstance(batch, Retracking) else {}
        except LogError as error:
            fault, reports = error, {}
    if not quiet:
        click.echo(_text(found))
        for store, report in reports.items():
            click.echo(f"\n{store}\n{_of_robots(report)}")
    if failures:
        first = f"the first: {next(iter(failures.values()))}"
        where = first if fault else f"see {batch.folder / FAILURES}"
        say(f"{len(failures)} of {len(batch.pairs)} recordings failed, {where}")
    if fault is not None:
        raise fault
    if failures:
        raise click.exceptions.Exit(2)


def _submit(batch: Batch, scheduler: Scheduler, dry_run: bool, quiet: bool) -> None:
    work = batch.work()
    tasks = list(unfinished(work, lambda: None))
    if not tasks:
        if not quiet:
            click.echo(f"all {len(batch.pairs)} recordings are done")
        return
    description = describe(batch, tasks, scheduler)
    if dry_run:
        click.echo(f"# {description.path}\n{description.text}", nl=False)
        return
    with only_run(batch, work):
        forget(tasks)
        write_tables(batch, state(batch), as_csv=False)
        description.write()
        warm_up()  # once, not in each job
        answer = description.submit()
    if not quiet:
        shown = f"tracker batch status {shlex.quote(str(batch.folder))} shows the progress"
        click.echo(f"{answer}\n{len(tasks)} recordings; {shown}")


@command(batch)
def status(
    folder: Path = argument("DIR", InFile()),
    write: bool = flag("Write the table and the failures as they are now."),
    as_csv: bool = _as_csv,
    as_json: bool = options.as_json,
) -> None:
    """Show the progress of a batch, wherever it runs.

    DIR is the folder of its results.
    """
    batch = read_batch(folder)
    found = state(batch)
    if write or as_csv:
        write_tables(batch, found, as_csv=as_csv)
    if as_json:
        numbers = {**_counts(found), "recordings_per_second": found.rate, "failures": found.failures}
        click.echo(json.dumps(numbers))
    else:
        click.echo(_text(found))


@command(batch, hidden=True)
def share(list_path: Path = argument("LIST", InFile()), number: int = argument("N", int)) -> None:
    """Do the Nth job of a LIST: jobs of HTCondor and Slurm run this."""
    failed = do_share(list_path, number)
    if failed:
        say(f"{failed} recordings failed")
        raise click.exceptions.Exit(2)


def _of_robots(report: dict[str, Any]) -> str:
    """Return a table of differences between new and stored poses, one line per robot."""
    columns = {
        "frames": ("frames", "{:.0f}"),
        "position_median_mm": ("median mm", "{:.1f}"),
        "angle_median_deg": ("median °", "{:.1f}"),
        "share_within_5mm": ("within 5 mm", "{:.1%}"),
        "share_turned": ("turned", "{:.1%}"),
        "delay_s": ("delay s", "{:.2f}"),
    }
    rows = [["", *(label for label, _ in columns.values())]]
    for robot, numbers in report["robots"].items():
        cells = [(numbers[name], form) for name, (_, form) in columns.items()]
        rows.append([robot, *("-" if value is None else form.format(value) for value, form in cells)])
    return table(rows) if len(rows) > 1 else "the store has no poses to compare with"


def _counts(found: State) -> dict[str, int]:
    counts = {"recordings": found.total, "done": len(found.lines), "failed": len(found.failures)}
    return {**counts, "missing": found.missing, "running": found.running}


def _text(found: State) -> str:
    rows = [[what, str(count)] for what, count in _counts(found).items() if count or what != "running"]
    if found.rate is not None and found.missing:
        rows.append(["pace", f"{60 * found.rate:.1f} a minute"])
        rows.append(["time left", str(timedelta(seconds=round(found.missing / found.rate)))])
    for recording, why in list(found.failures.items())[:5]:
        rows.append(["", why if recording in why else f"{recording}: {why}"])
    return listing(rows)
