"""The targets in `targets.toml`, and whether the answers meet them."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.judge.results import Results
from benchmarks.score.metrics import NOTHING, Metric, independent, matches
from benchmarks.score.tables import BY_NAME
from tracker.errors import TrackerError
from tracker.files.toml import read_toml

FILE = Path(__file__).with_name("targets.toml")

OBJECTS = {"cube": "cube_*", "cuboid": "cuboid_*"}
"""Name patterns of objects, by the kind of object to which a limit applies."""


def judge(results: Results) -> list[dict[str, Any]]:
    """Return all targets that were measured, in the file's order.

    Returns:
        For each, its `name`, `object` and `n`; the `target`, the `reached` value and its 95 % `interval`, as
        text; and the `verdict`: `met` or `missed` if the whole interval is, otherwise `undecided`.
    """
    return [
        row
        for target in read_toml(FILE, TrackerError)["target"]
        for kind in OBJECTS
        for row in _judged(target, kind, results)
    ]


def _judged(target: dict[str, Any], kind: str, results: Results) -> Iterator[dict[str, Any]]:
    table = BY_NAME[target["table"]]
    metric = next(metric for metric in table.metrics if metric.name == target["metric"])
    if table.part not in results.frames:
        return
    frame = results.frames[table.part]
    own = frame[
        [
            matches(group, [target["group"]]) and matches(name, [OBJECTS[kind]])
            for group, name in zip(frame.group, frame.object, strict=True)
        ]
    ]
    if own.empty:
        return
    least, most = _limits(target, kind)
    value, (low, high) = metric.of(own), metric.interval(own)
    met = least <= low and high <= most
    missed = high < least or low > most
    beside = next((m for m in table.metrics if m.name == target.get("beside")), None)
    yield {
        "name": target["name"],
        "object": kind,
        "n": len(independent(own)),
        "target": _target(metric, least, most),
        "reached": metric.text(value) + (f" ({beside.text(beside.of(own))})" if beside else ""),
        "interval": f"{metric.text(low)} to {metric.text(high)}".replace(NOTHING, "?"),
        "verdict": "met" if met else "missed" if missed else "undecided",
    }


def _target(metric: Metric, least: float, most: float) -> str:
    # A limit keeps all its digits, however many the figure has.
    low, high = (f"{limit:g}{metric.form.partition('}')[2]}" for limit in (least, most))
    if math.isinf(most):
        return f"≥ {low}"
    return f"≤ {high}" if math.isinf(least) else f"{low} to {high}"


def _limits(target: dict[str, Any], kind: str) -> tuple[float, float]:
    if "between" in target:
        low, high = target["between"][kind]
        return float(low), float(high)
    if "at_least" in target:
        return float(target["at_least"][kind]), math.inf
    return -math.inf, float(target["at_most"][kind])
