"""Results of a run that never was, for tests of what is made from results."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from benchmarks.score.records import FrameRecord, select
from benchmarks.score.summary import summarise

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


def made_up_speed() -> dict[str, list[dict[str, Any]]]:
    """Tables as `benchmarks.measure.speed.measure_speed` gives them."""
    rng = np.random.default_rng(3)

    def row(milliseconds: float, **about: Any) -> dict[str, Any]:
        return {
            **about,
            "median_ms": milliseconds,
            "p99_ms": milliseconds * float(rng.uniform(1.1, 3)),
            "reference_ms": 1.1 * (about.get("size", 270) / 270) ** 1.6,
            "ratio": milliseconds / 1.1,
            "ratio_p99": milliseconds / 0.6,
            "right": 0.98,
            "detections": 80,
        }

    pictures = [("rendered", name, 270) for name in OBJECTS]
    pictures += [("recorded", "cube_v1", 540), ("recorded", "cube_v2", 540), ("recorded", OBJECTS[1], 270)]
    about = [{"images": kind, "object": name, "size": size, "scenes": 8} for kind, name, size in pictures]
    steps = {"segmentation": 0.4, "search": 1.1, "alignment": 0.5, "refinement": 1.2, "other": 0.2}
    return {
        "detect": [row(3.4, **a) for a in about],
        "stages": [
            {**a, "stage": stage, "median_ms": ms, "p99_ms": 2 * ms, "ratio": ms / 1.1}
            for a in about
            for stage, ms in steps.items()
        ],
        "cameras": [row(1.2 * n + 0.4 * k, **about[k], cameras=n) for k in (0, 1) for n in (1, 2, 3)],
        "resolution": [
            row(3.2 * (s / 270) ** 0.8, object=name, size=s, scenes=4)
            for name in OBJECTS
            for s in (270, 540, 1080)
        ],
        "faces": [row(2 + 0.2 * n, object=name, faces=n, scenes=3) for name in OBJECTS for n in range(4, 10)],
        "process": [
            {"what": "`import tracker`", "value": 0.41, "unit": "s"},
            {"what": "peak memory of a process that detects", "value": 231.0, "unit": "MB"},
        ],
    }


def _recorded(triplet: str) -> dict[str, Any]:
    shares = {"inside": 99.6, "same": 100.0, "wrong_and_sure": 0.0}
    sizes = {"farthest_px": 0.4, "tilt_deg": 0.3, "median_shift_mm": 0.1, "median_turn_deg": 0.2}
    return {"triplet": triplet, "draws": 5, "beyond_1_px": 0, **shares, **sizes}


def _segmented(name: str) -> dict[str, Any]:
    known = {"known": 0.9, "known_faces": 10, "unknown": np.nan, "unknown_faces": 0}
    return {"object": name, "faces": 10, "mean": 0.93, "worst": 0.82, **known}


def made_up_results(count: int = 30) -> dict[str, Any]:
    """Results with everything that a full run has."""
    targets = [
        ("median position", "cube_v2", 0.10, 0.089, True, "mm"),
        ("median position", "cuboid_2x2x8_v2", 0.18, 0.251, False, "mm"),
        ("a detection", "cube_v2", 2.0, None, None, "× reference"),
    ]
    records = made_up_records(count)
    keys = ("name", "object", "target", "value", "met", "unit")
    return {
        "about": {
            "commit": "0123abc",
            "processor": "A <fast> one & only",
            "seed": 1,
            "quick": True,
            "skipped": {"a": "why"},
        },
        "frames": [dataclasses.asdict(record) for record in records],
        "summary": {
            workload: {name: summarise(select(records, workload, name)) for name in OBJECTS}
            for workload in (*WORKLOADS, "absent")
        },
        "targets": [dict(zip(keys, target, strict=True)) for target in targets],
        "speed": made_up_speed(),
        "recorded": {"triplets": [_recorded("cube_v1"), _recorded("cuboid_2x2x8_v2")]},
        "segmentation": {"objects": [_segmented("cube_v1")]},
    }
