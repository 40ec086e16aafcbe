"""A gate in a minute: few rendered scenes and the recorded triplets, each compared with itself as it was.

The renderer needs no graphics and gives the same pictures on every machine, so that unchanged code gives
ratios of 1. What a figure of few scenes hides by its scatter, pairs of the same scene show.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.data.scenes import OBJECTS
from benchmarks.data.seeds import DEVELOPMENT
from benchmarks.data.sets import SHARES, Plan
from benchmarks.data.workloads import BY_NAME, RIG
from benchmarks.judge.compare import compare, paired
from benchmarks.judge.results import Results
from benchmarks.toml_files import read_toml

BASELINE = Path(__file__).with_name("ci_baseline.json")

LIMITS = Path(__file__).with_name("ci_limits.toml")

SCENES = 20
"""Of each object."""

_CHOSEN = (
    "realistic",
    "two cameras",
    "one camera",
    "perturbed calibration",
    "light",
    "hard light",
    "poor images",
    "black",
)

WORKLOADS = tuple(
    dataclasses.replace(
        BY_NAME[name], name=f"small: {name}", base=f"{RIG}platform", objects=OBJECTS, bounded=False
    )
    for name in _CHOSEN
)
"""Workloads on the scenes of the platform's cameras."""


def plan(cache: Path) -> Plan:
    """Which scenes."""
    return Plan(round(SCENES / SHARES["rig"]), DEVELOPMENT, workers=2, cache=cache)


def failures(before: Results, after: Results) -> list[str]:
    """What has become worse than allowed, as sentences."""
    limits = read_toml(LIMITS)
    rows = compare(before, after)
    worse = [
        f"{row['group']} / {row['object']} / {what}"
        for row in rows
        for what in _beyond(row, limits["workload"] | limits.get(row["group"], {}))
    ]
    for name in OBJECTS:
        worse += [f"{name} / {what}" for what in _beyond(_overall(before, after, name), limits["object"])]
    return worse + _triplets(before, after, limits["triplets"])


def _beyond(row: Mapping[str, Any], limits: Mapping[str, float]) -> list[str]:
    return [
        f"{key}: {row[key]:.4g}, allowed {limit:g}"
        for key, limit in limits.items()
        if not row.get(key, 0.0) <= limit
    ]


def _overall(before: Results, after: Results, name: str) -> dict[str, Any]:
    """Of all scenes of an object together."""
    rows = [row for row in compare(before, after) if row["object"] == name]
    pairs = before.frames.merge(
        after.frames, on=["workload", "object", "index"], suffixes=("_before", "_after")
    )
    both = pairs[(pairs.object == name) & pairs.found_before & pairs.found_after]
    count = sum(row["n"] for row in rows)
    return {
        **paired(both.position_mm_before.to_numpy(), both.position_mm_after.to_numpy(), "mm"),
        **paired(both.rotation_deg_before.to_numpy(), both.rotation_deg_after.to_numpy(), "deg"),
        "lost_percent": 100 * sum(row["lost"] - row["gained"] for row in rows) / count,
        "sure_wrong": sum(row["sure_wrong_after"] - row["sure_wrong_before"] for row in rows),
    }


def _triplets(before: Results, after: Results, limits: Mapping[str, float]) -> list[str]:
    """Recorded triplets: figures that grew by more than their limits, or that are gone."""
    keys = ["part", "group", "bin", "object", "figure"]
    then, now = (run.table.set_index(keys)["value"] for run in (before, after))
    worse = []
    for place, value in then.items():
        part, figure = place[0], place[-1]
        if part in ("third camera", "two sizes") and figure in limits:
            found = now.get(place)
            if found is None or not pd.notna(found) or found > value + limits[figure]:
                worse.append(f"{' / '.join(filter(None, place))}: {found}, was {value:.4g}")
    return worse
