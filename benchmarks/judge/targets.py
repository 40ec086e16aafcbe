"""What the tracker is meant to reach, as data, and whether it does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.score.records import FrameRecord, column, select
from benchmarks.score.summary import SURE, percent, within
from tracker.conventions import Array

CUBE, CUBOID, BOTH = "cube_v2", "cuboid_2x2x8_v2", "both"
AMBIGUOUS = "ambiguous"

Measure = Callable[[Sequence[FrameRecord]], float]
"""A figure of one object's records of one workload."""


@dataclass(frozen=True)
class Target:
    """One row of the table."""

    name: str
    workload: str
    measure: Measure
    wanted: Mapping[str, float | tuple[float, float]]
    """By object, a limit or a range; BOTH: one figure of all objects together."""
    unit: str = ""
    highest: bool = True
    """Whether the target is an upper limit; else a lower one."""


def _quantile(key: str, q: float) -> Measure:
    return lambda records: _finite_quantile(column([r for r in records if r.found], key), q)


def _finite_quantile(values: Array, q: float) -> float:
    values = values[np.isfinite(values)]
    return float(np.quantile(values, q)) if len(values) else math.nan


def _share_within(low: float, high: float, millimetres: float = 5) -> Measure:
    """Share [%] within so many millimetres and 5°, of frames of a visible fraction from low to high."""
    return lambda records: percent(within(_visible(records, low, high), millimetres, 5))


def _visible(records: Sequence[FrameRecord], low: float, high: float = math.inf) -> list[FrameRecord]:
    return [r for r in records if low <= r.visible_fraction < high]


def _right_or_ambiguous(records: Sequence[FrameRecord]) -> float:
    own = _visible(records, 0.7)
    return percent(within(own, 20, 5) | (column(own, "status") == AMBIGUOUS))


def _wrong_and_sure(millimetres: float, low: float = 0.0) -> Measure:
    """Share [%] of frames whose pose is farther off than so many millimetres or 5°, and sure."""

    def measure(records: Sequence[FrameRecord]) -> float:
        own = _visible(records, low)
        sure = np.nan_to_num(column(own, "confidence")) > SURE
        return percent(sure & ~within(own, millimetres, 5))

    return measure


def _false_finds(records: Sequence[FrameRecord]) -> float:
    return float(column(records, "found").sum()) if records else math.nan


def _bound_ratio(bound: str) -> Measure:
    def measure(records: Sequence[FrameRecord]) -> float:
        own = [r for r in records if r.found and math.isfinite(getattr(r, bound))]
        if not own:
            return math.nan
        return float(np.median(column(own, "position_mm")) / np.median(column(own, bound)))

    return measure


def _each(cube: float, cuboid: float) -> dict[str, float | tuple[float, float]]:
    return {CUBE: cube, CUBOID: cuboid}


PACKAGE, SMOOTH = "simulation package", "simulation package, smooth"

TARGETS = (
    Target("median position", "realistic", _quantile("position_mm", 0.5), _each(0.10, 0.18), "mm"),
    Target("median rotation", "realistic", _quantile("rotation_deg", 0.5), _each(0.15, 0.45), "°"),
    Target("p90 position", "realistic", _quantile("position_mm", 0.9), {CUBE: 0.25}, "mm"),
    Target("p90 rotation", "realistic", _quantile("rotation_deg", 0.9), {CUBE: 0.40}, "°"),
    Target("median roll", "realistic", _quantile("roll_deg", 0.5), {CUBOID: 0.35}, "°"),
    Target(
        "within 5 mm & 5°, visible ≥ 0.5",
        "realistic",
        _share_within(0.5, math.inf),
        _each(99.5, 99),
        "%",
        False,
    ),
    Target(
        "within 5 mm & 5°, visible 0.3-0.5",
        "occlusion bins",
        _share_within(0.3, 0.5),
        _each(95, 90),
        "%",
        False,
    ),
    Target("finds where there is no object", "absent", _false_finds, {BOTH: 0}),
    *(
        Target("NEES, median", workload, _quantile("nees", 0.5), {CUBE: (3, 9), CUBOID: (3, 9)})
        for workload in ("realistic", "perturbed calibration")
    ),
    Target("within 5 mm & 5°", "light", _share_within(0, math.inf), _each(99.5, 99.5), "%", False),
    Target("within 5 mm & 5°", "hard light", _share_within(0, math.inf), _each(98, 98), "%", False),
    Target("wrong and sure", "hard light", _wrong_and_sure(5), _each(0, 0), "%"),
    Target("within 5 mm & 5°", "poor images", _share_within(0, math.inf), _each(99, 97), "%", False),
    Target(
        "within 5 mm & 5°, visible ≥ 0.7",
        "two cameras",
        _share_within(0.7, math.inf),
        _each(99.5, 99),
        "%",
        False,
    ),
    Target(
        "within 20 mm & 5° or ambiguous, visible ≥ 0.7",
        "one camera",
        _right_or_ambiguous,
        _each(98, 95),
        "%",
        False,
    ),
    Target(
        "beyond 20 mm or 5° and sure, visible ≥ 0.7",
        "one camera",
        _wrong_and_sure(20, 0.7),
        _each(0.2, 0.2),
        "%",
    ),
    Target("median position over bound", "realistic", _bound_ratio("bound_mm"), _each(1.5, 1.5)),
    Target(
        "median position over bound of 0.3 px", "realistic", _bound_ratio("bound_fixed_mm"), _each(1.5, 1.5)
    ),
    *(
        target
        for workload in (PACKAGE, SMOOTH)
        for target in (
            Target("median position", workload, _quantile("position_mm", 0.5), _each(0.06, 0.10), "mm"),
            Target("median rotation", workload, _quantile("rotation_deg", 0.5), _each(0.09, 0.25), "°"),
        )
    ),
)

SPEED_LIMIT = 2.0
"""Of the time of a detection over that of the reference work."""


def evaluate(
    records: Sequence[FrameRecord], speed: Mapping[str, Sequence[Mapping[str, Any]]] | None = None
) -> list[dict[str, Any]]:
    """The table: name, object, target (as text), value, met, unit; nan and not met where not measured."""
    rows = []
    for target in TARGETS:
        own = select(records, target.workload)
        if target.workload == "occlusion bins":
            own = select(records, "realistic") + own
        for name, wanted in target.wanted.items():
            value = target.measure(own if name == BOTH else select_object(own, name))
            rows.append(_row(f"{target.workload}: {target.name}", name, wanted, value, target))
    detect = [row for row in (speed or {}).get("detect", ()) if row["images"] == "rendered"]
    for name in (CUBE, CUBOID):
        ratios = [float(row["ratio"]) for row in detect if row["object"] == name]
        limit = Target("", "", _false_finds, {}, "× reference")
        rows.append(_row("speed: detect", name, SPEED_LIMIT, ratios[0] if ratios else math.nan, limit))
    return rows


def select_object(records: Sequence[FrameRecord], name: str) -> list[FrameRecord]:
    """The records of one object."""
    return [record for record in records if record.object == name]


def _row(
    name: str, object_name: str, wanted: float | tuple[float, float], value: float, target: Target
) -> dict[str, Any]:
    # nan is neither below nor above anything.
    if isinstance(wanted, tuple):
        met, text = wanted[0] <= value <= wanted[1], f"{wanted[0]:g} to {wanted[1]:g}"
    else:
        met = value <= wanted if target.highest else value >= wanted
        text = f"{'≤' if target.highest else '≥'} {wanted:g}"
    space = "" if target.unit in ("", "°") else " "
    return {
        "name": name,
        "object": object_name,
        "target": f"{text}{space}{target.unit}",
        "value": value,
        "met": bool(met),
        "unit": target.unit,
    }
