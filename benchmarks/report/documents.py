"""Presents results as Markdown: all figures, and those in marked blocks of README.md and docs/figures.md."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.data.fingerprint import ROOT
from benchmarks.data.plan import FULL
from benchmarks.data.scenes import OBJECTS
from benchmarks.judge.results import ResultsError
from benchmarks.score.metrics import NOTHING, Table, matches
from benchmarks.score.tables import BY_NAME, TABLES
from tracker.files import write_whole

README, PAGE, RESULTS = ROOT / "README.md", ROOT / "docs" / "figures.md", ROOT / "benchmarks" / "results.md"
"""Files with a few figures, with many, and with all."""

PUBLISHED = ROOT / "benchmarks" / "published.json"
"""Origin, figures and targets of the last published run."""

BEGIN, END = "<!-- figures: written by python -m benchmarks, of published.json -->", "<!-- /figures -->"

NOTES = Path(__file__).with_name("notes.md")
"""File with hand-written remarks on the figures: causes of missed targets, and what was tried."""

Figures = Sequence[Mapping[str, Any]]

Judged = Sequence[Mapping[str, Any]]


def document(about: Mapping[str, Any], figures: Figures, judged: Judged) -> str:
    """Return a document of everything that was measured; other parts are left out."""
    parts = ["# Results", summary(about), "`python -m benchmarks all --publish` publishes such results."]
    parts.append("\n".join(f"- {line}" for line in _made(about)))
    skipped = [one for made in about.get("parts", {}).values() for one in made.get("skipped", {}).items()]
    if skipped:
        parts.append("Left out: " + "; ".join(f"{name} ({why})" for name, why in skipped) + ".")
    parts += targets(judged)
    if judged and NOTES.is_file():
        parts += ["## What limits what was missed", NOTES.read_text(encoding="utf-8").strip()]
    return "\n\n".join([*parts, *missing(figures), *tables(figures)]) + "\n"


def missing(figures: Figures) -> list[str]:
    """Return a sentence that lists the tables that a run did not measure."""
    known = {row["table"] for row in figures}
    names = [table.title for table in TABLES if table.name not in known]
    return [f"Not measured in this run: {', '.join(names)}."] if figures and names else []


def tables(figures: Figures) -> list[str]:
    """Return title, text and table for each table that has rows."""
    parts: list[str] = []
    for table in TABLES:
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
    return ["## Targets", text + " A film counts once (n): its frames are alike.", grid(heads, lines, 2)]


def _counted(judged: Judged) -> list[str]:
    """Return a sentence with the numbers of targets met, missed and undecided."""
    if not judged:
        return []
    counts = {verdict: sum(row["verdict"] == verdict for row in judged) for verdict in VERDICTS}
    return [
        f"Targets: {counts['met']} met, {counts['missed']} missed, {counts['undecided']} undecided: the "
        "95 % interval is within the target, outside it, or on both sides."
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


def read_published() -> dict[str, Any]:
    """Return origin (`about`), `figures` and `targets` of the last published run."""
    content = json.loads(PUBLISHED.read_text(encoding="utf-8"))
    return {"about": content["about"]} | {key: content[key]["rows"] for key in ("figures", "targets")}


def brief(published: Mapping[str, Any]) -> str:
    """Return README.md's block without its marks."""
    found = {
        (row["table"], row["group"], row["object"]): row for row in published["figures"] if not row["bin"]
    }

    def both(table: str, group: str, form: str) -> str:
        rows = [found.get((table, group, name)) for name in OBJECTS]
        lacking = {metric.name: math.nan for metric in BY_NAME[table].metrics}
        texts = [form.format(**(lacking | row)) if row else "not measured" for row in rows]
        return " / ".join(texts).replace("nan", NOTHING)

    def line(head: str, table: str, form: str, films: bool = False) -> list[str]:
        groups = ("world", "all" if films else "realistic")
        return [head, *(both(table, group, form) for group in groups)]

    lines = [
        line("median error", "accuracy", "{median_mm:.2f} mm, {median_deg:.1f}°"),
        line("90th percentile", "accuracy", "{p90_mm:.2f} mm, {p90_deg:.1f}°"),
        line("within 5 mm and 5°", "accuracy", "{within_5:.1f} %"),
        line("wrong and sure", "accuracy", "{wrong_and_sure:.1f} %"),
        line("inside the 95 % ellipsoid", "trust", "{inside_95:.0f} %"),
        line("`detect`, median", "detect", "{median_ms:.1f} ms"),
        line("`update`, median", "update", "{median_ms:.1f} ms", films=True),
    ]
    heads = ("cube / cuboid", "like a real platform ¹", "exact calibration ²")
    notes = (
        "Three 270×270 images, rendered with exact truth; one thread. ¹ Every effect that the generator "
        "knows, calibration errors too. ² Sharp edges."
    )
    about = published["about"]
    origin = f"Commit {str(about['commit'])[:12]}, {about['scenes']} fresh scenes an object."
    return f"{grid(heads, lines, 1)}\n\n{notes} {origin}"


def figures(published: Mapping[str, Any]) -> str:
    """Return the figures page's block without its marks."""
    groups = {table.name: table.page for table in TABLES}
    shown = [row for row in published["figures"] if matches(row["group"], groups[row["table"]])]
    parts = [summary(published["about"]), *_counted(published["targets"]), *missing(published["figures"])]
    return "\n\n".join([*parts, *tables(shown)])


def block(path: Path) -> str:
    """Return the text between the marks of a file.

    Raises:
        ResultsError: there are no marks.
    """
    return _parts(path)[1].strip()


def _parts(path: Path) -> Sequence[str]:
    before, begin, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    inside, end, after = rest.partition(END)
    if not begin or not end:
        raise ResultsError(f"{path.name}: found no block between {BEGIN} and {END}")
    return before, inside, after


def write_documents(published: Mapping[str, Any]) -> None:
    """Write results.md, and the figures into the blocks of README.md and docs/figures.md.

    Raises:
        ResultsError: one of them has no block.
    """
    texts = {README: brief(published), PAGE: figures(published)}
    parts = {path: _parts(path) for path in texts}
    for path, inside in texts.items():
        write_whole(path, f"{parts[path][0]}{BEGIN}\n{inside}\n{END}{parts[path][2]}")
    write_whole(RESULTS, document(published["about"], published["figures"], published["targets"]))
