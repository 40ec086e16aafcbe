"""Whether an object that seems to rest floats above the table, or is sunk into it."""

from __future__ import annotations

import math

from tracker.calibration.by_object.health import HEIGHT, height_over_table
from tracker.geometry.arena import SURE, Arena
from tracker.objects.model import CuboidModel
from tracker.pose.result import PoseEstimate

TRUSTED = 0.5
"""Confidence from which a pose counts."""


def off_table(pose: PoseEstimate | None, model: CuboidModel, arena: Arena) -> str | None:
    """By how much an object is off the table on which it seems to rest, and the remedy, in one line.

    It seems to rest if a face is level, and no higher than the table may be. None if it is off by less than
    two standard deviations or the limit of HEIGHT, or nothing is known.
    """
    if pose is None or pose.confidence < TRUSTED:
        return None
    height, std = (
        height_over_table(pose.position, pose.rotation, model, arena),
        1e3 * math.sqrt(pose.covariance[2, 2]),
    )
    highest = SURE * 1e3 * math.hypot(arena.table_std[0], 1e-3 * std)
    if not max(2.0 * std, HEIGHT.limits[1]) < abs(height) <= highest:
        return None
    where = "floats {:.1f} mm above" if height > 0 else "sinks {:.1f} mm into"
    return (
        f"{model.name} {where.format(abs(height))} the table (± {std:.1f} mm): if it rests, "
        "`tracker calibrate table RECORDING -o DIR` finds the table"
    )
