"""Light that near things give each other: every surface gets the light of the patches that face it.

A patch of area A whose light is E (as reflectance × irradiance) gives a point at the distance d the
irradiance E cos θ cos θ' A / (π d² + A), exact far away and at most E close by. Nothing stands in its way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synthetic.render.hits import Hits
from synthetic.render.surfaces import Surfaces
from synthetic.scene import Patches, PlatformScene
from tracker.compiled import compiled
from tracker.conventions import Array

_REACH_M = 0.06
"""Farther from all patches than this their light is not looked at."""


class _Lights(NamedTuple):
    """Patches as the kernel takes them."""

    owners: Array
    """(N,) int64 numbers of bodies."""
    places: Array
    facing: Array
    areas: Array
    light: Array


def add_bounced(color: Array, scene: PlatformScene, patches: Patches, hits: Hits, surfaces: Surfaces) -> None:
    """Add to `color` (h, w, 3) what the scene's patches give to other bodies than their own."""
    numbers = {body.name: number for number, body in enumerate(scene.bodies)}
    owners = np.array([numbers[name] for name in patches.owners], dtype=np.int64)
    middle = patches.places.mean(axis=0)
    reach = float(np.linalg.norm(patches.places - middle, axis=1).max()) + _REACH_M
    parts = patches.places, patches.normals, patches.areas, patches.light
    lights = _Lights(owners, *(np.ascontiguousarray(part) for part in parts))
    _add(color, hits, surfaces.colors, middle, reach * reach, lights)


@compiled
def _add(color: Array, hits: Hits, reflectance: Array, middle: Array, reach2: float, lights: _Lights) -> None:
    body, row, points, normals = hits.body, hits.row, hits.points, hits.normals
    owners, places, facing, areas, light = lights
    for j in range(body.shape[0]):
        for i in range(body.shape[1]):
            if body[j, i] < 0:
                continue
            px, py, pz = points[j, i, 0], points[j, i, 1], points[j, i, 2]
            if (px - middle[0]) ** 2 + (py - middle[1]) ** 2 + (pz - middle[2]) ** 2 > reach2:
                continue
            nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            blue, green, red = 0.0, 0.0, 0.0
            for k in range(len(areas)):
                if owners[k] == body[j, i]:
                    continue
                dx, dy, dz = places[k, 0] - px, places[k, 1] - py, places[k, 2] - pz
                here = nx * dx + ny * dy + nz * dz
                if here <= 0:
                    continue
                square = dx * dx + dy * dy + dz * dz
                there = -(facing[k, 0] * dx + facing[k, 1] * dy + facing[k, 2] * dz)
                if facing[k, 0] == 0 and facing[k, 1] == 0 and facing[k, 2] == 0:
                    there = np.sqrt(square)  # a small round thing faces everything
                if there <= 0:
                    continue
                share = here * there / square * areas[k] / (np.pi * square + areas[k])
                blue += share * light[k, 0]
                green += share * light[k, 1]
                red += share * light[k, 2]
            color[j, i, 0] += reflectance[row[j, i], 0] * blue
            color[j, i, 1] += reflectance[row[j, i], 1] * green
            color[j, i, 2] += reflectance[row[j, i], 2] * red
