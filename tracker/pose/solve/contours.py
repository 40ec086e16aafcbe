"""Hands out what pictures say of a posed object's edges, for those who solve for more than its pose."""

from __future__ import annotations

from collections.abc import Sequence

from tracker.calibration.contour import Contour
from tracker.conventions import FloatArray
from tracker.pose.evidence import View
from tracker.pose.solve.refine import measure_all, take_stock, trust_of
from tracker.pose.solve.refiner import Refiner
from tracker.pose.solve.schedule import SCHEDULE, TUNING
from tracker.pose.start import Start

TURNS = 2
"""Measurements, of which each takes its blur from the one before."""


def contours(
    refiner: Refiner,
    views: Sequence[View | None],
    rotation: FloatArray,
    position: FloatArray,
    start: Start,
    offsets: FloatArray | None = None,
) -> list[Contour | None]:
    """Each camera's edges at a pose (3, 3), (3,) [m], None where it has no picture or sees none.

    Args:
        refiner: of the object, in the cameras.
        views: of the pictures.
        rotation: world_from_object.
        position: of the object's centre.
        start: blur of the pictures, and the exponent and rim with which the object is drawn.
        offsets: (C, 6) by which each camera is known to see the object moved [m, rad]: the edges are looked
            for there. What is handed out is told from the pose itself all the same.
    """
    attempt = refiner.begin(views, rotation, position, start)
    if offsets is not None:
        attempt.unknowns.offsets[:, :6] = offsets
    work = refiner.laid(attempt, SCHEDULE, len(SCHEDULE.blur) - 1)
    for _ in range(TURNS):
        measure_all(attempt.cameras, attempt.unknowns, SCHEDULE, len(SCHEDULE.blur) - 1, work)
        take_stock(attempt.cameras, attempt.unknowns, TUNING, work, attempt.seen)
    result: list[Contour | None] = []
    for c, lens in enumerate(refiner.lenses):
        count = work.counts[c]
        found = work.found[c, :count]
        strips, found = work.strips[c, :count][found["usable"]], found[found["usable"]]
        if len(found) == 0:
            result.append(None)
            continue
        scale = attempt.cameras.scales[c]
        trust = trust_of(attempt.cameras.parts[c], attempt.unknowns.blurs[c], scale, TUNING)
        jacobian = strips["jacobian"] / scale
        result.append(
            Contour(
                pixel=strips["pixel"] - lens["center"],
                normal=strips["normal"].copy(),
                jacobian=jacobian,
                bloom=found["bloom"] / scale,
                rim=strips["rim"] / scale,
                offset=found["offset"] / scale + jacobian @ attempt.unknowns.offsets[c, :6],
                variance=(TUNING.floor**2 + found["variance"] / scale**2) / trust,
                edge=strips["edge"].copy(),
                scale=float(scale),
            )
        )
    return result
