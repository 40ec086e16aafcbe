"""The parts of the page that are words and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.report.summary_tables import DEG, MM, PERCENT, is_number, target_rows
from benchmarks.report.table import Table
from benchmarks.report.tables import recorded_table, segmentation_table
from benchmarks.score.records import FrameRecord, Results
from benchmarks.score.summary import by_visibility

BASE = "realistic"


def cards(results: Results) -> list[dict[str, str]]:
    """The few figures at the top."""
    found = []
    targets = target_rows(results.get("targets", []))
    judged = [row for row in targets if row["state"] != "unknown"]
    if judged:
        met = sum(row["state"] == "met" for row in judged)
        found.append({"value": f"{met} of {len(judged)}", "label": "targets met"})
    for name, metrics in results.get("summary", {}).get(BASE, {}).items():
        if is_number(metrics.get("median_mm")):
            value = f"{metrics['median_mm']:.3f} mm, {metrics['median_deg']:.2f}°"
            found.append({"value": value, "label": f"{name}, median error"})
    rows = [row for row in results.get("speed", {}).get("detect", []) if row["images"] == "rendered"]
    if rows:
        worst = max(rows, key=lambda row: row["ratio"])
        label = f"a detection; {worst['ratio']:.2f} × reference"
        found.append({"value": f"{worst['median_ms']:.1f} ms", "label": label})
    return found


def visibility_table(records: Sequence[FrameRecord]) -> Table | None:
    """Answers by bins of visible fraction, for each object; None without any frame."""
    rows = []
    for name in dict.fromkeys(record.object for record in records):
        for part in by_visibility([r for r in records if r.object == name]):
            if part["frames"]:
                rows.append(
                    [
                        name,
                        f"{part['low']:g}–{part['high']:g}",
                        f"{part['frames']}",
                        *(PERCENT(part[key]) for key in ("within_5", "misses")),
                        *(write(part[key]) for key, write in (("median_mm", MM), ("median_deg", DEG))),
                    ]
                )
    heads = (
        "object",
        "visible",
        "frames",
        "within 5 mm & 5°",
        "missed",
        "position, median",
        "rotation, median",
    )
    return Table(heads, rows) if rows else None


def extra_sections(results: Results) -> list[dict[str, Any]]:
    """Recorded triplets and segmentation, where measured: `key`, `title` and `tables`."""
    found = []
    if results.get("recorded"):
        tables = [recorded_table(results["recorded"]["triplets"])]
        found.append({"key": "recorded", "title": "Recorded triplets", "tables": tables})
    if results.get("segmentation"):
        tables = [segmentation_table(results["segmentation"]["objects"])]
        found.append({"key": "segmentation", "title": "Segmentation", "tables": tables})
    return found
