"""Comparison of two runs on the same images, answer by answer."""

from typing import Any

import numpy as np
import pandas as pd

from benchmarks.judge.results import Results, ResultsError
from benchmarks.score.metrics import ANSWERS, TIMES, TRUST, bootstrap_interval, median, right

KEYS = ["group", "object", "index"]

SAME_PICTURES = 0.3
"""Largest difference between the signatures of the same images: allows for the rounding of other processors,
which reaches 0.11 in a `world` scene, but not for different noise, which moves them by two or more."""

COMPARED = (*ANSWERS, *TRUST, *TIMES)


def pairs_of(before: Results, after: Results) -> pd.DataFrame:
    """Return pairs of answers to the same images; columns except KEYS end in `_before` and `_after`.

    Raises:
        ResultsError: the runs have no scene in common, or their images differ.
    """
    tables = [results.frames.get("accuracy", pd.DataFrame(columns=KEYS)) for results in (before, after)]
    pairs = tables[0].merge(tables[1], on=KEYS, suffixes=("_before", "_after"))
    if pairs.empty:
        raise ResultsError("found no scene that both runs have")
    other = (pairs.pictures_before - pairs.pictures_after).abs() > SAME_PICTURES
    if other.any():
        groups = ", ".join(dict.fromkeys(pairs.group[other]))
        raise ResultsError(f"{other.sum()} of {len(pairs)} scenes are not of the same pictures: {groups}")
    return pairs


def side(pairs: pd.DataFrame, when: str) -> pd.DataFrame:
    """Return one run's answers from the pairs, with the original column names."""
    ending = f"_{when}"
    names = {name: name.removesuffix(ending) for name in pairs if name.endswith(ending)}
    return pairs[[*KEYS, *names]].rename(columns=names)


def compare(before: Results, after: Results) -> list[dict[str, Any]]:
    """Return, for each workload and object, every metric as (before, after), and median ratios of errors.

    `ratio_…` is the median ratio of errors, after / before, over scenes where both runs found a pose, with
    its 95 % interval; `lost` and `gained` count the scenes that only one run got right.

    Raises:
        ResultsError: as in `pairs_of`.
    """
    rows = []
    for (group, name), own in pairs_of(before, after).groupby(["group", "object"], sort=False):
        sides = side(own, "before"), side(own, "after")
        row: dict[str, Any] = {"group": group, "object": name, "n": len(own)}
        row |= {metric.name: tuple(metric.of(one) for one in sides) for metric in COMPARED}
        row |= {f"ratio_{unit}": _ratio(own, unit) for unit in ("mm", "deg")}
        was, now = (right(one) for one in sides)
        rows.append(row | {"lost": int((was & ~now).sum()), "gained": int((now & ~was).sum())})
    return rows


def _ratio(pairs: pd.DataFrame, unit: str) -> tuple[float, float, float]:
    both = pairs[pairs[f"{unit}_before"].notna() & pairs[f"{unit}_after"].notna()]

    def of(rows: pd.DataFrame) -> float:
        least = 1e-9
        ratios = np.maximum(rows[f"{unit}_after"], least) / np.maximum(rows[f"{unit}_before"], least)
        return median(ratios)

    return (of(both), *bootstrap_interval(of, both))


def text(rows: list[dict[str, Any]]) -> str:
    """Return the changes as text, one paragraph per workload and object."""
    lines = []
    for row in rows:
        head = f"{row['object']}, {row['group']} ({row['n']})"
        lines.append(f"{head}: {row['lost']} lost, {row['gained']} gained")
        for unit in ("mm", "deg"):
            middle, low, high = row[f"ratio_{unit}"]
            lines.append(f"  {unit}: median ratio {middle:.3f} ({low:.3f} to {high:.3f})")
        for metric in COMPARED:
            was, now = map(metric.text, row[metric.name])
            if was != now:
                lines.append(f"  {metric.title} [{metric.name}]: {was} → {now}")
    return "\n".join(lines)
