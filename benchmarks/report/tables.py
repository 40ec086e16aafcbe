"""A run as Markdown: `results.md`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.data.workloads import BY_NAME
from benchmarks.report.dice_tables import dice_markdown
from benchmarks.report.film_tables import film_markdown
from benchmarks.report.motion_tables import motion_markdown
from benchmarks.report.rigs_tables import rigs_markdown
from benchmarks.report.speed_tables import speed_tables
from benchmarks.report.summary_tables import summary_tables, target_rows
from benchmarks.report.table import Table
from benchmarks.score.records import Results

NOTES = Path(__file__).with_name("notes.md")
"""What people say about the figures: causes of missed targets, and what was tried."""

METHOD = (
    "Scenes of the simulated platform, from a seed that is used for nothing else; {scenes}. Three cameras, "
    "270×270. One thread, no prior knowledge of the pose, no memory.",
    "- Errors are of the poses given; misses, wrong (beyond 5 mm or 5°) and wrong and sure (confidence above "
    "0.5) are shares of all frames.\n"
    "- MSPD is in the worst camera. ADD and MSSD are over the surface, without symmetries. Average recalls "
    "take the thresholds of the BOP benchmark; the recall of ADD is at 10 % of the diameter.\n"
    "- The bound is Cramér and Rao's, from the visible edges and the noise measured at each edge of each "
    "picture, or from 0.3 px for each pixel of edge. It is the square root of a trace; the median of an "
    "isotropic Gaussian error in three dimensions is 0.89 of that.\n"
    "- Occlusion bins hold the realistic scenes and others that fill up the bins.",
)


def results_markdown(results: Results, notes: Path = NOTES) -> str:
    """The whole document; parts that were not measured are left out."""
    about = results.get("about", {})
    scenes = ", ".join(f"{value} {key.replace('_', ' ')}" for key, value in about.get("scenes", {}).items())
    parts = [
        "# Results",
        f"Commit {about.get('commit', 'unknown')}, {about.get('processor', 'unknown')}, one thread."
        + (" A quick run: its figures mean little." if about.get("quick") else "")
        + " Written by `python -m benchmarks all --publish`.",
    ]
    if results.get("targets"):
        parts += ["## Targets", targets_table(results["targets"]).markdown()]
    if notes.is_file():
        parts.append(notes.read_text(encoding="utf-8").strip())
    if results.get("summary"):
        about_scenes, definitions = METHOD
        parts += ["## Accuracy", about_scenes.format(scenes=scenes), definitions]
        parts.append(workloads_table(results["summary"]).markdown())
        parts += [f"- left out: {name}: {why}" for name, why in about.get("skipped", {}).items()]
        for name, tables in summary_tables(results["summary"]):
            parts += [f"### {name}", *(table.markdown() for table in tables)]
        for title, maker in (("Visible fraction", bins_table), ("Confidence", reliability_table)):
            parts += [f"### {title}", maker(results["summary"]).markdown()]
    if results.get("recorded"):
        parts += ["## Recorded triplets", recorded_table(results["recorded"]["triplets"]).markdown()]
    if results.get("segmentation"):
        parts += ["## Segmentation", segmentation_table(results["segmentation"]["objects"]).markdown()]
    if results.get("films"):
        parts += ["## Over time", *film_markdown(results["films"])]
    if results.get("rigs"):
        parts += ["## Other rigs", *rigs_markdown(results["rigs"])]
    if results.get("motion"):
        parts += ["## Fast motions", *motion_markdown(results["motion"])]
    if results.get("dice"):
        parts += ["## Dice", *dice_markdown(results["dice"])]
    if results.get("speed"):
        parts += ["## Speed", *(table.markdown() for table in speed_tables(results["speed"]))]
    return "\n\n".join(parts) + "\n"


def targets_table(targets: Sequence[Mapping[str, Any]]) -> Table:
    """Targets and what was reached."""
    rows = [
        [row["name"], row["object"], row["wanted"], row["reached"], row["verdict"]]
        for row in target_rows(targets)
    ]
    return Table(("", "object", "target", "reached", ""), rows, "", frozenset({0, 1, 4}))


def workloads_table(summary: Mapping[str, Any]) -> Table:
    """What the workloads are."""
    rows = [[name, BY_NAME[name].about] for name in summary if name in BY_NAME]
    return Table(("workload", "scenes and pictures"), rows, "", frozenset({0, 1}))


def bins_table(summary: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Table:
    """Right answers and errors by visible fraction."""
    rows = []
    for workload in ("clean", "occlusion bins", "two cameras"):
        for name, figures in summary.get(workload, {}).items():
            for row in figures.get("bins", ()):
                if row["frames"]:
                    rows.append(
                        [
                            workload,
                            name,
                            f"{row['low']:g}-{row['high']:g}",
                            f"{row['frames']}",
                            f"{row['within_5']:.1f} %",
                            f"{row['misses']:.1f} %",
                            f"{row['median_mm']:.3f} mm",
                            f"{row['median_deg']:.2f}°",
                        ]
                    )
    heads = ("workload", "object", "visible", "frames", "within 5 mm & 5°", "misses", "median", "")
    return Table(heads, rows, "", frozenset({0, 1}))


def reliability_table(summary: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Table:
    """Stated confidence and how often it was right."""
    rows = []
    for workload in ("realistic", "occlusion bins", "one camera"):
        for name, figures in summary.get(workload, {}).items():
            for row in figures.get("reliability", ()):
                if row["count"]:
                    rows.append(
                        [
                            workload,
                            name,
                            f"{row['low']:g}-{row['high']:g}",
                            f"{row['count']}",
                            f"{100 * row['confidence']:.1f} %",
                            f"{100 * row['right']:.1f} %",
                        ]
                    )
    return Table(("workload", "object", "confidence", "poses", "mean", "right"), rows, "", frozenset({0, 1}))


def recorded_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Recorded triplets, by hand-labelled pixels and under changed light."""
    cells = [
        [
            row["triplet"],
            f"{row['inside']:.2f} %",
            f"{row['farthest_px']:.2f} px ({row['beyond_1_px']} px beyond 1 px)",
            f"{row['tilt_deg']:.2f}°",
            f"{row['same']:.1f} % of {row['draws']}",
            f"{row['wrong_and_sure']:.1f} %",
            f"{row['median_shift_mm']:.2f} mm, {row['median_turn_deg']:.2f}°",
        ]
        for row in rows
    ]
    heads = ("triplet", "labelled pixels inside their face", "farthest outside", "tilt")
    heads_light = ("same pose in other light", "wrong and sure", "median shift, turn")
    caption = (
        "Every labelled pixel's centre against the outline of its face. Other light: gains 0.8-1.2 for each "
        "channel and exposure 0.6-1.4 for each image; same pose: within 3 mm and 3° of the undisturbed one."
    )
    return Table((*heads, *heads_light), cells, caption)


def segmentation_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Intersection over union with hand-made masks."""

    def mean(row: Mapping[str, Any], key: str) -> str:
        count = row[f"{key}_faces"]
        return f"{row[key]:.3f} ({count} faces)" if count else "-"

    cells = [
        [
            row["object"],
            f"{row['faces']}",
            f"{row['mean']:.3f}",
            f"{row['worst']:.2f}",
            mean(row, "known"),
            mean(row, "unknown"),
        ]
        for row in rows
    ]
    heads = ("object", "faces", "mean IoU", "worst face", "left out: colours seen elsewhere", "never seen")
    caption = (
        "Intersection over union with hand-made masks over the whole image. The masks are drawn a little too "
        "small on purpose."
    )
    return Table(heads, cells, caption)
