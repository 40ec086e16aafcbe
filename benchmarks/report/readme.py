"""Blocks of figures between marks in README.md and docs/figures.md, written from the published results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.data.fingerprint import ROOT
from benchmarks.data.toml_files import read_toml
from benchmarks.judge.results import ResultsError
from benchmarks.report.markdown import document, grid, page, summary
from benchmarks.score.shares import wilson_interval
from tracker.files import write_whole

README, PAGE, RESULTS = ROOT / "README.md", ROOT / "docs" / "figures.md", ROOT / "benchmarks" / "results.md"
"""Where a few of the figures stand, where many do, and all."""

PUBLISHED = ROOT / "benchmarks" / "published.json"
"""Origin, figures and targets of the last published run."""

PREDECESSOR = ROOT / "benchmarks" / "data" / "predecessor.toml"

BEGIN, END = "<!-- figures: written by python -m benchmarks, of published.json -->", "<!-- /figures -->"

OBJECTS = {"cube": "cube_v2", "cuboid": "cuboid_2x2x8_v2"}

Published = Mapping[str, Any]


def read_published() -> dict[str, Any]:
    """Origin (`about`), `figures` and `targets` of the last published run."""
    content = json.loads(PUBLISHED.read_text(encoding="utf-8"))
    return {"about": content["about"]} | {key: content[key]["rows"] for key in ("figures", "targets")}


def brief(published: Published) -> str:
    """README.md's block without its marks."""
    old = read_toml(PREDECESSOR)
    found = {
        (row["table"], row["group"], row["object"]): row for row in published["figures"] if not row["bin"]
    }

    def both(table: str, group: str, form: str) -> str:
        rows = [found.get((table, group, name)) for name in OBJECTS.values()]
        return "; ".join(form.format(**row) if row else "not measured" for row in rows)

    def right(group: str) -> str:
        texts = []
        for name in OBJECTS.values():
            row = found["accuracy", group, name]
            low, high = wilson_interval(row["within_5"], row["n"])
            texts.append(f"{row['within_5']:.1f} % ({low:.1f}–{high:.1f})")
        return "; ".join(texts)

    def times(table: str, group: str) -> str:
        return both(table, group, "{median_ms:.1f} ({p99_ms:.0f}) ms, {ratio:.1f} ({p99_ratio:.0f}) ×")

    def old_errors(name: str) -> str:
        return f"{old[name]['median_mm']} mm, {old[name]['median_deg']:.1f}°"

    def errors(group: str, name: str) -> str:
        row = found["accuracy", group, OBJECTS[name]]
        return f"{row['median_mm']:.2f} mm, {row['median_deg']:.2f}°"

    groups, films = ("world", "realistic"), ("world", "all")
    within = [f"{low}–{high} %" for low, high in (old[name]["within_5"] for name in OBJECTS)]
    lines = [
        *(
            [f"median error, {name}", *(errors(g, name) for g in groups), old_errors(name)]
            for name in OBJECTS
        ),
        ["90th percentile", *(both("accuracy", g, "{p90_mm:.2f} mm, {p90_deg:.1f}°") for g in groups), "–"],
        ["within 5 mm and 5° (95 % interval)", *map(right, groups), "; ".join(within)],
        ["wrong and sure", *(both("accuracy", g, "{wrong_and_sure:.1f} %") for g in groups), "–"],
        ["inside the stated 95 % ellipsoid", *(both("trust", g, "{inside_95:.0f} %") for g in groups), "–"],
        [
            "`detect`, median (99th percentile)",
            *(times("detect", g) for g in groups),
            f"{old['time']['ms']} ms, {old['time']['ratio']} ×",
        ],
        ["`update`, of films", *(times("update", g) for g in films), "–"],
    ]
    heads = (
        "three 270×270 pictures, fingers in view; cube; cuboid",
        "as on a real platform ¹",
        "exact calibration ²",
        "the platform's present tracker ³",
    )
    notes = (
        "¹ Rendered with every effect of the real world that the generator knows: worn edges, blur, "
        "reflections, clutter, a calibration that is off. ² Rendered with sharp edges and an exact "
        f"calibration. ³ {old['how'][0].upper()}{old['how'][1:]}; commit {old['commit']}. Times: processor "
        "time, and its multiple of the time of `cv2.medianBlur` 5 and conversion to HSV of the same "
        "pictures in the same process."
    )
    return f"{grid(heads, lines, 1)}\n\n{notes}\n\n{summary(published['about'])}"


def figures(published: Published) -> str:
    """The block of the page of figures without its marks."""
    return page(published["about"], published["figures"], published["targets"])


def block(path: Path) -> str:
    """What stands between the marks of a file.

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
    """Write results.md, and the figures into README.md's block and into that of docs/figures.md.

    Raises:
        ResultsError: one of them has none.
    """
    texts = {README: brief(published), PAGE: figures(published)}
    parts = {path: _parts(path) for path in texts}
    for path, inside in texts.items():
        write_whole(path, f"{parts[path][0]}{BEGIN}\n{inside}\n{END}{parts[path][2]}")
    write_whole(RESULTS, document(published["about"], published["figures"], published["targets"]))
