"""From results to the page."""

from __future__ import annotations

import base64
import math
import os
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined, select_autoescape
from markupsafe import Markup

from benchmarks.data.workloads import BY_NAME
from benchmarks.report import accuracy_plots, speed_plots, trust_plots
from benchmarks.report.sections import cards, extra_sections, visibility_table
from benchmarks.report.speed_tables import speed_tables
from benchmarks.report.summary_tables import summary_tables, target_rows
from benchmarks.report.words import DEFINITIONS
from benchmarks.score.records import FrameRecord, Results, read_results, records_of
from tracker.files import write_whole

REPORT_FILE = "report.html"

BASE, BINS = "realistic", "occlusion bins"
EXACT, PERTURBED = "realistic", "perturbed calibration"


def write_report(folder: str | os.PathLike[str]) -> Path:
    """Write `report.html` beside the `results.json` of a folder, and return its path.

    Raises:
        ResultsError: there are no results.
    """
    target = Path(folder) / REPORT_FILE
    write_whole(target, report(read_results(folder), Path(folder)))
    return target


def report(results: Results, folder: Path | None = None) -> str:
    """The page as HTML; parts that were not measured are left out.

    Args:
        results: of a run.
        folder: holds the pictures of the worst frames; None: without them.
    """
    records = records_of(results)
    targets = target_rows(results.get("targets", []))
    context = {
        "about": results.get("about", {}),
        "cards": cards(results),
        "definitions": DEFINITIONS,
        "workloads": [(name, BY_NAME[name].about) for name in _workloads(records) if name in BY_NAME],
        "targets": targets,
        **{state: sum(row["state"] == state for row in targets) for state in ("met", "missed")},
        "unmeasured": sum(row["state"] == "unknown" for row in targets),
        "visibility": visibility_table([r for r in records if r.workload in (BASE, BINS) and r.present]),
        "plots": {key: Markup(text) for key, text in _plots(records, results.get("speed", {})).items()},
        "speed_tables": speed_tables(results.get("speed", {})),
        "summaries": summary_tables(results.get("summary", {})),
        "extras": extra_sections(results),
        "worst": [] if folder is None else _worst(results.get("worst", []), records, folder),
        "style": Markup(_text("page.css")),
    }
    context["contents"] = _contents(context)
    environment = Environment(
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["seeds"] = _seeds
    environment.filters["unbroken"] = _unbroken
    return environment.from_string(_text("page.html.j2")).render(context)


def _text(name: str) -> str:
    return resources.files("benchmarks.report").joinpath(name).read_text(encoding="utf-8")


def _seeds(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {seed}" for key, seed in value.items())
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _unbroken(text: str) -> str:
    """With no break between a number and its unit."""
    return re.sub(r"(\d) (mm|px|%)|(&) (\d)", "\\1\\3\u00a0\\2\\4", text)


def _workloads(records: Sequence[FrameRecord]) -> list[str]:
    return list(dict.fromkeys(record.workload for record in records))


def _contents(context: Mapping[str, Any]) -> list[tuple[str, str]]:
    plots = context["plots"]
    wanted = [
        ("method", "Method", True),
        ("targets", "Targets", bool(context["targets"])),
        ("accuracy", "Accuracy", bool({"visible", "bound", "cumulative"} & set(plots))),
        ("trust", "Confidence and covariance", bool({"reliability", "nees"} & set(plots))),
        ("speed", "Speed", bool(context["speed_tables"])),
        ("workloads", "All workloads", bool(context["summaries"])),
        *((section["key"], section["title"], True) for section in context["extras"]),
        ("worst", "The worst frames", bool(context["worst"])),
    ]
    return [(key, title) for key, title, there in wanted if there]


def _plots(records: Sequence[FrameRecord], speed: Mapping[str, Any]) -> dict[str, str]:
    """The plots for which there are data."""
    base = [r for r in records if r.workload in (BASE, BINS) and r.present]
    bounded = [
        name
        for name in (BASE, "clean")
        if any(r.workload == name and r.found and math.isfinite(r.bound_mm) for r in records)
    ]
    sure = [
        name
        for name in (EXACT, PERTURBED)
        if any(r.workload == name and math.isfinite(r.nees) for r in records)
    ]
    plots = {}
    if any(r.found for r in base):
        plots["visible"] = accuracy_plots.against_visible_fraction(base)
    if bounded:
        plots["bound"] = accuracy_plots.against_bound(records, bounded)
    if any(r.workload == BASE and r.found for r in records):
        plots["cumulative"] = accuracy_plots.cumulative(records, BASE)
    if any(r.found for r in records):
        plots["reliability"] = trust_plots.reliability(records)
    if sure:
        plots["nees"] = trust_plots.nees(records, sure)
    if speed.get("stages") and speed.get("detect"):
        plots["stages"] = speed_plots.stages(speed["stages"], speed["detect"])
    if all(speed.get(key) for key in ("cameras", "resolution", "faces")):
        plots["scaling"] = speed_plots.scaling(speed["cameras"], speed["resolution"], speed["faces"])
    return plots


def _worst(
    rows: Sequence[Mapping[str, Any]], records: Sequence[FrameRecord], folder: Path
) -> list[dict[str, str]]:
    """Pictures as data URLs and their captions; a picture that is not there is left out."""
    by_key = {(r.workload, r.object, r.index): r for r in records}
    frames = []
    for row in rows:
        path = folder / str(row["file"])
        record = by_key.get((row["workload"], row["object"], row["index"]))
        if record is None or not path.is_file():
            continue
        data = base64.b64encode(path.read_bytes()).decode("ascii")
        title = f"{record.object}, {record.workload}, frame {record.index}."
        frames.append(
            {
                "picture": f"data:image/jpeg;base64,{data}",
                "alt": f"{title} True and estimated outline in each camera.",
                "title": title,
                "text": _caption(record),
            }
        )
    return frames


def _caption(record: FrameRecord) -> str:
    seen = f"visible fraction {record.visible_fraction:.2f}" if record.present else "there is no object"
    if not record.found:
        return f"No pose: {record.status}; {seen}."
    stated = f"confidence {record.confidence:.3f}"
    if not record.present:
        return f"Found, though {seen}; {stated}."
    errors = f"{record.position_mm:.2f} mm, {record.rotation_deg:.2f}°"
    roll = f" (roll {record.roll_deg:.2f}°)" if math.isfinite(record.roll_deg) else ""
    nees = f"; NEES {record.nees:.3g}" if math.isfinite(record.nees) else ""
    return f"Error {errors}{roll}; {stated}{nees}; {seen}."
