"""The gate: a few scenes and the recorded triplets, each compared with its baseline.

Unchanged code gives the same answers to the same images, so everything except times stays the same: paired
comparison reveals changes that the scatter between a few scenes would hide. The allowed loss of each figure
is given with it in `benchmarks.score.metrics`.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from benchmarks.data.plan import LOOK_ALIKE, Plan
from benchmarks.data.workloads import WORKLOADS as ALL
from benchmarks.judge.compare import pairs_of, side
from benchmarks.judge.results import Results
from benchmarks.score.metrics import ANSWERS, FINDS, PAIRED, TIMES, TRUST, TYPICAL, Metric
from benchmarks.score.tables import BY_NAME

BASELINE = Path(__file__).with_name("gate.json")

SHARES = {"realistic": 1.0, "world": 0.5, "absent": 0.07, LOOK_ALIKE: 0.07}

SCENES = 14
"""Number of realistic scenes of each object."""

FILMS = 2
"""Number of films of each camera of a recorded triplet."""

_NAMES = (
    "realistic",
    "two cameras",
    "one camera",
    "perturbed calibration",
    "hard light",
    "poor images",
    "black",
    "world",
    "absent",
)

WORKLOADS = tuple(w for w in ALL if w.name in _NAMES or w.name.startswith(LOOK_ALIKE))

RECORDED = ("third camera", "recorded, one camera")
"""Tables of recorded images in which the gate checks every row."""


def plan(cache: Path) -> Plan:
    """Return the plan of the gate, with development scenes."""
    return Plan(SCENES, cache=cache, shares=SHARES)


def failures(before: Results, after: Results) -> list[str]:
    """Return, as sentences, what has become worse by more than allowed.

    Raises:
        ResultsError: the runs' images differ.
    """
    worse = []
    pairs = pairs_of(before, after)
    for name, count in before.frames["accuracy"].object.value_counts(sort=False).items():
        own = pairs[pairs.object == name]
        if len(own) < count:
            worse.append(f"{name}: {count - len(own)} scenes of the baseline were not measured")
        if own.empty:
            continue
        shown = own[own.present_before]
        both = shown[shown.found_before & shown.found_after]
        held = (
            (TYPICAL, both),
            (ANSWERS + TRUST, shown),
            (FINDS, own[~own.present_before]),
            (TIMES, own),
        )
        for metrics, rows in held:
            worse += _worse(str(name), metrics, side(rows, "before"), side(rows, "after"))
        changes = ((metric, metric.of(both)) for metric in PAIRED)
        worse += [f"{name}: {m.title}: {m.text(x)}" for m, x in changes if m.worse(0.0, x)]
    return worse + list(_recorded(before, after))


def _recorded(before: Results, after: Results) -> Iterator[str]:
    for table in (BY_NAME[name] for name in RECORDED):
        if table.part not in before.frames:
            continue
        then, now = (run.frames.get(table.part, pd.DataFrame()) for run in (before, after))
        for (group, name), rows in then.groupby(["group", "object"], sort=False):
            same = now[(now.group == group) & (now.object == name)] if len(now) else now
            if same.empty:
                yield f"{name}, {group}: not measured"
            else:
                yield from _worse(f"{name}, {group}", table.metrics, rows, same)


def _worse(name: str, metrics: Sequence[Metric], before: pd.DataFrame, after: pd.DataFrame) -> Iterator[str]:
    for metric in metrics:
        if metric.factor is None and metric.step is None:
            continue
        was, now = metric.of(before), metric.of(after)
        if metric.worse(was, now):
            yield f"{name}: {metric.title}: {metric.text(now)}, was {metric.text(was)}"
