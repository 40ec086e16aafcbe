"""Fast motions as tables, and their section of `results.md`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.data.motion import AHEAD, RATE, SKEW, SLOW, STEADY
from benchmarks.data.paths import SPEED
from benchmarks.measure.motion import ONE_STAMP, OWN_STAMPS, TOGETHER, ratio
from benchmarks.report.summary_tables import written
from benchmarks.report.table import Table

Row = Mapping[str, Any]

WORDS = {
    TOGETHER: "together",
    OWN_STAMPS: "skewed, a stamp for each camera",
    ONE_STAMP: "skewed, one stamp",
}


def motion_markdown(motion: Row) -> list[str]:
    """The section's paragraphs and tables."""
    about = motion["about"]
    method = (
        f"{about['films']} films of {about['frames']} ray-cast frames of each object at {RATE:g} Hz, without "
        f"fingers, with exact calibration; seed {about['seed']}. The object flies to and fro at about "
        f"{SPEED:g} m/s, straight or along curves, turning, and rests now and then. Each frame was taken "
        f"twice: by all cameras at once, and by one after the other within {1e3 * SKEW:g} ms. Errors are "
        f"medians over the frames in which the object is faster than {SLOW:g} m/s, at the latest stamp."
    )
    return [method, *(table.markdown() for table in motion_tables(motion))]


def motion_tables(motion: Row) -> list[Table]:
    """All tables of the section."""
    return [skew_table(motion["rows"]), prediction_table(motion["rows"])]


def skew_table(rows: Sequence[Row]) -> Table:
    """What cameras that are not simultaneous cost."""
    exact = {row["object"]: row for row in rows if row["given"] == TOGETHER}
    cells = []
    for row in rows:
        best = exact.get(row["object"], {})
        cells.append(
            [
                row["object"],
                WORDS[row["given"]],
                f"{row['measured_frames']} of {row['moving']}",
                _errors(row, "measured"),
                _ratios(row, best),
                written(row["measured_nees"], 2),
                _errors(row, "filtered"),
                written(row["filtered_nees"], 2),
            ]
        )
    heads = ("object", "pictures", "frames", "measured", "ratio", "NEES", "filtered", "NEES")
    caption = (
        "While the object moves: the measured pose, its error over that of pictures taken together, and the "
        "filtered pose. NEES: median; 5.35 is honest."
    )
    return Table(heads, cells, caption, frozenset({0, 1}))


def prediction_table(rows: Sequence[Row]) -> Table:
    """How well the next moment is known."""
    cells = [
        [
            row["object"],
            WORDS[row["given"]],
            f"{row['predicted_frames']} of {row['moving']}",
            _errors(row, "predicted"),
            written(row["predicted_nees"], 2),
            f"{row['steady']}",
            _errors(row, "steady_predicted"),
            written(row["steady_predicted_nees"], 2),
        ]
        for row in rows
    ]
    heads = ("object", "pictures", "frames", "moving", "NEES", "frames", "steady", "NEES")
    caption = (
        f"Predicted {1e3 * AHEAD:g} ms ahead, right after each frame, while the object moves; steady: it has "
        f"not turned back for {STEADY:g} s, and does not before the time that is predicted."
    )
    return Table(heads, cells, caption, frozenset({0, 1}))


def _errors(row: Row, key: str) -> str:
    return f"{written(row[f'{key}_mm'], 3, ' mm')}, {written(row[f'{key}_deg'], 2, '°')}"


def _ratios(row: Row, exact: Row) -> str:
    return ", ".join(
        written(ratio(row[key], exact.get(key, 0.0)), 2) for key in ("measured_mm", "measured_deg")
    )
