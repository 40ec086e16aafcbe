"""Targets and figures of the workloads as tables, for the report and for Markdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmarks.report.table import Table

Row = Mapping[str, Any]

_VERDICTS = {True: ("met", "✓ met"), False: ("missed", "✗ missed"), None: ("unknown", "not measured")}


def target_rows(targets: Sequence[Row]) -> list[dict[str, str]]:
    """Targets as text; `state` is met, missed or unknown."""
    rows = []
    for target in targets:
        state, verdict = _VERDICTS[target["met"] if is_number(target["value"]) else None]
        unit = target["unit"]
        rows.append(
            {
                "name": str(target["name"]),
                "object": str(target["object"] or ""),
                "wanted": _with_unit(target["target"], unit),
                "reached": _with_unit(target["value"], unit),
                "state": state,
                "verdict": verdict,
            }
        )
    return rows


def summary_tables(summary: Mapping[str, Mapping[str, Row]]) -> list[tuple[str, list[Table]]]:
    """For each object its tables, with a row for each workload; columns that no workload has are left out."""
    names = list(dict.fromkeys(name for objects in summary.values() for name in objects))
    result = []
    for name in names:
        rows = {workload: objects[name] for workload, objects in summary.items() if name in objects}
        tables = [_summary_table(title, columns, rows) for title, columns in GROUPS]
        result.append((name, [table for table in tables if table is not None]))
    return result


Format = Callable[[float], str]


def _fixed(digits: int, unit: str = "") -> Format:
    return lambda value: f"{value:.{digits}f}{unit}"


_COUNT, PERCENT = _fixed(0), _fixed(1, " %")
MM, DEG, _RATIO = _fixed(3, " mm"), _fixed(2, "°"), _fixed(2)

GROUPS: tuple[tuple[str, tuple[tuple[str, str, Format], ...]], ...] = (
    (
        "Errors of the poses given",
        (
            ("frames", "frames", _COUNT),
            ("median_mm", "position, median", MM),
            ("p90_mm", "p90", MM),
            ("p99_mm", "p99", MM),
            ("median_deg", "rotation, median", DEG),
            ("p90_deg", "p90", DEG),
            ("p99_deg", "p99", DEG),
            ("median_axis_deg", "long axis", DEG),
            ("median_roll_deg", "roll", DEG),
        ),
    ),
    (
        "Answers, of all frames",
        (
            ("within_1", "within 1 mm & 1°", PERCENT),
            ("within_5", "within 5 mm & 5°", PERCENT),
            ("misses", "missed", PERCENT),
            ("wrong", "wrong", PERCENT),
            ("wrong_and_sure", "wrong and sure", PERCENT),
            ("false_finds", "false finds", _COUNT),
            ("median_nees", "NEES, median", _fixed(1)),
            ("brier", "Brier score", _fixed(4)),
            ("median_ms", "time, median", _fixed(1, " ms")),
        ),
    ),
    (
        "The field's and the tasks' measures",
        (
            ("median_add_mm", "ADD", MM),
            ("median_mssd_mm", "MSSD", MM),
            ("median_mspd_px", "MSPD", _fixed(3, " px")),
            ("add_recall", "ADD < 10 %", PERCENT),
            ("ar_add", "AR ADD", PERCENT),
            ("ar_mssd", "AR MSSD", PERCENT),
            ("ar_mspd", "AR MSPD", PERCENT),
            ("mean_task_position_error", "task's position error", _fixed(5)),
            ("mean_task_rotation_error", "rotation error", _fixed(5)),
        ),
    ),
    (
        "Errors over the Cramér–Rao bound",
        (
            ("bound_mm", "position: bound, median", MM),
            ("bound_ratio_mm", "ratio of medians", _RATIO),
            ("bound_median_ratio_mm", "median of ratios", _RATIO),
            ("bound_deg", "rotation: bound, median", _fixed(3, "°")),
            ("bound_ratio_deg", "ratio of medians", _RATIO),
            ("bound_median_ratio_deg", "median of ratios", _RATIO),
            ("bound_fixed_mm", "position: bound of 0.3 px", MM),
            ("bound_fixed_ratio_mm", "ratio of medians", _RATIO),
        ),
    ),
)
"""Tables of an object: key in the summary, heading, and how to write a value."""


def _summary_table(
    title: str, columns: Sequence[tuple[str, str, Format]], rows: Mapping[str, Row]
) -> Table | None:
    kept = [column for column in columns if any(is_number(row.get(column[0])) for row in rows.values())]
    if not kept:
        return None
    cells = [
        [workload, *(write(row[key]) if is_number(row.get(key)) else "–" for key, _, write in kept)]
        for workload, row in rows.items()
        if any(is_number(row.get(key)) for key, _, _ in kept)
    ]
    return Table(("workload", *(heading for _, heading, _ in kept)), cells, title)


def is_number(value: Any) -> bool:
    """Whether something was measured: neither missing nor nan nor infinite."""
    return isinstance(value, (int, float)) and math.isfinite(value)


def written(value: float | None, digits: int, unit: str = "") -> str:
    """A number with so many digits and its unit; a dash where nothing was measured."""
    return f"{value:.{digits}f}{unit}" if value is not None and is_number(value) else "–"


def _with_unit(value: Any, unit: str) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, str):
        return value
    digits = 4 if unit == "%" else 3
    text = f"{value:.{digits}g}" if isinstance(value, float) else str(value)
    return f"{text}{'' if unit in ('', '°') else ' '}{unit}".strip()
