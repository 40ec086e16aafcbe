"""The figures in README.md: a block between two marks, written from the published results."""

from __future__ import annotations

from pathlib import Path

from benchmarks.data.fingerprint import ROOT
from benchmarks.judge.results import Results, ResultsError
from benchmarks.report.document import summary, table_markdown
from benchmarks.report.table import specification, tables_of
from tracker.files import write_whole

README = ROOT / "README.md"

PUBLISHED = ROOT / "benchmarks" / "published.json"
"""Rows of the last published run, without its frames."""

BEGIN, END = "<!-- figures: written by python -m benchmarks, of published.json -->", "<!-- /figures -->"


def figures(results: Results) -> str:
    """The block without its marks."""
    parts = [summary(results.about)]
    for spec in specification()["readme"]:
        tables = tables_of(spec, results)
        if tables:
            parts += [f"### {spec['title']}", spec["text"].strip(), *map(table_markdown, tables)]
    return "\n\n".join(parts)


def block(text: str) -> str:
    """What stands between the marks of a text.

    Raises:
        ResultsError: there are no marks.
    """
    _, begin, rest = text.partition(BEGIN)
    inside, end, _ = rest.partition(END)
    if not begin or not end:
        raise ResultsError(f"README.md: found no block between {BEGIN} and {END}")
    return inside.strip()


def write_figures(results: Results, path: Path | None = None) -> None:
    """Put the figures of results into the block of a file; None: README.md.

    Raises:
        ResultsError: it has none.
    """
    path = path or README
    text = path.read_text(encoding="utf-8")
    block(text)
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    write_whole(path, f"{before}{BEGIN}\n{figures(results)}\n{END}{after}")
