"""Results of a run: the answers and their origin, which is the commit, the exact sources and the machine.

Figures are computed from the answers on demand.
"""

import hashlib
import json
import math
import os
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.data.fingerprint import LIBRARIES, PROJECT, ROOT, version_of
from benchmarks.score.tables import figures
from synthetic.render.renderer import NAME
from tracker import compiled
from tracker.errors import TrackerError
from tracker.files import write_whole

RESULTS_FILE = "results.json"

_OWN = ("gate.json", "published.json")
"""Files that the benchmarks write into their own folder."""

DIGITS = 7
"""Significant digits of numbers in the file, more than any of them needs."""


class ResultsError(TrackerError):
    """A file of results is missing, cannot be read, or is not suitable."""


@dataclass
class Results:
    """Results of one run."""

    about: dict[str, Any] = field(default_factory=dict)
    """The entries of `origin`, with `draw`, `seed`, `scenes`; `parts` with the origin of each and what it
    `skipped`, with reasons."""
    frames: dict[str, pd.DataFrame] = field(default_factory=dict)
    """By part: one row per answer, with its `group` and `object`."""

    @property
    def figures(self) -> list[dict[str, Any]]:
        """Rows of all tables, see `benchmarks.score.tables`."""
        return figures(self.frames)


def write_results(path: str | os.PathLike[str], results: Results) -> None:
    """Write results as JSON, with null for numbers that are not finite."""
    frames = {
        part: {"columns": list(frame.columns), "rows": frame.to_numpy(object).tolist()}
        for part, frame in results.frames.items()
    }
    write_whole(path, _text(results.about, frames))


def write_published(path: str | os.PathLike[str], results: Results, judged: list[dict[str, Any]]) -> None:
    """Write the parts of a run that documents show: origin, figures and targets, but not the answers."""
    write_whole(
        path, _text(results.about, {"figures": {"rows": results.figures}, "targets": {"rows": judged}})
    )


def _text(about: Mapping[str, Any], lists: Mapping[str, Mapping[str, Any]]) -> str:
    """Return JSON with one line per row, which people can read and compare."""
    parts = [f' "about": {json.dumps(plain(about), ensure_ascii=False)}']
    for key, item in lists.items():
        rows = ",\n".join(json.dumps(row, ensure_ascii=False) for row in plain(item["rows"]))
        columns = f'"columns": {json.dumps(item["columns"])}, ' if "columns" in item else ""
        parts.append(f' {json.dumps(key)}: {{{columns}"rows": [\n{rows}\n]}}')
    return "{\n" + ",\n".join(parts) + "\n}\n"


def read_results(path: str | os.PathLike[str]) -> Results:
    """Read what `write_results` wrote, given the file or the folder that holds it.

    Raises:
        ResultsError: there is no such file, or it is not a file of results.
    """
    file = Path(path)
    if file.is_dir():
        file = file / RESULTS_FILE
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        about = content.pop("about")
        frames = {part: pd.DataFrame(item["rows"], columns=item["columns"]) for part, item in content.items()}
        return Results(about, {part: typed(frame) for part, frame in frames.items()})
    except OSError as error:
        raise ResultsError(f"{file}: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ResultsError(f"{file}: not a file of results: {error}") from error


def typed(frame: pd.DataFrame) -> pd.DataFrame:
    """Convert columns of numbers and None, which become objects when read from JSON, to numbers."""
    for name in frame:
        values = [value for value in frame[name] if value is not None]
        if frame[name].dtype == object and not any(isinstance(value, (str, bool)) for value in values):
            frame[name] = pd.to_numeric(frame[name])
    return frame


def plain(value: Any) -> Any:
    """Return the value as JSON types, with numbers rounded to seven digits."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def origin() -> dict[str, Any]:
    """Return `commit`, whether the tree is `clean`, hashes of `code` and `kernels`, and the machine."""
    return {
        "commit": _git("rev-parse", "HEAD") or "unknown",
        "clean": not _git("status", "--porcelain", "--", *PROJECT),
        "code": code(),
        "kernels": compiled.fingerprint("tracker"),
        "processor": _processor(),
        "python": platform.python_version(),
        "libraries": {name: version_of(name) for name in LIBRARIES},
        "renderer": NAME,
    }


def code() -> str:
    """Return a hash of all sources and their data, as they are on disk now."""
    digest = hashlib.sha256()
    for folder in PROJECT:
        for file in sorted((ROOT / folder).rglob("*")):
            counts = file.suffix != ".md" and file.name not in _OWN and "__pycache__" not in file.parts
            if counts and file.is_file():
                digest.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
