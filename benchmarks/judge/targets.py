"""What the tracker is meant to reach, as the data in `targets.toml`, and whether it does."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.judge.results import Results
from benchmarks.toml_files import read_toml

FILE = Path(__file__).with_name("targets.toml")

EVERY = "*"
"""Group of a target that holds for each."""

BOUNDS = {"at_most": "≤ {0:g}", "at_least": "≥ {0:g}", "between": "{0[0]:g} to {0[1]:g}"}


@dataclass(frozen=True)
class Judged:
    """One target, and what was reached."""

    name: str
    object: str
    wanted: str
    """With its unit."""
    value: float
    """nan: not measured."""
    met: bool
    unit: str

    @property
    def state(self) -> str:
        """`met`, `missed` or `unknown`."""
        return "unknown" if math.isnan(self.value) else "met" if self.met else "missed"


def evaluate(results: Results) -> list[Judged]:
    """All targets, in the file's order."""
    table = results.table
    values = table.set_index(["part", "group", "bin", "figure", "object"])["value"]
    return [
        _judged(target, key, name, limit, values)
        for stated in read_toml(FILE)["target"]
        for target in _expanded(stated, table)
        for key in BOUNDS
        for name, limit in target.get(key, {}).items()
    ]


def _expanded(target: dict[str, Any], table: pd.DataFrame) -> list[dict[str, Any]]:
    """A target of all groups as one of each that was measured."""
    if target.get("group") != EVERY:
        return [target]
    own = table[(table.part == target["part"]) & (table.figure == target["figure"])]
    groups = own[own.object.isin([name for key in BOUNDS for name in target.get(key, {})])].group
    return [
        target | {"group": group, "name": f"{group}: {target['name']}"} for group in dict.fromkeys(groups)
    ]


def _judged(target: dict[str, Any], key: str, name: str, limit: Any, values: pd.Series) -> Judged:
    place = (target["part"], target.get("group", ""), target.get("bin", ""), target["figure"], name)
    value = float(values.get(place, math.nan))
    met = {
        "at_most": lambda: value <= limit,
        "at_least": lambda: value >= limit,
        "between": lambda: limit[0] <= value <= limit[1],
    }[key]()
    unit = target.get("unit", "")
    space = "" if unit in ("", "°") else " "
    return Judged(target["name"], name, BOUNDS[key].format(limit) + space + unit, value, bool(met), unit)
