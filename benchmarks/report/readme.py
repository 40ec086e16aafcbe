"""Blocks of figures between marks in README.md and docs/figures.md, written from the published results."""

from __future__ import annotations

from pathlib import Path

from benchmarks.data.fingerprint import ROOT
from benchmarks.judge.results import Results, ResultsError
from benchmarks.report.document import summary, table_markdown
from benchmarks.report.table import specification, tables_of
from tracker.files import write_whole

README, PAGE = ROOT / "README.md", ROOT / "docs" / "figures.md"
"""Where a few of the figures stand, and where many do."""

PUBLISHED = ROOT / "benchmarks" / "published.json"
"""Rows of the last published run, without its frames."""

BEGIN, END = "<!-- figures: written by python -m benchmarks, of published.json -->", "<!-- /figures -->"


BRIEF = """\
| three 270×270 images, fingers in view | this tracker | the platform's present one |
|---|---|---|
| median error, cube | {cube[median_mm]:.2f} mm, {cube[median_deg]:.2f}° | 1.41 mm, 2.0° |
| median error, cuboid | {cuboid[median_mm]:.2f} mm, {cuboid[median_deg]:.2f}° | 1.28 mm, 3.0° |
| within 5 mm and 5° | {cube[within_5]:.1f}, {cuboid[within_5]:.1f} % | 95–98, 88–90 % |
| time, one thread | {ms:.1f} ms | 54 ms |"""
"""The other's figures are those that its users measured on rendered images with exact truth."""


def brief(results: Results) -> str:
    """README.md's block without its marks; empty where those figures were not measured."""
    rows = {
        (row["part"], row["group"], row["object"]): row
        for row in results.rows
        if (row["part"], row.get("group")) in {("accuracy", "realistic"), ("time", "rendered, 270×270")}
    }
    try:
        cube, cuboid = (rows["accuracy", "realistic", name] for name in ("cube_v2", "cuboid_2x2x8_v2"))
        ms = max(row["median_ms"] for (part, _, _), row in rows.items() if part == "time")
    except (KeyError, ValueError):
        return ""
    return f"{BRIEF.format(cube=cube, cuboid=cuboid, ms=ms)}\n\n{summary(results.about)}"


def figures(results: Results) -> str:
    """The block of the page of figures without its marks."""
    parts = [summary(results.about)]
    for spec in specification()["readme"]:
        tables = tables_of(spec, results)
        if tables:
            parts += [f"## {spec['title']}", spec["text"].strip(), *map(table_markdown, tables)]
    return "\n\n".join(parts)


def block(path: Path) -> str:
    """What stands between the marks of a file.

    Raises:
        ResultsError: there are no marks.
    """
    return _parts(path.read_text(encoding="utf-8"), path)[1].strip()


def _parts(text: str, path: Path) -> tuple[str, str, str]:
    before, begin, rest = text.partition(BEGIN)
    inside, end, after = rest.partition(END)
    if not begin or not end:
        raise ResultsError(f"{path.name}: found no block between {BEGIN} and {END}")
    return before, inside, after


def write_figures(results: Results) -> None:
    """Put the figures of results into README.md's block and into that of docs/figures.md.

    Raises:
        ResultsError: one of them has none.
    """
    texts = {path: path.read_text(encoding="utf-8") for path in (README, PAGE)}
    for path, text in texts.items():
        _parts(text, path)
    for path, inside in ((README, brief(results)), (PAGE, figures(results))):
        before, _, after = _parts(texts[path], path)
        write_whole(path, f"{before}{BEGIN}\n{inside}\n{END}{after}")
