"""Tables of finished text, made from rows of figures by the data in `tables.toml`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.judge.results import Results
from benchmarks.judge.targets import Judged
from benchmarks.score.shares import interval
from benchmarks.toml_files import read_toml

FILE = Path(__file__).with_name("tables.toml")

_FIELD = re.compile(r"\{(\w+)(?::([^}]*))?\}")

_VERDICTS = {"met": "✓ met", "missed": "✗ missed", "unknown": "not measured"}

NOTHING = "–"
"""Stands for what was not measured."""


@dataclass(frozen=True)
class Table:
    """Headings and rows of cells; numbers are flush right."""

    heads: Sequence[str]
    """Headings of the columns."""
    rows: Sequence[Sequence[str]]
    """Cells, as many in each row as there are headings."""
    caption: str = ""
    """What it shows."""
    texts: frozenset[int] = frozenset({0})
    """Numbers of the columns that hold words, and are flush left."""


def is_number(value: Any) -> bool:
    """Whether something was measured: neither missing nor nan nor infinite."""
    return isinstance(value, (int, float)) and math.isfinite(value)


def cell(template: str, row: Mapping[str, Any]) -> str:
    """A template's text with a row's values in place of `{name}` and `{name:format}`.

    The format `±` gives the 95 % interval of a share [%] of the row's `n`. Where none of the values is there
    the whole cell stays empty.
    """
    found = [0]

    def fill(match: re.Match[str]) -> str:
        value, form = row.get(match[1]), match[2]
        if isinstance(value, str):
            found[0] += 1
            return value
        if not is_number(value):
            return NOTHING
        assert value is not None
        found[0] += 1
        if form == "±":
            low, high = interval(float(value), int(row["n"]))
            return f"{low:.1f}-{high:.1f}"
        return format(value, form or "")

    text = _FIELD.sub(fill, template)
    return text if found[0] or not _FIELD.search(template) else NOTHING


def tables_of(spec: Mapping[str, Any], results: Results) -> list[Table]:
    """The table of a `[[section.table]]`, or one for each object; none without rows."""
    rows = [row for row in results.rows if row["part"] == spec["part"] and _chosen(row, spec)]
    if not spec.get("each_object"):
        return _table(spec, rows, spec.get("caption", ""))
    names = dict.fromkeys(row["object"] for row in rows)
    return [
        table
        for name in names
        for table in _table(spec, [r for r in rows if r["object"] == name], f"{spec['caption']}: {name}")
    ]


def _chosen(row: Mapping[str, Any], spec: Mapping[str, Any]) -> bool:
    return row.get("group", "") in spec.get("groups", [row.get("group", "")])


def _table(spec: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], caption: str) -> list[Table]:
    """Columns, and rows, that hold nothing measured are left out."""
    words = [(head, f"{{{key}}}") for head, key in spec["words"]]
    columns = [(head, template) for head, template in spec.get("columns", ())]
    if not columns:  # every figure is a column
        known = {"part", "group", "bin", "object", "n"}
        names = sorted({key for row in rows for key in row if key not in known})
        columns = [(name, f"{{{name}:.0f}}") for name in names]
    cells = [[cell(template, row) for _, template in columns] for row in rows]
    kept = [k for k in range(len(columns)) if any(line[k] != NOTHING for line in cells)]
    lines = [
        [*(cell(template, row) for _, template in words), *(line[k] for k in kept)]
        for row, line in zip(rows, cells, strict=True)
        if any(line[k] != NOTHING for k in kept)
    ]
    heads = [*(head for head, _ in words), *(columns[k][0] for k in kept)]
    return [Table(heads, lines, caption, frozenset(range(len(words))))] if lines else []


def target_table(targets: Sequence[Judged]) -> Table:
    """Targets and what was reached."""
    rows = [[row.name, row.object, row.wanted, _reached(row), _VERDICTS[row.state]] for row in targets]
    return Table(("", "object", "target", "reached", ""), rows, "", frozenset({0, 1, 4}))


def _reached(row: Judged) -> str:
    if not is_number(row.value):
        return NOTHING
    space = "" if row.unit in ("", "°") else " "
    return f"{row.value:.{4 if row.unit == '%' else 3}g}{space}{row.unit}"


def specification() -> dict[str, Any]:
    """Sections and their tables, texts and definitions."""
    return read_toml(FILE)
