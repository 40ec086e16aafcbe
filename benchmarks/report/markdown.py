"""Presents results as Markdown: all figures, and those shown in the documentation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.data.plan import FULL
from benchmarks.score.metrics import NOTHING, Table, matches
from benchmarks.score.tables import TABLES

NOTES = Path(__file__).with_name("notes.md")
"""File with hand-written remarks on the figures: causes of missed targets, and what was tried."""

Figures = Sequence[Mapping[str, Any]]

Judged = Sequence[Mapping[str, Any]]


def document(about: Mapping[str, Any], figures: Figures, judged: Judged) -> str:
    """Return a document of everything that was measured; other parts are left out."""
    parts = ["# Results", summary(about), "`python -m benchmarks all --publish` publishes such results."]
    parts.append("\n".join(f"- {line}" for line in _made(about)))
    skipped = about.get("skipped", {})
    if skipped:
        parts.append("Left out: " + "; ".join(f"{name} ({why})" for name, why in skipped.items()) + ".")
    parts += targets(judged)
    if judged and NOTES.is_file():
        parts += ["## What limits what was missed", NOTES.read_text(encoding="utf-8").strip()]
    return "\n\n".join([*parts, *missing(figures), *tables(figures, TABLES)]) + "\n"


def page(about: Mapping[str, Any], figures: Figures, judged: Judged) -> str:
    """Return the content of the figures page."""
    groups = {table.name: table.page for table in TABLES}
    shown = [row for row in figures if matches(row["group"], groups[row["table"]])]
    return "\n\n".join([summary(about), *_counted(judged), *missing(figures), *tables(shown, TABLES)])


def missing(figures: Figures) -> list[str]:
    """Return a sentence that lists the tables that a run did not measure."""
    known = {row["table"] for row in figures}
    names = [table.title for table in TABLES if table.name not in known]
    return [f"Not measured in this run: {', '.join(names)}."] if figures and names else []


def tables(figures: Figures, chosen: Iterable[Table]) -> list[str]:
    """Return title, text and table for each table that has rows."""
    parts: list[str] = []
    for table in chosen:
        rows = [row for row in figures if row["table"] == table.name]
        if rows:
            parts += [f"## {table.title}", table.text, _table(table, rows)]
    return parts


def _table(table: Table, rows: Figures) -> str:
    """Return a table, without the columns that hold no measurement."""
    labels = [(key, head) for key, head in zip(("object", "group", "bin"), table.heads, strict=True)]
    labels = [(key, head) for key, head in labels if head or (key != "object" and any(r[key] for r in rows))]
    cells = {metric: [metric.text(row.get(metric.name)) for row in rows] for metric in table.metrics}
    kept = [metric for metric, texts in cells.items() if any(text != NOTHING for text in texts)]
    heads = [*(head for _, head in labels), "n", *(metric.title for metric in kept)]
    lines = [
        [*(str(row[key]) for key, _ in labels), str(row["n"]), *(cells[metric][k] for metric in kept)]
        for k, row in enumerate(rows)
    ]
    return grid(heads, lines, len(labels))


def grid(heads: Sequence[str], lines: Iterable[Sequence[str]], words: int) -> str:
    """Return a Markdown table; all but the first `words` columns are right-aligned."""
    rule = ["---"] * words + ["---:"] * (len(heads) - words)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [heads, rule, *lines])


def targets(judged: Judged) -> list[str]:
    """Return the targets with their verdicts."""
    if not judged:
        return []
    (text,) = _counted(judged)
    lines = [
        [row[key] for key in ("name", "object", "target", "reached", "interval")]
        + [str(row["n"]), VERDICTS[row["verdict"]]]
        for row in judged
    ]
    heads = ("", "object", "target", "reached", "95 % interval", "n", "")
    return ["## Targets", text, grid(heads, lines, 2)]


def _counted(judged: Judged) -> list[str]:
    """Return a sentence with the numbers of targets met, missed and undecided."""
    if not judged:
        return []
    counts = {verdict: sum(row["verdict"] == verdict for row in judged) for verdict in VERDICTS}
    return [
        f"Targets: {counts['met']} met, {counts['missed']} missed, {counts['undecided']} undecided. Their "
        "95 % interval lies within the target, outside it, or on both sides."
    ]


VERDICTS = {"met": "✓ met", "missed": "✗ missed", "undecided": "? undecided"}

FEW = 100
"""Number of scenes below which a run only shows that everything works."""


def summary(about: Mapping[str, Any]) -> str:
    """Return a summary of a run: commit, machine and scenes."""
    drawn = {
        "development": "development scenes (a fixed seed; they may be looked at and worked on)",
        "release": "release scenes (drawn from the commit's hash and seen by no one)",
    }.get(about.get("draw", ""), "scenes of another seed")
    few = " Too few scenes for the figures to mean much." if about.get("scenes", FULL) < FEW else ""
    changes = "" if about.get("clean", True) else " and changes"
    return (
        f"Commit {str(about.get('commit', 'unknown'))[:12]}{changes}, "
        f"{about.get('processor', 'processor unknown')}, one thread. {about.get('scenes', '?')} scenes an "
        f"object: {drawn}, seed {about.get('seed', 'unknown')}.{few}"
    )


def _made(about: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}: {spoken(made['seconds'])}, commit "
        f"{made['commit'][:12]}{'' if made['clean'] else ' and changes'}, {made['processor']}, Python "
        f"{made['python']}, renderer {made['renderer']}, "
        + ", ".join(f"{library} {version}" for library, version in made["libraries"].items())
        for name, made in about.get("parts", {}).items()
    ]


def spoken(seconds: float) -> str:
    """Return a duration as text."""
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
