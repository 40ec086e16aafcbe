"""Contact shade: where a box stands, its foot and the table hide the sky from each other.

Shadow maps have cells of millimetres and leave out what is closer. A point at the distance d from the line
of contact has dark ground next to it, a strip of width w, which fills 1 − d / √(d² + w²) of the half of its
view that faces that ground; so much of the sky's light is taken, times a strength: most at the contact.
"""

from __future__ import annotations

import numpy as np

from synthetic.render.hits import Hits
from synthetic.scene import PlatformScene
from tracker.conventions import Array, FloatArray

_FLAT_M = 0.001
"""Paint and dust are no higher above the table than this [m]."""


def hidden(distance: FloatArray, width: float) -> FloatArray:
    """Share of the sky's light that a dark strip of `width` takes at a distance [m], 1 at its edge."""
    result: FloatArray = 1.0 - distance / np.hypot(distance, width)
    return result


def add_contact(reach: Array, hits: Hits, scene: PlatformScene) -> None:
    """Take from the sky's share in `reach` (h, w, 1 + lamps) what the scene's contact hides; in place."""
    strength, width = scene.contact
    box = next((n for n, body in enumerate(scene.bodies) if body.faces), None)
    if box is None or strength == 0 or not reach.size:
        return
    body = scene.bodies[box]
    pose, half = body.world_from_body, np.abs(body.mesh.vertices).max(axis=0)
    clearance = max(float(pose[2, 3] - np.abs(pose[2, :3]) @ half), 0.0)
    strength *= max(1.0 - clearance / width, 0.0)
    if strength == 0:
        return
    of_box = hits.body == box
    of_table = (hits.body >= 0) & ~of_box & (hits.points[..., 2] < _FLAT_M)
    inside = hits.points[of_table] @ pose[:3, :3] - pose[:3, 3] @ pose[:3, :3]
    away = np.linalg.norm(np.maximum(np.abs(inside) - half, 0.0), axis=-1)
    height = np.maximum(hits.points[of_box][:, 2], 0.0).astype(np.float64)
    for which, distance in ((of_box, height), (of_table, away)):
        reach[which, 0] *= 1.0 - strength * hidden(distance, width)
