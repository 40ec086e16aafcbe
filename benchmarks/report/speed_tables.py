"""The figures of `benchmarks.measure.speed` as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmarks.report.table import Table

Row = Mapping[str, Any]

_TIMES = ("median", "p99", "reference", "× reference", "its p99", "within 5 mm & 5°")


def speed_tables(speed: Mapping[str, Sequence[Row]]) -> list[Table]:
    """One table for each part of the measurement that is there."""
    makers: dict[str, Callable[[Sequence[Row]], Table]] = {
        "detect": _detect,
        "stages": _stages,
        "cameras": _cameras,
        "resolution": _resolution,
        "faces": _faces,
        "process": _process,
    }
    return [make(speed[key]) for key, make in makers.items() if speed.get(key)]


def _detect(rows: Sequence[Row]) -> Table:
    cells = [[row["object"], _pictures(row), f"{row['detections']}", *_times(row)] for row in rows]
    heads = ("object", "pictures", "detections", *_TIMES)
    return Table(heads, cells, "A detection, three cameras", frozenset({0, 1}))


def _stages(rows: Sequence[Row]) -> Table:
    """A column for each stage; a row for each set of pictures and each figure."""
    stages = list(dict.fromkeys(row["stage"] for row in rows))
    figures = {"median [ms]": "median_ms", "p99 [ms]": "p99_ms", "× reference": "ratio"}
    sets = list(dict.fromkeys((row["object"], _pictures(row)) for row in rows))
    values = {(row["object"], _pictures(row), row["stage"]): row for row in rows}
    cells = [
        [
            *which,
            title,
            *(f"{values[(*which, s)][key]:.2f}" if (*which, s) in values else "–" for s in stages),
        ]
        for which in sets
        for title, key in figures.items()
    ]
    heads = ("object", "pictures", "", *stages)
    return Table(heads, cells, "Stages", frozenset({0, 1, 2}))


def _cameras(rows: Sequence[Row]) -> Table:
    cells = [[row["object"], f"{row['cameras']}", *_times(row)] for row in rows]
    return Table(("object", "cameras", *_TIMES), cells, "Over the number of cameras, which take turns")


def _resolution(rows: Sequence[Row]) -> Table:
    cells = [[row["object"], f"{row['size']}×{row['size']}", *_times(row)] for row in rows]
    return Table(("object", "pictures", *_TIMES), cells, "Over resolution; the same ray-cast scenes at each")


def _faces(rows: Sequence[Row]) -> Table:
    cells = [[row["object"], f"{row['faces']}", f"{row['scenes']}", *_times(row)] for row in rows]
    heads = ("object", "faces", "scenes", *_TIMES)
    return Table(heads, cells, "Over faces in view, summed over three cameras")


def _process(rows: Sequence[Row]) -> Table:
    digits = {"s": 2, "MB": 0}
    cells = [
        [row["what"].replace("`", ""), f"{row['value']:.{digits.get(row['unit'], 2)}f} {row['unit']}"]
        for row in rows
    ]
    return Table(("a fresh process", ""), cells, "Start-up, compilation and memory")


def _pictures(row: Row) -> str:
    return f"{row['images']}, {row['size']}×{row['size']}"


def _times(row: Row) -> list[str]:
    right = row.get("right")
    return [
        _ms(row["median_ms"]),
        _ms(row["p99_ms"]),
        _ms(row["reference_ms"]),
        f"{row['ratio']:.2f}",
        f"{row['ratio_p99']:.2f}",
        "–" if right is None else f"{100 * right:.1f} %",
    ]


def _ms(value: float) -> str:
    return f"{value:.2f} ms"
