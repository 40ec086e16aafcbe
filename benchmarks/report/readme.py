"""Marked blocks of figures in README.md and docs/figures.md, written from the published results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.data.fingerprint import ROOT
from benchmarks.judge.results import ResultsError
from benchmarks.report.markdown import document, grid, page
from tracker.files import write_whole

README, PAGE, RESULTS = ROOT / "README.md", ROOT / "docs" / "figures.md", ROOT / "benchmarks" / "results.md"
"""Files with a few figures, with many, and with all."""

PUBLISHED = ROOT / "benchmarks" / "published.json"
"""Origin, figures and targets of the last published run."""

BEGIN, END = "<!-- figures: written by python -m benchmarks, of published.json -->", "<!-- /figures -->"

OBJECTS = {"cube": "cube_v2", "cuboid": "cuboid_2x2x8_v2"}

Published = Mapping[str, Any]


def read_published() -> dict[str, Any]:
    """Return origin (`about`), `figures` and `targets` of the last published run."""
    content = json.loads(PUBLISHED.read_text(encoding="utf-8"))
    return {"about": content["about"]} | {key: content[key]["rows"] for key in ("figures", "targets")}


def brief(published: Published) -> str:
    """Return README.md's block without its marks."""
    found = {
        (row["table"], row["group"], row["object"]): row for row in published["figures"] if not row["bin"]
    }

    def both(table: str, group: str, form: str) -> str:
        rows = [found.get((table, group, name)) for name in OBJECTS.values()]
        return " / ".join(form.format(**row) if row else "not measured" for row in rows)

    def line(head: str, table: str, form: str, films: bool = False) -> list[str]:
        groups = ("world", "all" if films else "realistic")
        return [head, *(both(table, group, form) for group in groups)]

    lines = [
        line("median error", "accuracy", "{median_mm:.2f} mm, {median_deg:.1f}°"),
        line("90th percentile", "accuracy", "{p90_mm:.2f} mm, {p90_deg:.1f}°"),
        line("within 5 mm and 5°", "accuracy", "{within_5:.1f} %"),
        line("wrong but confident", "accuracy", "{wrong_and_sure:.1f} %"),
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


def figures(published: Published) -> str:
    """Return the figures page's block without its marks."""
    return page(published["about"], published["figures"], published["targets"])


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


def write_documents(published: Published) -> None:
    """Write results.md, and the figures into the blocks of README.md and docs/figures.md.

    Raises:
        ResultsError: one of them has no block.
    """
    texts = {README: brief(published), PAGE: figures(published)}
    parts = {path: _parts(path) for path in texts}
    for path, inside in texts.items():
        write_whole(path, f"{parts[path][0]}{BEGIN}\n{inside}\n{END}{parts[path][2]}")
    write_whole(RESULTS, document(published["about"], published["figures"], published["targets"]))
