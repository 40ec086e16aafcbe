"""Other rigs as tables, and their section of `results.md`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.data.rig_cases import CASES
from benchmarks.measure.rigs import NEAR_DEG, NEAR_MM
from benchmarks.measure.timing import RIGHT_DEG, RIGHT_MM
from benchmarks.report.summary_tables import written
from benchmarks.report.table import Table


def rigs_markdown(rigs: Mapping[str, Any]) -> list[str]:
    """The section's paragraphs and tables."""
    about = rigs["about"]
    method = (
        f"{about['scenes']} ray-cast scenes for each rig and object, every other one with fingers; seed "
        f"{about['seed']}. Exact calibration, one detection without memory. Medians are of the poses given, "
        "shares of all scenes."
    )
    names = dict.fromkeys(part["rig"] for part in rigs["rows"])
    kinds = [[name, CASES[name].about] for name in names if name in CASES]
    return [
        method,
        Table(("rig", "cameras and object"), kinds, "", frozenset({0, 1})).markdown(),
        rigs_table(rigs["rows"]).markdown(),
    ]


def rigs_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Right answers, errors and times."""
    cells = [
        [
            part["rig"],
            part["object"],
            f"{part['scenes']}",
            written(part["visible"], 0, " %"),
            written(part["within_1"], 1, " %"),
            written(part["within_5"], 1, " %"),
            written(part["median_mm"], 3, " mm"),
            written(part["median_deg"], 3, "°"),
            written(part["none"], 1, " %"),
            written(part["wrong_and_sure"], 1, " %"),
            written(part["median_ms"], 1, " ms"),
            written(part["ratio"], 2, " ×"),
        ]
        for part in rows
    ]
    heads = (
        "rig",
        "object",
        "scenes",
        "visible",
        f"within {NEAR_MM:g} mm & {NEAR_DEG:g}°",
        f"within {RIGHT_MM:g} mm & {RIGHT_DEG:g}°",
        "position, median",
        "rotation",
        "no pose",
        "wrong and sure",
        "time, median",
        "over reference",
    )
    return Table(heads, cells, "", frozenset({0, 1}))
