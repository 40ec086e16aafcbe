"""Progress of a batch, the table of its recordings, and its failures."""

import contextlib
import json
import os
import shlex
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tracker.batch import results
from tracker.batch.run import Batch
from tracker.errors import LogError, reason
from tracker.files import csv_text, lock_of, parquet_file, write_whole
from tracker.recordings.track import unicode_text
from tracker.summaries.summary import COLUMNS


@dataclass(frozen=True)
class State:
    """Progress of a batch of `total` recordings."""

    total: int
    lines: tuple[dict[str, Any], ...]
    """Table rows of finished recordings, in order; it is not checked that their options are the same."""
    failures: dict[str, str]
    """Reasons for failures, by recording."""
    running: int
    """Number of files of poses that are locked, so are probably being made."""
    rate: float | None
    """Recordings finished per second over the last ten minutes of work [1/s]; None: unknown."""

    @property
    def missing(self) -> int:
        """Number of recordings that are neither done nor failed."""
        return self.total - len(self.lines) - len(self.failures)


RECENT = 600.0
"""Time over which the rate is measured [s]."""


def state(batch: Batch, failed: Mapping[str, str] | None = None) -> State:
    """Read the progress of a batch from its folder of results, wherever it runs.

    failed: reasons for failures in this run, for which there may be no files.
    """
    lines, failures, stamps, running = [], {}, [], 0
    for log, relative in batch.pairs:
        output = batch.folder / relative
        line = results.read_line(output)
        running += os.path.exists(lock_of(output))
        if line is not None:
            lines.append({**line, "output": unicode_text(relative)})
            with contextlib.suppress(OSError):  # a worker that did it again may just have removed it
                stamps.append(results.summary_file(output).stat().st_mtime)
        elif os.path.exists(results.failure_file(output)):  # Path.exists raises for too long names
            failures[log] = results.read_failure(output)
        elif failed is not None and log in failed:
            failures[log] = failed[log]
    return State(len(batch.pairs), tuple(lines), failures, running, _rate(stamps))


def _rate(stamps: list[float]) -> float | None:
    end = max(stamps, default=0.0)
    recent = [stamp for stamp in stamps if stamp > end - RECENT]
    begin = min(recent, default=end)
    return (len(recent) - 1) / (end - begin) if begin < end else None


def write_tables(batch: Batch, found: State, *, as_csv: bool) -> None:
    """Write `summary.parquet`, and `failures.json`, which is removed if nothing failed.

    `summary.csv` is written if requested, if it already exists, or if the package pyarrow is missing.
    LogError if a file cannot be written; the others are. The message says what was done and what to do.
    """
    rows = [{name: line[name] for name in COLUMNS} for line in found.lines]
    why = [{"recording": log, "reason": why} for log, why in found.failures.items()]
    writers: dict[str, Callable[[Path], object]] = {}
    table = f"{results.TABLE}.csv"
    if find_spec("pyarrow") is not None:
        writers[f"{results.TABLE}.parquet"] = lambda path: write_parquet(path, rows)
    if as_csv or not writers or (batch.folder / table).exists():
        writers[table] = lambda path: write_whole(path, csv_text(COLUMNS, map(dict.values, rows)))
    writers[results.FAILURES] = lambda path: (
        write_whole(path, json.dumps(why, indent=1) + "\n") if why else path.unlink(missing_ok=True)
    )
    refused = {}
    for name, write in writers.items():
        try:
            write(batch.folder / name)
        except OSError as error:
            refused[batch.folder / name] = os.strerror(error.errno) if error.errno else reason(error)
    if not refused:
        return
    old = " (what is there is older)" if any(path.exists() for path in refused) else ""
    command = f"`tracker batch status {shlex.quote(str(batch.folder))} --write{' --csv' * as_csv}`"
    names, why_not = ", ".join(map(str, refused)), "; ".join(dict.fromkeys(refused.values()))
    raise LogError(
        f"{names}: cannot be written{old}: {why_not}. The results of {len(found.lines)} of {found.total} "
        f"recordings are whole; when it can be, {command} writes this, and the same `tracker batch run` "
        "again does what is missing"
    )


def write_parquet(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Write rows under COLUMNS as a Parquet file, atomically; OSError if that fails."""
    import pyarrow as pa

    kinds = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    with parquet_file(path) as add:
        add(pa.Table.from_pylist(list(rows), schema=schema))
