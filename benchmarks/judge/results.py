"""What a run leaves: rows of figures, the frames that they were made of, and where all of it comes from."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.score.records import FrameRecord, frame_of
from benchmarks.score.summary import accuracy_rows
from tracker.errors import TrackerError
from tracker.files import write_whole

RESULTS_FILE = "results.json"

KEYS = ("part", "group", "bin", "object")
"""What tells rows apart: part of the benchmarks, workload or the like, bin or the like, object."""

DIGITS = 7
"""Of numbers in the file: more than any of this is worth."""


class ResultsError(TrackerError):
    """A file of results that is missing, cannot be read, or cannot be used for what was asked."""


@dataclass
class Results:
    """Results of one run."""

    about: dict[str, Any] = field(default_factory=dict)
    """`commit`, `code`, `clean`, `processor`, `draw`, `seed`, `scenes`; `parts` with what made each."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """Figures by name, told apart by KEYS; `n` is how many frames or the like they are of."""
    frames: pd.DataFrame = field(default_factory=lambda: frame_of([]))
    """A row for each `FrameRecord` of the accuracy."""
    worst: list[dict[str, Any]] = field(default_factory=list)
    """Pictures of the worst frames, of development scenes alone."""

    @property
    def table(self) -> pd.DataFrame:
        """One data frame of all figures: columns KEYS, `figure`, `value`, `n`."""
        rows = pd.DataFrame(self.rows, columns=None if self.rows else [*KEYS, "n"])
        for key in KEYS:
            rows[key] = rows[key].fillna("") if key in rows else ""
        figures = [name for name in rows if name not in (*KEYS, "n")]
        long = rows.melt([*KEYS, "n"], figures, "figure", "value")
        long["value"] = pd.to_numeric(long["value"], errors="coerce")
        return long.dropna(subset="value").reset_index(drop=True)

    def replaced(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Put rows in the place of those of the same parts."""
        new = [dict(row) for row in rows]
        parts = {row["part"] for row in new}
        self.rows = [row for row in self.rows if row["part"] not in parts] + new


def digest(content: Mapping[str, Any]) -> str:
    """Of rows, frames and their origin, however the file is laid out."""
    plain = {key: content[key] for key in ("about", "rows", "frames")}
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]


def write_results(path: str | os.PathLike[str], results: Results) -> None:
    """Write results as JSON, with null for what is not a finite number."""
    frames = results.frames.to_dict("split", index=False)
    content = {
        "about": _plain(results.about),
        "rows": [_measured(_plain(row)) for row in results.rows],
        "worst": _plain(results.worst),
        "frames": {"columns": frames["columns"], "data": _plain(frames["data"])},
    }
    content["checksum"] = digest(content)
    # One line a row: a file that can be read, and compared, by eye.
    text = json.dumps({**content, "rows": "ROWS", "frames": "FRAMES"}, indent=1, ensure_ascii=False)
    rows = ",\n".join(json.dumps(row, ensure_ascii=False) for row in content["rows"])
    data = ",\n".join(json.dumps(row, ensure_ascii=False) for row in content["frames"]["data"])
    columns = json.dumps(content["frames"]["columns"])
    text = text.replace('"ROWS"', f"[\n{rows}\n]", 1)
    write_whole(path, text.replace('"FRAMES"', f'{{"columns": {columns}, "data": [\n{data}\n]}}', 1) + "\n")


def read_results(path: str | os.PathLike[str]) -> Results:
    """Read what `write_results` wrote.

    Args:
        path: the file, or the folder that holds it.

    Raises:
        ResultsError: there is no such file, it holds something else, or it was changed by hand.
    """
    file = Path(path)
    if file.is_dir():
        file = file / RESULTS_FILE
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        frames = pd.DataFrame(content["frames"]["data"], columns=content["frames"]["columns"])
        found, expected = content["checksum"], digest(content)
        results = Results(content["about"], content["rows"], _typed(frames), content["worst"])
    except OSError as error:
        raise ResultsError(f"{file}: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsError(f"{file}: not a file of results: {error}") from error
    if found != expected:
        raise ResultsError(f"{file}: changed by hand: found checksum {found}, expected {expected}")
    return results


def contradictions(results: Results) -> list[str]:
    """Figures of the accuracy that the frames do not give, as sentences."""
    named = [{key: row.get(key, "") for key in KEYS} | row for row in results.rows]
    stated = {tuple(row[key] for key in KEYS): row for row in named}
    wrong = []
    for row in accuracy_rows(results.frames) if len(results.frames) else ():
        key = tuple(row.get(name, "") for name in KEYS)
        for name, value in _plain(row).items():
            said = stated.get(key, {}).get(name)
            if isinstance(value, (int, float)) and said != value and not _near(said, value):
                place = " / ".join(filter(None, (*key, name)))
                wrong.append(f"{place}: states {said}, its frames give {value}")
    return wrong


def _near(said: Any, value: float) -> bool:
    # Frames keep seven digits.
    return isinstance(said, (int, float)) and math.isclose(said, value, rel_tol=1e-4, abs_tol=1e-6)


def _typed(frames: pd.DataFrame) -> pd.DataFrame:
    kinds = {name: kind for name, kind in FrameRecord.__annotations__.items() if name in frames}
    return frames.astype({name: kind for name, kind in kinds.items() if kind in ("float", "bool", "int")})


def _measured(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if value is not None}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value
