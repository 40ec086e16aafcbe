"""The dice task's figures as tables, its targets, and its section of `results.md`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.measure.dice import BINS, SEEN
from benchmarks.report.summary_tables import written
from benchmarks.report.table import Table
from benchmarks.score.dice import NEAR_DICE, RIM

Row = Mapping[str, Any]

PREDECESSOR = {"precision": 0.999, "recall": 0.79, "iou": 0.79}
"""Of the platform's own segmentation on the recorded picture."""

TARGETS = (
    ("recorded picture: recall", "recorded_recall", 0.85, "", False),
    ("recorded picture: precision", "recorded_precision", 0.99, "", False),
    ("thrown: mask IoU, pooled", "mask_iou", 0.9, "", False),
    ("thrown: median position", "median_mm", 2.0, "mm", True),
    (f"thrown: found of those visible ≥ {SEEN:g}", "found", 90.0, "%", False),
    ("thrown: invented, of those reported", "invented", 2.0, "%", True),
    ("speed: masks and error", "ratio", 3.0, "× reference", True),
)
"""Name, figure, limit, unit, and whether the limit is an upper one."""


def dice_targets(figures: Row) -> list[dict[str, Any]]:
    """Rows as `benchmarks.judge.targets.evaluate` gives them; nan and not met where not measured."""
    rows = []
    for name, key, limit, unit, highest in TARGETS:
        value = figures.get(key)
        value = float(value) if value is not None else math.nan
        rows.append(
            {
                "name": name,
                "object": "dice",
                "target": f"{'≤' if highest else '≥'} {limit:g} {unit}".strip(),
                "value": value,
                # nan is neither below nor above anything.
                "met": value <= limit if highest else value >= limit,
                "unit": unit,
            }
        )
    return rows


def dice_markdown(dice: Row) -> list[str]:
    """The section's paragraphs and tables."""
    scenes = dice["about"]["scenes"]
    method = (
        f"{scenes['thrown']} scenes of 25 dice that physics let fall (thrown), and {scenes['laid']} of dice "
        f"on the task's grid (laid); fingers in view, cameras as for the other objects; seed "
        f"{dice['about']['seed']}. A die's visible fraction is the number of its visible pixels over that of "
        "the convex hull of its corners, of all cameras together. Reported dice are paired with true ones "
        "within half a die's edge (11 mm, in space); those left over are invented. Targets are of the thrown "
        "dice, with masks and images given."
    )
    return [method, *(table.markdown() for table in dice_tables(dice))]


def dice_tables(dice: Row) -> list[Table]:
    """All tables of the section."""
    return [
        mask_table(dice["masks"], dice["recorded"]),
        false_table(dice["masks"]),
        position_table(dice["positions"]),
        probability_table(dice["positions"]),
        speed_table(dice["speed"]),
    ]


def mask_table(rows: Sequence[Row], recorded: Row | None) -> Table:
    """Masks against the truth."""
    keys = ("iou", "precision", "recall")
    cells = [
        [row["kind"], f"{row['views']}", *(written(row[key + end], 3) for key in keys for end in _ENDS)]
        for row in rows
    ]
    singles = (("recorded picture", recorded), ("the same, predecessor", PREDECESSOR if recorded else None))
    for name, row in singles:
        if row is not None:
            cells.append([name, "1", *(part for key in keys for part in (written(row[key], 3), "–", "–"))])
    heads = [head for key in ("IoU", "precision", "recall") for head in (key, "median", "p5")]
    caption = (
        "Masks: of all pixels of all views together, then median and 5th percentile of single views. The "
        "recorded picture's true mask was drawn by hand."
    )
    return Table(("", "views", *heads), cells, caption)


_ENDS = ("", "_median", "_p5")


def false_table(rows: Sequence[Row]) -> Table:
    """What else is taken for dice."""
    cells = [
        [
            row["kind"],
            f"{row['cross_views']}",
            f"{row['cross_px']}",
            written(row["cross_taken"], 1, " %"),
            written(row["elsewhere"], 4, " %"),
        ]
        for row in rows
    ]
    caption = (
        f"Not dice: pixels of the blue cross painted on the table, more than {NEAR_DICE} px from any die and "
        "blue in the picture (which leaves out those behind fingers), that are taken for dice; and all other "
        f"pixels taken for dice more than {RIM} px from any, of the whole picture."
    )
    heads = ("", "views with a cross", "pixels of it", "taken for dice", "false elsewhere")
    return Table(heads, cells, caption)


def position_table(rows: Sequence[Row]) -> Table:
    """Dice found, missed and invented."""
    cells = [
        [
            row["kind"],
            row["given"],
            written(row["found"], 1, " %"),
            *(f"{written(part['found'], 1, ' %')} of {part['dice']}" for part in row["bins"]),
            f"{written(row['invented'], 2, ' %')} of {row['reported']}",
            written(row["median_mm"], 2, " mm"),
            written(row["p90_mm"], 2, " mm"),
            written(row["count_error"], 1),
        ]
        for row in rows
    ]
    bins = [f"visible {low:g}-{high:g}" for low, high in BINS]
    heads = (
        "",
        "given",
        f"found, visible ≥ {SEEN:g}",
        *bins,
        "invented",
        "error, median",
        "p90",
        "count off",
    )
    caption = (
        "Positions: shares of the true dice that were found, of the reported dice that are none, distance of "
        "the found in space, and median difference of the number of dice from 25."
    )
    return Table(heads, cells, caption, frozenset({0, 1}))


def probability_table(rows: Sequence[Row]) -> Table:
    """Stated probability and how often it was right."""
    cells = []
    for row in rows:
        for part in row["reliability"]:
            if part["count"]:
                cells.append(
                    [
                        row["kind"],
                        row["given"],
                        f"{part['low']:g}-{part['high']:g}",
                        f"{part['count']}",
                        written(_percent(part["confidence"]), 1, " %"),
                        written(_percent(part["right"]), 1, " %"),
                    ]
                )
        cells.append(
            [row["kind"], row["given"], "Brier score", f"{row['reported']}", "", written(row["brier"], 4)]
        )
    caption = "Stated probability that a reported die is within 11 mm of a true one."
    return Table(("", "given", "probability", "dice", "mean", "right"), cells, caption, frozenset({0, 1, 2}))


def speed_table(rows: Sequence[Row]) -> Table:
    """What it costs."""
    cells = [
        [
            row["work"],
            written(row["median_ms"], 2, " ms"),
            written(row["p99_ms"], 2, " ms"),
            written(row["ratio"], 2, " ×"),
            f"{row['times']}",
        ]
        for row in rows
    ]
    caption = (
        "Time for three pictures of 270×270; over reference: median blur 5 and HSV of the same pictures, in "
        "turn with it."
    )
    return Table(("", "median", "p99", "over reference", "times"), cells, caption)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share
