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
from tracker.pose.views import Sight
from tracker.segmentation.color_model import ColorModel
from tracker.upkeep.edges import EdgeReader
from tracker.upkeep.footage import Footage
from tracker.upkeep.rests import resting
from tracker.upkeep.sightings import Sighting, all_sightings

BROAD = 0.015, 0.05
"""Standard deviations of the table's height [m] and tilt [rad] before it is found."""

SURE = 0.5
"""Least confidence of a pose that counts."""

PIECES = 8
"""Pieces of edges that a camera must show to have a say."""


@dataclass(frozen=True, eq=False)
class FoundTable:
    """The table, and the calibration in a world whose z = 0 it is."""

    rig: CameraRig
    """The same cameras in that world, and its arena."""
    plane: TablePlane
    """The table in the world of before."""
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
    loose = broad(rig)
    tracker, edges = ObjectTracker(model, loose, colors, support=False), EdgeReader(model, loose, colors)
    seen = all_sightings(tracker, footage, SURE, progress)
    if not any(seen):
        raise CalibrationError(f"table: found no picture in which {model.name} is surely seen")
    plane = plane_of(model, edges, footage, seen)
    return FoundTable(levelled(rig, plane), plane, sum(map(len, seen)))


def broad(rig: CameraRig) -> CameraRig:
    """The same cameras, of which it is hardly known where the table is."""
    height, tilt = rig.arena.table_std
    std = max(height, BROAD[0]), max(tilt, BROAD[1])
    return dataclasses.replace(rig, arena=dataclasses.replace(rig.arena, table_std=std))


def plane_of(
    model: CuboidModel, edges: EdgeReader, footage: Sequence[Footage], seen: Sequence[Sequence[Sighting]]
) -> TablePlane:
    """The plane on which an object rests that was seen in footage, by the cameras of an edge reader.

    Raises:
        CalibrationError: it rested in too few places.
    """
    rests, lonely = [], 0
    for one, part in zip(footage, seen, strict=True):
        still = resting(part)
        for sighting, images in zip(still, one.images([s.number for s in still]), strict=True):
            rest = _rest(edges, sighting, edges.sight(images), model.rim_std)
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
    return fit_table(rests, model.size, edges.rig)


def refuse_one_camera(rig: CameraRig) -> None:
    """Raise where a rig has one camera only."""
    if len(rig) < 2:
        raise CalibrationError(
            f"table: found {rig.names[0]} alone, expected two cameras or more: one camera's depth is not the "
            "table's height"
        )


def _rest(edges: EdgeReader, sighting: Sighting, sight: Sight, rim_std: float) -> Rest | None:
    """The pose once more from one shot, with its errors; None where fewer than two cameras see its edges."""
    refined = edges.refine(sight, sighting.rotation, sighting.position)
    found = edges.contours(sight, refined.rotation, refined.position, refined.end)
    if sum(one is not None and len(one.offset) >= PIECES for one in found) < 2:
        return None
    own, common = pose_errors(found, refined.position, edges.rig.cameras, rim_std)
    if not np.isfinite(own).all():
        return None
    return Rest(refined.position, refined.rotation, own, common)
