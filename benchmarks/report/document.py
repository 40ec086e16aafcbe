"""From results to one document, written as Markdown or as a page by the same template."""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from benchmarks.data.sets import FULL
from benchmarks.judge.gate import read_baseline
from benchmarks.judge.results import Results, read_results
from benchmarks.judge.targets import Judged, evaluate
from benchmarks.measure.estimate import spoken
from benchmarks.report.plots import plots_of
from benchmarks.report.table import Table, is_number, specification, tables_of, target_table
from tracker.files import write_whole

REPORT_FILE = "report.html"

NOTES = Path(__file__).with_name("notes.md")
"""What people say about the figures: causes of missed targets, and what was tried."""

BASE = "realistic"

FEW = 100
"""Scenes below which a run only shows that everything works."""


@dataclass(frozen=True)
class Section:
    """A part of the document; what is empty is left out."""

    key: str
    title: str
    text: str = ""
    """Paragraphs and lists, as in Markdown."""
    plots: Sequence[tuple[str, Markup, str]] = ()
    """Key, SVG and caption; on the page alone."""
    tables: Sequence[Table] = ()
    pictures: Sequence[Mapping[str, str]] = field(default_factory=list)
    """`picture` as a data URL, `title`, `text`, `alt`; on the page alone."""


def write_report(folder: str | os.PathLike[str]) -> Path:
    """Write `report.html` beside the `results.json` of a folder, and return its path.

    Raises:
        ResultsError: there are no results.
    """
    target = Path(folder) / REPORT_FILE
    write_whole(target, page(read_results(folder), Path(folder)))
    return target


def markdown(results: Results) -> str:
    """The document as Markdown; parts that were not measured are left out."""
    text = _environment(autoescape=False).get_template("body.j2").render(_context(results, "markdown.j2"))
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def table_markdown(table: Table) -> str:
    """A table by itself as Markdown."""
    template = _environment(autoescape=False).get_template("markdown.j2")
    written: Any = template.make_module({"about": {}})
    return str(written.table(table)).strip()


def page(results: Results, folder: Path | None = None) -> str:
    """The document as a page; `folder` holds the pictures of the worst frames, None: without them."""
    context = _context(results, "html.j2", folder)
    return _environment(autoescape=True).get_template("body.j2").render(context)


def _environment(autoescape: bool) -> Environment:
    environment = Environment(
        loader=PackageLoader("benchmarks.report", "."),
        autoescape=autoescape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"code": _code, "blocks": _blocks, "unbroken": _unbroken}
    environment.filters["bars"] = lambda text: str(text).replace("|", "\\|")
    return environment


def _context(results: Results, flavour: str, folder: Path | None = None) -> dict[str, Any]:
    targets = evaluate(results) if results.rows else []
    return {
        "flavour": flavour,
        "about": {
            "summary": summary(results.about),
            "parts_made": [*_made(results.about), _baseline()],
            "skipped": results.about.get("skipped", {}),
        },
        "cards": _cards(results, targets),
        "definitions": specification()["definitions"],
        "sections": _sections(results, targets, folder, plots=flavour == "html.j2"),
        "style": Markup(Path(__file__).with_name("page.css").read_text(encoding="utf-8")),
    }


def summary(about: Mapping[str, Any]) -> str:
    """Commit, processor and scenes of a run."""
    drawn = {
        "development": "development scenes (a fixed seed; they may be looked at and worked on)",
        "release": "release scenes (drawn anew from the commit's hash; nobody has seen them)",
        "judging": "scenes of a fixed seed that nothing was adjusted with",
    }.get(about.get("draw", ""), "scenes of another seed")
    few = " Too few scenes for the figures to mean much." if about.get("scenes", FULL) < FEW else ""
    changes = "" if about.get("clean", True) else " and changes"
    tree = f"Commit {str(about.get('commit', 'unknown'))[:12]}{changes}"
    count = f"{about.get('scenes', '?')} realistic scenes an object, everything else in proportion"
    processor = about.get("processor", "processor unknown")
    return f"{tree}, {processor}, one thread. {count}: {drawn}, seed {about.get('seed', 'unknown')}.{few}"


def _made(about: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}: made of commit {made['commit'][:12]}{'' if made['clean'] else ' and changes'} in "
        f"{spoken(made['seconds'])} (estimated: {spoken(made.get('estimated', 0))})"
        for name, made in about.get("parts", {}).items()
    ]


def _baseline() -> str:
    found = read_baseline()
    return f"the gate's baseline is of commit {str(found['commit'])[:12]}; its reason: {found['reason']}"


def _sections(results: Results, targets: Sequence[Judged], folder: Path | None, plots: bool) -> list[Section]:
    drawn = plots_of(results) if plots else {}
    sections = []
    if any(target.state != "unknown" for target in targets):
        sections.append(Section("targets", "Targets", _counted(targets), tables=[target_table(targets)]))
        notes = NOTES.read_text(encoding="utf-8").strip()
        sections.append(Section("limits", "What limits what was missed, and what was tried", notes))
    for spec in specification()["section"]:
        tables = [table for part in spec["table"] for table in tables_of(part, results)]
        own = [(key, Markup(drawn[key]), text) for key, text in spec.get("plots", ()) if key in drawn]
        if tables or own:
            sections.append(Section(spec["key"], spec["title"], spec.get("text", ""), own, tables))
    pictures = [] if folder is None else _worst(results, folder)
    if pictures:
        sections.append(Section("worst", "The worst frames", specification()["worst"], pictures=pictures))
    return sections


def _counted(targets: Sequence[Judged]) -> str:
    count = {state: sum(row.state == state for row in targets) for state in ("met", "missed", "unknown")}
    text = f"{count['met']} of {len(targets)} met, {count['missed']} missed"
    return text + (f", {count['unknown']} not measured in this run." if count["unknown"] else ".")


def _cards(results: Results, targets: Sequence[Judged]) -> list[dict[str, str]]:
    """The few figures at the top."""
    found = []
    judged = [row for row in targets if row.state != "unknown"]
    if judged:
        met = sum(row.state == "met" for row in judged)
        found.append({"value": f"{met} of {len(judged)}", "label": "targets met"})
    for row in results.rows:
        if row["part"] == "accuracy" and row["group"] == BASE and is_number(row.get("median_mm")):
            value = f"{row['median_mm']:.3f} mm, {row['median_deg']:.2f}°"
            found.append({"value": value, "label": f"{row['object']}, median error"})
    times = [row for row in results.rows if row["part"] == "time" and row["group"].startswith("rendered")]
    if times:
        worst = max(times, key=lambda row: float(row["ratio"]))
        label = f"a detection; {worst['ratio']:.2f} × reference"
        found.append({"value": f"{worst['median_ms']:.1f} ms", "label": label})
    return found


def _blocks(text: str) -> list[tuple[str, list[str]]]:
    """Paragraphs (`p`) and lists (`ul`) with their items."""
    blocks = []
    for part in re.split(r"\n\s*\n", text.strip()):
        is_list = part.startswith("- ")
        items = re.split(r"\n- ", part.removeprefix("- ")) if is_list else [part]
        blocks.append(("ul" if is_list else "p", [" ".join(item.split()) for item in items]))
    return blocks


def _code(text: str) -> Markup:
    """With `words` as code, **words** as strong ones."""
    safe = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", safe))


def _unbroken(text: str) -> str:
    """With no break between a number and its unit."""
    return re.sub(r"(\d) (mm|px|%)|(&) (\d)", "\\1\\3\u00a0\\2\\4", text)


def _worst(results: Results, folder: Path) -> list[dict[str, str]]:
    """Pictures as data URLs and their captions; a picture that is not there is left out."""
    frames = results.frames.set_index(["workload", "object", "index"], drop=False)
    found = []
    for row in results.worst:
        path, key = folder / str(row["file"]), (row["workload"], row["object"], row["index"])
        if path.is_file() and key in frames.index:
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            title = f"{row['object']}, {row['workload']}, frame {row['index']}."
            found.append(
                {
                    "picture": f"data:image/jpeg;base64,{data}",
                    "alt": f"{title} True and estimated outline in each camera.",
                    "title": title,
                    "text": _caption(frames.loc[key]),
                }
            )
    return found


def _caption(frame: pd.Series) -> str:
    seen = f"visible fraction {frame.visible_fraction:.2f}" if frame.present else "there is no object"
    if not frame.found:
        return f"No pose: {frame.status}; {seen}."
    stated = f"confidence {frame.confidence:.3f}"
    if not frame.present:
        return f"Found, though {seen}; {stated}."
    roll = f" (roll {frame.roll_deg:.2f}°)" if is_number(frame.roll_deg) else ""
    nees = f"; NEES {frame.nees:.3g}" if is_number(frame.nees) else ""
    return f"Error {frame.position_mm:.2f} mm, {frame.rotation_deg:.2f}°{roll}; {stated}{nees}; {seen}."
