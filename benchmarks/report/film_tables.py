"""Tracking over time as tables, its targets, and its section of `results.md`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.data.films import ABSENT, JUMP, RATE
from benchmarks.data.scenes import OBJECTS
from benchmarks.judge.targets import CUBE, CUBOID
from benchmarks.measure.films import STRIDES
from benchmarks.report.summary_tables import written
from benchmarks.report.table import Table
from benchmarks.score.films import CLEAR, CLEAR_FRAMES, COAST, FLIPPED_DEG, NEAR_MM, SEEN

Row = Mapping[str, Any]
Limit = float | tuple[float, float]


def _both(limit: Limit) -> dict[str, Limit]:
    return {CUBE: limit, CUBOID: limit}


TARGETS: tuple[tuple[str, str, Mapping[str, Limit], str, bool], ...] = (
    ("filtered within 5 mm & 5°", "filtered", {CUBE: 99.5, CUBOID: 99.0}, "%", False),
    ("flips", "flips", _both(0), "", True),
    ("NEES of the filter, median", "nees", _both((3, 9)), "", True),
    *(
        (f"{state}: filtered over single shot, {what}", f"{key}_ratio_{unit}", _both(limit), "", True)
        for state, key, limit in (("at rest", "rest", 0.5), ("moving", "moving", 1.0))
        for what, unit in (("position", "mm"), ("rotation", "deg"))
    ),
    *(
        row
        for stride in STRIDES
        for row in (
            (
                f"every {stride}. frame: within 5 mm & 5°",
                f"every_{stride}_filtered",
                _both(99.0),
                "%",
                False,
            ),
            (f"every {stride}. frame: losses", f"every_{stride}_losses", _both(0), "", True),
        )
    ),
    (
        f"one camera: within {NEAR_MM:g} mm & 5° or no pose, visible ≥ {SEEN:g}",
        "right_or_none",
        _both(95.0),
        "%",
        False,
    ),
    ("vanished: frames with a pose measured", "invented", _both(0), "", True),
    (f"vanished: frames predicted after {COAST:g} s", "kept", _both(0), "", True),
    ("vanished: found again after", "longest_wait", _both(2), "frames", True),
    ("speed: update", "ratio", _both(0.8), "× reference", True),
    ("speed: update, p99 over median", "p99_over_median", _both(3.0), "", True),
)
"""Name, figure, limit or range by object, unit, and whether a limit is an upper one."""


def film_targets(figures: Mapping[str, Row]) -> list[dict[str, Any]]:
    """Rows as `benchmarks.judge.targets.evaluate` gives them; nan and not met where not measured."""
    rows = []
    for name, key, wanted, unit, highest in TARGETS:
        for object_name, limit in wanted.items():
            found = figures.get(object_name, {}).get(key)
            value = float(found) if found is not None else math.nan
            # nan is neither below nor above anything.
            if isinstance(limit, tuple):
                met, text = limit[0] <= value <= limit[1], f"{limit[0]:g} to {limit[1]:g}"
            else:
                met = value <= limit if highest else value >= limit
                text = f"{'≤' if highest else '≥'} {limit:g} {unit}".strip()
            rows.append(
                {
                    "name": f"over time: {name}",
                    "object": object_name,
                    "target": text,
                    "value": value,
                    "met": bool(met),
                    "unit": unit,
                }
            )
    return rows


def film_markdown(films: Row) -> list[str]:
    """The section's paragraphs and tables."""
    about = films["about"]
    method = (
        f"{about['films']} films of {about['frames']} frames of each object at {RATE:g} Hz, each one motion "
        "without jumps: pushed, tumbled, lifted, carried and dropped by the fingers; seed "
        f"{about['seed']}. `update` gets frame after frame, with its time stamp. Shares are of all frames, "
        "whatever hides the object in them. A flip is a filtered rotation more than "
        f"{FLIPPED_DEG:g}° off with a confidence above 0.5; a loss is an object that had been found and is "
        "lost."
    )
    return [method, *(table.markdown() for table in film_tables(films))]


def film_tables(films: Row) -> list[Table]:
    """All tables of the section."""
    return [
        share_table(films["whole"], films["thinned"]),
        error_table(films["whole"]),
        status_table(films["whole"], films["thinned"]),
        camera_table(films["cameras"]),
        vanished_table(films["vanished"]),
        speed_table(films["speed"]),
    ]


def _by_object(*parts: Sequence[Row]) -> list[Row]:
    """Rows of all parts, one object after the other."""
    return [row for name in OBJECTS for part in parts for row in part if row["object"] == name]


def _frames(row: Row) -> str:
    return f"every {row['stride']}." if "stride" in row else "all"


def share_table(whole: Sequence[Row], thinned: Sequence[Row]) -> Table:
    """How often the poses are right, by how many frames are given."""
    cells = [
        [
            row["object"],
            _frames(row),
            f"{row['frames']}",
            written(row["filtered"], 2, " %"),
            written(row["measured"], 2, " %"),
            written(row.get("single"), 2, " %"),
            f"{row['flips']}",
            f"{row['losses']}",
        ]
        for row in _by_object(whole, thinned)
    ]
    heads = ("object", "given", "frames", "filtered", "measured", "single shot", "flips", "losses")
    caption = (
        "Poses within 5 mm and 5°, with all frames given or every so many-th alone; single shot is `detect` "
        "of the same frames."
    )
    return Table(heads, cells, caption, frozenset({0, 1}))


def error_table(rows: Sequence[Row]) -> Table:
    """What the memory is worth."""
    cells = [
        [
            row["object"],
            words,
            f"{row[f'{state}_frames']}",
            _pair(row, f"{state}_filtered", 3, " mm", 2, "°"),
            _pair(row, f"{state}_single", 3, " mm", 2, "°"),
            _pair(row, f"{state}_ratio", 2, "", 2, ""),
            written(row["nees"], 2),
        ]
        for row in rows
        for state, words in (("rest", "at rest"), ("moving", "moving"))
    ]
    caption = (
        "Median errors of the filtered pose and of a single shot, and the one over the other. At rest: moved "
        "less than 0.01 mm and 0.01° since the frame before and until the next. NEES: of the filtered pose, "
        "over all frames; 5.35 is honest."
    )
    heads = ("object", "", "frames", "filtered", "single shot", "ratio", "NEES, median")
    return Table(heads, cells, caption, frozenset({0, 1}))


def status_table(whole: Sequence[Row], thinned: Sequence[Row]) -> Table:
    """What `update` said of the frames."""
    rows = _by_object(whole, thinned)
    names = sorted({name for row in rows for name in row["statuses"]})
    cells = [
        [row["object"], _frames(row), *(f"{row['statuses'].get(name, 0)}" for name in names)] for row in rows
    ]
    heads = ("object", "given", *(name.lower().replace("_", " ") for name in names))
    return Table(heads, cells, "Frames by status.", frozenset({0, 1}))


def camera_table(rows: Sequence[Row]) -> Table:
    """What one camera is worth."""
    cells = [
        [
            row["object"],
            f"{row['camera'] + 1}",
            f"{row['frames']}",
            *(written(row[key], 1, " %") for key in ("right", "none", "wrong")),
            f"{row['longest_wait']} frames",
        ]
        for row in rows
    ]
    caption = (
        f"One camera alone, frames in which it sees at least {SEEN:g} of the object: measured within "
        f"{NEAR_MM:g} mm and 5°, no pose, wrong. The longest wait is the most frames in a row without a pose "
        f"once the camera has seen at least {CLEAR:g} for {CLEAR_FRAMES} frames and while it does."
    )
    heads = ("object", "camera", "frames", "right", "no pose", "wrong", "longest wait")
    return Table(heads, cells, caption)


def vanished_table(rows: Sequence[Row]) -> Table:
    """What is said of an object that is gone, and of its return."""
    cells = [
        [
            row["object"],
            f"{row['times']}",
            f"{row['invented']} of {row['absent_frames']}",
            f"{row['kept']} of {row['late_frames']}",
            written(row["kept_seconds"], 2, " s"),
            written(row["median_wait"], 1, " frames"),
            f"{row['longest_wait']} frames",
        ]
        for row in rows
    ]
    caption = (
        f"The object vanishes for {ABSENT} frames and comes back at the next place of the film that is more "
        f"than {100 * JUMP:g} cm away (or the farthest): frames of its absence with a measured pose; of "
        f"those later than {COAST:g} s with a predicted one; how long it was predicted at most; and after "
        "how many frames it was found again within 5 mm and 5°, 1 being at once."
    )
    heads = ("object", "times", "measured while away", "predicted late", "predicted for", "found", "at worst")
    return Table(heads, cells, caption)


def speed_table(rows: Sequence[Row]) -> Table:
    """What it costs."""
    cells = [
        [
            row["object"],
            written(row["median_ms"], 2, " ms"),
            written(row["p99_ms"], 2, " ms"),
            written(row["ratio"], 2, " ×"),
            written(row["p99_over_median"], 2, " ×"),
            f"{row['times']}",
        ]
        for row in rows
    ]
    caption = (
        "Time of `update` while tracking, one thread, three pictures of 270×270; over reference: median blur "
        "5 and HSV of the same pictures, in turn with it."
    )
    return Table(("object", "median", "p99", "over reference", "p99 over median", "times"), cells, caption)


def _pair(row: Row, key: str, digits: int, unit: str, digits_deg: int, unit_deg: str) -> str:
    return f"{written(row[f'{key}_mm'], digits, unit)}, {written(row[f'{key}_deg'], digits_deg, unit_deg)}"
