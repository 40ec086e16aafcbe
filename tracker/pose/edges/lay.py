"""Strips along the edges of a posed object in one picture, with their pixels."""

from __future__ import annotations

from tracker.compiled import compiled
from tracker.geometry.lens import apply_update
from tracker.pose.edges.pixels import collect
from tracker.pose.edges.strips import edge_strips


@compiled
def lay_strips(  # type: ignore[no-untyped-def]
    image, tilt, red, lenses, c, box, rotation, position, offset, piece, margin, reach, scale, every,
    strips, distance, values,
):  # fmt: skip
    """Lay strips in camera c's picture and collect their pixels; returns their count.

    The camera sees the object at the pose (3, 3), (3,) moved by `offset` (6,). piece: length of a strip;
    margin: its distance from corners; reach: its half width [px]; the rest: see `strips` and `pixels`.
    """
    seen_rotation, seen_position = rotation.copy(), position.copy()
    apply_update(seen_rotation, seen_position, offset)
    n = edge_strips(lenses, c, box.half, box.face_labels, seen_rotation, seen_position, piece, margin, strips)
    collect(image, tilt, red, strips, n, reach, scale, every, distance, values)
    return n
