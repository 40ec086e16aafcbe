"""Results of a run that never was, for tests of what is made from results."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.judge.results import Results
from benchmarks.score.records import FrameRecord, frame_of
from benchmarks.score.summary import accuracy_rows

OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")
WORKLOADS = {
    "realistic": 1.0,
    "clean": 0.6,
    "occlusion bins": 3.0,
    "perturbed calibration": 6.0,
    "hard light": 2.0,
}
"""Workloads and how large their errors are."""


def made_up_records(count: int, seed: int = 5) -> list[FrameRecord]:
    """`count` frames of each workload and object, and of scenes without object."""
    rng = np.random.default_rng(seed)
    return [
        _record(rng, name, workload, scale, index)
        for workload, scale in {**WORKLOADS, "absent": 0.0}.items()
        for name in OBJECTS
        for index in range(count)
    ]


def _record(rng: np.random.Generator, name: str, workload: str, scale: float, index: int) -> FrameRecord:
    present = scale > 0
    if not present:
        return FrameRecord(workload, name, index, 3, 0.0, False, "no object colours", False, milliseconds=2.0)
    visible = float(
        np.clip(rng.beta(5, 1.5) if workload != "occlusion bins" else rng.uniform(0.3, 0.7), 0.05, 1)
    )
    bound = 0.06 / visible * float(rng.lognormal(0, 0.2))
    found = bool(rng.random() < 0.4 + 0.62 * visible)
    if not found:
        return FrameRecord(
            workload, name, index, 3, visible, True, "poor fit", False, bound_mm=bound, bound_deg=1.6 * bound
        )
    wild = 60.0 if rng.random() < 0.03 else 1.0
    error = wild * scale * bound * rng.normal(size=6) * [0.6, 0.6, 0.6, 1.1, 1.1, 1.1]
    position, rotation = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    return FrameRecord(
        workload,
        name,
        index,
        3,
        visible,
        True,
        "found",
        True,
        position_mm=position,
        rotation_deg=rotation,
        add_mm=0.8 * position,
        mssd_mm=2 * position,
        mspd_px=position,
        nees=float(rng.chisquare(6)) * wild,
        confidence=float(np.clip(rng.beta(20, 1) if wild < 2 else rng.beta(2, 2), 0, 1)),
        bound_mm=bound,
        bound_deg=1.6 * bound,
        milliseconds=3.0,
    )


def made_up_speed() -> list[dict[str, Any]]:
    """Rows as `benchmarks.measure.speed.measure_speed` gives them."""
    rng = np.random.default_rng(3)

    def row(part: str, milliseconds: float, name: str, group: str, place: str = "") -> dict[str, Any]:
        return {
            "part": part,
            "object": name,
            "group": group,
            "bin": place,
            "n": 80,
            "median_ms": milliseconds,
            "p99_ms": milliseconds * float(rng.uniform(1.1, 3)),
            "reference_ms": 1.1,
            "ratio": milliseconds / 1.1,
            "ratio_p99": milliseconds / 0.6,
            "right": 98.0,
            "scenes": 3,
        }

    rendered = "rendered, 270×270"
    pictures = [(name, rendered) for name in OBJECTS] + [("cube_v1", "recorded, 540×540")]
    steps = {"segmentation": 0.4, "search": 1.1, "alignment": 0.5, "refinement": 1.2, "other": 0.2}
    rows = [row("time", 3.4, *which) for which in pictures]
    rows += [row("time, film", 0.9, *which) for which in pictures[:2]]
    rows += [row("time, stages", ms, *which, stage) for which in pictures for stage, ms in steps.items()]
    for name in OBJECTS:
        rows += [row("time, cameras", 1.2 * n, name, rendered, f"{n}") for n in (1, 2, 3)]
        rows += [row("time, resolution", s / 100, name, rendered, f"{s}") for s in (270, 540, 1080)]
        rows += [row("time, faces", 2 + 0.2 * n, name, rendered, f"{n}") for n in range(4, 10)]
    start_up = {"part": "start-up", "object": OBJECTS[0], "group": "import tracker", "n": 1}
    return [*rows, {**start_up, "seconds": 0.41, "megabytes": 120.0}]


ABOUT: dict[str, Any] = {
    "commit": "0123abc",
    "clean": True,
    "code": "c0de",
    "kernels": "ce11",
    "processor": "A <fast> one & only",
    "draw": "development",
    "seed": 1,
    "scenes": 30,
    "skipped": {"a": "why"},
    "parts": {"speed": {"commit": "0123abc", "clean": True, "seconds": 90}},
}


def made_up_results(count: int = 30) -> Results:
    """Results with every kind of part that a run has."""
    frames = frame_of(made_up_records(count))
    recorded = {"n": 5, "inside": 99.6, "same": 100.0, "wrong_and_sure": 0.0, "farthest_px": 0.4}
    rows = [
        *({"part": "workloads", "group": name, "about": "scenes", "n": count} for name in WORKLOADS),
        *accuracy_rows(frames),
        *made_up_speed(),
        *({"part": "triplets", "object": name, "group": "", **recorded} for name in ("cube_v1", OBJECTS[1])),
        {"part": "films, status", "object": OBJECTS[0], "group": "all", "n": 9, "found": 1, "tracking": 8},
    ]
    return Results(dict(ABOUT), rows, frames)
