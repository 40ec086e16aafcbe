"""The tables of the results, in the order in which they are shown: which figures for which answers.

To add a table, add an entry to TABLES, from which results, gate and documents read everything.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.score import dice, films
from benchmarks.score.metrics import (
    ANSWERS,
    FINDS,
    INSIDE,
    MEDIAN,
    MEDIAN_DEG,
    NEES,
    P90,
    RIGHT,
    TIMES,
    TRUST,
    WRONG_AND_SURE,
    Metric,
    Table,
    at,
    by_visibility,
    percent,
    right,
    share,
    value,
)

VISIBLE = ((0.9, 1.0), (0.7, 0.9), (0.5, 0.7), (0.3, 0.5), (0.0, 0.3))
"""Bins of the mean visible fraction."""

CONFIDENCE = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.98, 0.99, 1.0)
"""Limits of the bins of confidence."""

STAGES = ("light", "segmentation", "pose")
"""Stages of a detection that `Observation.timing_ms` names."""


def figures(frames: Mapping[str, pd.DataFrame]) -> list[dict[str, Any]]:
    """Return all figures of the measured parts."""
    return [
        _finite(row) for table in TABLES if table.part in frames for row in table.figures(frames[table.part])
    ]


def _finite(row: dict[str, Any]) -> dict[str, Any]:
    return {key: x for key, x in row.items() if not (isinstance(x, float) and not math.isfinite(x))}


def by_confidence(rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the non-empty bins of the stated confidence."""
    given = rows[rows.confidence.notna()]
    place = np.clip(np.searchsorted(CONFIDENCE, given.confidence, side="right") - 1, 0, len(CONFIDENCE) - 2)
    for k, (low, high) in enumerate(itertools.pairwise(CONFIDENCE)):
        if (place == k).any():
            yield f"{low:g}-{high:g}", given[place == k]


def by_rest(rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the rows at rest, and those in motion."""
    for name, own in (("at rest", rows[rows.at_rest]), ("moving", rows[~rows.at_rest])):
        if len(own):
            yield name, own


_PAGE = ("realistic", "world", "one camera", "hard light", "poor images", "other calibration")
"""Workloads that the figures page shows."""

_BRIEFLY = ("realistic", "world")
"""Workloads that it shows in the tables of confidence and time."""

NOT_THE_OBJECT = ("absent", "look-alike: *")
"""Workloads that do not show the object."""

_STATED = (
    Metric("stated", "stated", lambda rows: 100 * rows.confidence.mean(), "{:.1f} %"),
    Metric("right", "right", lambda rows: percent(right(rows)), "{:.1f} %"),
)


def _moving(column: str) -> Callable[[pd.DataFrame], float]:
    return lambda rows: at(column, 0.5)(rows[rows.moving])


def _stage(name: str) -> Metric:
    return Metric(
        f"{name}_ratio",
        name,
        lambda rows: at(f"{name}_ms", 0.5)(rows) / at("reference_ms", 0.5)(rows),
        "{:.2f}",
    )


TABLES: tuple[Table, ...] = (
    Table(
        "accuracy",
        "Accuracy",
        "Rendered scenes with exact truth, three 270×270 images unless a workload says otherwise. Errors "
        "are of the poses given, shares of all scenes. Wrong and sure: beyond 5 mm or 5° with a confidence "
        "above 0.5.",
        ANSWERS,
        without=NOT_THE_OBJECT,
        heads=("object", "workload", ""),
        page=_PAGE,
    ),
    Table(
        "trust",
        "Covariance and confidence",
        "NEES is dᵀ Σ⁻¹ d of the six errors d in the stated covariance Σ: if Σ is right, its median is "
        "5.35 and 95 % lie inside the ellipsoid. Stated − right, without sign: mean confidence of the poses "
        "given, share of them within 5 mm and 5°. Brier score: mean of (confidence − 1 if right, else − 0)².",
        TRUST,
        without=NOT_THE_OBJECT,
        heads=("object", "workload", ""),
        page=_BRIEFLY,
        part="accuracy",
    ),
    Table(
        "finds",
        "Without the object",
        "Pictures that do not show the object, or show something like it.",
        FINDS,
        NOT_THE_OBJECT,
        heads=("object", "workload", ""),
        part="accuracy",
    ),
    Table(
        "detect",
        "Time of `detect`",
        "One thread's processor time (stages: wall clock), and the multiple of reference work "
        "(`cv2.medianBlur` 5 and HSV of the same images) right after it.",
        (*TIMES, *map(_stage, STAGES)),
        heads=("object", "workload", ""),
        page=_BRIEFLY,
        part="accuracy",
    ),
    Table(
        "visibility",
        "By visible fraction",
        "The mean over the cameras of the share of the object that nothing hides.",
        ANSWERS,
        ("realistic", "world", "two cameras", "one camera"),
        split=by_visibility(*VISIBLE),
        heads=("object", "workload", "visible"),
        part="accuracy",
    ),
    Table(
        "confidence",
        "Stated confidence",
        "And the share that was right.",
        _STATED,
        ("realistic", "world", "two cameras", "one camera", "hard light", "poor images"),
        split=by_confidence,
        heads=("object", "workload", "confidence"),
        part="accuracy",
    ),
    Table(
        "triplets",
        "Recorded triplets",
        "Hand-made masks; draws of gains (0.8 to 1.2 for each channel) and exposure (0.6 to 1.4), each "
        "picture by itself, against the undisturbed pose: wrong is farther from it than 3 mm or 3°.",
        (
            Metric("inside", "labelled pixels inside their face", value("inside"), "{:.2f} %", "higher"),
            Metric("tilt_deg", "tilt of the face on the table", value("tilt_deg"), "{:.2f}°"),
            Metric("same", "within 3 mm and 3° in other light", value("same"), "{:.1f} %", "higher"),
            Metric("light_wrong", "wrong and sure", value("light_wrong"), "{:.1f} %"),
        ),
    ),
    Table(
        "third camera",
        "Recorded triplets: cameras against each other",
        "The pose from two cameras against what the third sees by itself, in its picture [px at a focal "
        "length of 295 px]; no truth is needed.",
        (
            Metric("px", "miss", value("px"), "{:.2f} px", step=0.05),
            Metric("miss_mm", "across the line of sight", value("miss_mm"), "{:.2f} mm", step=0.1),
            Metric("shift_mm", "shift against all three", value("shift_mm"), "{:.2f} mm", step=0.1),
            Metric("turn_deg", "turn", value("turn_deg"), "{:.2f}°", step=0.1),
        ),
        heads=("object", "left out", ""),
    ),
    Table(
        "two sizes",
        "Recorded triplets: two sizes of the pictures",
        "The pose of the pictures as recorded against that of the same pictures at half or twice the size.",
        (
            Metric("shift_mm", "shift", value("shift_mm"), "{:.2f} mm"),
            Metric("turn_deg", "turn", value("turn_deg"), "{:.2f}°"),
        ),
    ),
    Table(
        "recorded, one camera",
        "Recorded pictures, one camera",
        "Each recorded picture alone, in drawn light with drawn noise: `detect`, and `update` through a "
        "film of them. Right: within 20 mm and 5° of the pose of all cameras, since one camera hardly sees "
        "depth.",
        (
            share("posed", "given a pose", lambda rows: rows.found, "higher", step=2.0),
            share(
                "right_20",
                "posed and right",
                lambda rows: right(rows, millimetres=films.NEAR_MM),
                "higher",
                step=2.0,
            ),
            Metric(
                "confidence",
                "mean confidence",
                lambda rows: 100 * rows.confidence.mean(),
                "{:.1f} %",
                "same",
                step=1.5,
            ),
        ),
        heads=("object", "by", ""),
    ),
    Table(
        "segmentation",
        "Segmentation",
        "Intersection over union with hand-made masks over the whole picture; the masks are a little too "
        "small on purpose. Left out: fitted without the picture that is judged, for colours that another "
        "picture shows.",
        (
            Metric("iou", "mean", value("iou"), "{:.3f}", "higher"),
            Metric("worst_iou", "worst face", value("worst_iou"), "{:.3f}", "higher"),
            Metric("known_iou", "left out", value("known_iou"), "{:.3f}", "higher"),
        ),
    ),
    Table(
        "films",
        "Over time",
        "Filtered poses of `update` in films at 10 Hz of each object, pushed, tumbled, lifted, carried and "
        "dropped by fingers: two long films, and in `world`, with every effect of the real world, eight "
        "short ones, each by its own cameras. A flip is a rotation more than 30° off with a confidence above "
        "0.5.",
        (
            MEDIAN,
            P90,
            RIGHT,
            Metric("single", "`detect` alone", films.single, "{:.1f} %", "higher"),
            WRONG_AND_SURE,
            Metric("flips", "flips", films.flips, "{:.0f}"),
            Metric("losses", "losses", films.losses, "{:.0f}"),
            NEES,
            INSIDE,
        ),
        ("all", "every *", "world"),
        heads=("object", "given", ""),
        page=("all", "world"),
    ),
    Table(
        "films, at rest",
        "At rest and moving",
        "Median errors of the filtered pose, and over those of `detect` on the same frames.",
        (
            MEDIAN,
            MEDIAN_DEG,
            Metric("over_single_mm", "over single shot, position", films.over_single("mm"), "{:.2f}"),
            Metric("over_single_deg", "rotation", films.over_single("deg"), "{:.2f}"),
        ),
        ("all",),
        split=by_rest,
        heads=("object", "", "state"),
        part="films",
    ),
    Table(
        "films, one camera",
        "Over time, one camera",
        "What one camera alone measures of the frames in which it sees at least half of the object. Right: "
        "within 20 mm and 5°.",
        (
            Metric("near", "right", films.seen_share(lambda near, none: near), "{:.1f} %", "higher"),
            Metric("none", "no pose", films.seen_share(lambda near, none: none), "{:.1f} %"),
            Metric("wrong", "wrong", films.seen_share(lambda near, none: ~near & ~none), "{:.1f} %"),
            Metric("longest_wait", "longest wait", films.longest_wait, "{:.0f} frames"),
        ),
        ("camera *", "world, *"),
        heads=("object", "camera", ""),
        part="films",
    ),
    Table(
        "films, vanished",
        "Over time, the object gone",
        "It vanishes for two seconds and comes back elsewhere.",
        (
            Metric("invented", "frames with a pose measured", films.vanished("invented"), "{:.0f}"),
            Metric("kept", "predicted after half a second", films.vanished("kept"), "{:.0f}"),
            Metric("longest_wait", "found again after", films.vanished("longest_wait"), "{:.0f} frames"),
        ),
        ("vanished",),
        part="films",
    ),
    Table(
        "update",
        "Time of `update`",
        "Of all frames of the same films, as the time of `detect`.",
        TIMES,
        ("all", "world", "world, *"),
        heads=("object", "given", ""),
        page=("all", "world"),
        part="films",
    ),
    Table(
        "motion",
        "Fast motions",
        "The object flies at about 0.5 m/s, turning, and rests now and then; each frame was taken twice: "
        "by all cameras at once, and by one after the other within 10 ms. Medians while it moves; "
        "predicted 50 ms ahead.",
        tuple(
            Metric(f"{pose}_{unit}", title, _moving(f"{pose}_{unit}"), form, better)
            for pose in ("measured", "filtered", "predicted")
            for unit, title, form, better in (
                ("mm", pose, "{:.3f} mm", "lower"),
                ("deg", "rotation", "{:.2f}°", "lower"),
                ("nees", "NEES", "{:.1f}", "same"),
            )
        ),
        heads=("object", "pictures", ""),
    ),
    Table(
        "dice, masks",
        "Dice: masks",
        "Of all pixels of all views together. Not dice: pixels of the blue cross painted on the table, and "
        "all others more than 2 px from any die, of the whole picture.",
        (
            Metric("iou", "IoU", dice.overlap("iou"), "{:.3f}", "higher"),
            Metric("precision", "precision", dice.overlap("precision"), "{:.3f}", "higher"),
            Metric("recall", "recall", dice.overlap("recall"), "{:.3f}", "higher"),
            Metric(
                "cross_taken", "of the cross taken for dice", dice.taken("cross_taken", "cross"), "{:.1f} %"
            ),
            Metric("elsewhere", "false elsewhere", dice.taken("elsewhere", "total"), "{:.4f} %"),
        ),
        heads=("", "scenes", ""),
    ),
    Table(
        "dice, positions",
        "Dice: positions",
        "Of the true dice, by visible fraction; reported dice are paired with true ones within half a "
        "die's edge.",
        (
            share("found", "found", lambda rows: rows.mm.notna(), "higher"),
            Metric("median_mm", "error, median", at("mm", 0.5), "{:.2f} mm"),
            Metric("p90_mm", "90th percentile", at("mm", 0.9), "{:.2f} mm", below=0.9),
        ),
        split=by_visibility(*dice.BINS),
        heads=("", "scenes", "visible"),
        page=("thrown, masks and images",),
    ),
    Table(
        "dice, reported",
        "Dice: reported",
        "Those that are none, and whether the stated probability is true.",
        (
            share("invented", "invented", lambda rows: ~rows.right.astype(bool), form="{:.2f} %"),
            Metric("stated", "mean probability", lambda rows: 100 * rows.probability.mean(), "{:.1f} %"),
            Metric("brier", "Brier score", dice.brier, "{:.4f}"),
        ),
        heads=("", "scenes", ""),
    ),
    Table("dice, time", "Dice: time", "Of three 270×270 pictures.", TIMES, heads=("", "work", "")),
    Table(
        "start-up",
        "Start-up and memory",
        "Of a fresh process; compiling happens once per machine.",
        (
            Metric("seconds", "time", value("seconds"), "{:.1f} s"),
            Metric("megabytes", "peak memory", value("megabytes"), "{:.0f} MB"),
        ),
        heads=("", "", ""),
        page=("*",),
    ),
)

BY_NAME = {table.name: table for table in TABLES}
