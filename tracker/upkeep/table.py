"""Finds the table by objects that rest on it, and puts the calibration's z = 0 there."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.pose_errors import pose_errors
from tracker.calibration.rig import CameraRig
from tracker.calibration.table_plane import LEAST, Rest, TablePlane, fit_table, levelled
from tracker.errors import CalibrationError
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.evidence import View
from tracker.segmentation.color_model import ColorModel
from tracker.upkeep.edges import EdgeReader
from tracker.upkeep.footage import Footage
from tracker.upkeep.rests import resting
from tracker.upkeep.sightings import Sighting, sightings

BROAD = 0.015, 0.05
"""Standard deviations of the table's height [m] and tilt [rad] before it is found."""

PIECES = 8
"""Pieces of edges that a camera must show to have a say."""


@dataclass(frozen=True, eq=False)
class FoundTable:
    """The table, and the calibration in a world whose z = 0 it is."""

    rig: CameraRig
    """The same cameras in that world, and its arena."""
    plane: TablePlane
    """The table in the world of before."""
    rests: int
    """Places in which the object was at rest, or held as still."""
    shots: int
    """Shots in which the object was surely seen."""


def find_table(
    model: CuboidModel,
    footage: Sequence[Footage],
    rig: CameraRig,
    colors: ColorModel,
    progress: Callable[[int], None] = lambda _: None,
) -> FoundTable:
    """The table as films and stills of an object show it that rests on it now and then.

    Args:
        model: the object.
        footage: of the rig's cameras, in the order of the rig.
        rig: the cameras, two or more.
        colors: the object's.
        progress: is told how many more shots showed the object.

    Raises:
        CalibrationError: there is one camera only, or the object rested in too few places.
    """
    refuse_one_camera(rig)
    arena = rig.arena
    std = max(arena.table_std[0], BROAD[0]), max(arena.table_std[1], BROAD[1])
    broad = dataclasses.replace(rig, arena=dataclasses.replace(arena, table_std=std))
    tracker, edges = ObjectTracker(model, broad, colors), EdgeReader(model, broad, colors)
    shots, lonely, rests = 0, 0, []
    for one in footage:
        seen: list[Sighting] = []
        for sighting in sightings(tracker, one):
            seen.append(sighting)
            progress(1)
        shots += len(seen)
        still = resting(seen)
        for sighting, images in zip(still, one.images([s.number for s in still]), strict=True):
            rest = _rest(edges, sighting, edges.views(images), model.rim_std)
            if rest is not None:
                rests.append(rest)
            else:
                lonely += 1
    if len(rests) < LEAST <= len(rests) + lonely:
        raise CalibrationError(
            f"table: found {lonely} places in which one camera alone sees the object at rest, and "
            f"{len(rests)} in which others do, expected {LEAST} of these: one camera's depth is not the "
            "table's height"
        )
    if not shots:
        raise CalibrationError(f"table: found no picture in which {model.name} is surely seen")
    plane = fit_table(rests, model.size, rig)
    return FoundTable(levelled(rig, plane), plane, len(rests), shots)


def refuse_one_camera(rig: CameraRig) -> None:
    """Raise where a rig has one camera only."""
    if len(rig) < 2:
        raise CalibrationError(
            f"table: found {rig.names[0]} alone, expected two cameras or more: one camera's depth is not the "
            "table's height"
        )


def _rest(edges: EdgeReader, sighting: Sighting, views: Sequence[View | None], rim_std: float) -> Rest | None:
    """The pose once more from one shot, with its errors; None where fewer than two cameras see its edges."""
    refined = edges.refine(views, sighting.rotation, sighting.position)
    found = edges.contours(views, refined.rotation, refined.position, refined.end)
    if sum(one is not None and len(one.offset) >= PIECES for one in found) < 2:
        return None
    own, common = pose_errors(found, refined.position, edges.rig.cameras, rim_std)
    if not np.isfinite(own).all():
        return None
    return Rest(refined.position, refined.rotation, own, common)
