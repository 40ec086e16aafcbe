"""The effect `reflections`: a cuboid's faces light table and fingers, and fingers light the faces.

The sky is also sampled more finely, since interreflected light leaves no steps in the shade.

Light from the table is already part of the ambient light that all surfaces get from below.
"""

import dataclasses

import numpy as np

from synthetic.render.shadows import sky_slope
from synthetic.scene import Body, Lighting, Patches, PlatformScene
from tracker.conventions import FloatArray
from tracker.geometry.cuboid import FACE_NORMALS

STRENGTH = (0.6, 1.2)
"""Range of the reflected light relative to that of an unoccluded matt surface."""

_CELLS = 2
"""Patches along each edge of a face."""

_SLICES = 4
"""Patches along a link of a finger."""

_NEAR_M = 0.12
"""Distance from the object beyond which links are ignored [m]."""

_SKY = 22
"""Number of directions of the ambient light."""

_LINKS = ("finger_middle_link_", "finger_lower_link_", "finger_tip_link_")


def reflecting(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """Return the scene whose cuboid and fingers light their surroundings; dice only get smoother shade."""
    strength = float(rng.uniform(*STRENGTH))
    scene = dataclasses.replace(scene, lighting=dataclasses.replace(scene.lighting, sky=_SKY))
    body = scene.cuboid
    if body is None:
        return scene
    parts = [_of_faces(body, scene.lighting)]
    for link in scene.bodies:
        if link.name.startswith(_LINKS) and "visuals" not in link.name:
            part = _of_link(link, scene.lighting)
            near = np.linalg.norm(part.places - body.world_from_body[:3, 3], axis=1) < _NEAR_M
            parts.append(part.chosen(near))
    whole = Patches.joined(parts)
    return dataclasses.replace(scene, patches=whole._replace(light=strength * whole.light))


def _of_faces(body: Body, lighting: Lighting) -> Patches:
    size = body.size
    rotation, position = body.world_from_body[:3, :3], body.world_from_body[:3, 3]
    line = (np.arange(_CELLS) + 0.5) / _CELLS - 0.5
    parts = []
    for face, normal in enumerate(FACE_NORMALS):
        axis = face // 2
        across, along = (axis + 1) % 3, (axis + 2) % 3
        cells = np.zeros((_CELLS, _CELLS, 3))
        cells[..., across], cells[..., along] = np.meshgrid(line * size[across], line * size[along])
        cells[..., axis] = normal[axis] * size[axis] / 2
        outwards = rotation @ normal
        count = _CELLS**2
        parts.append(
            Patches(
                cells.reshape(-1, 3) @ rotation.T + position,
                np.tile(outwards, (count, 1)),
                np.full(count, size[across] * size[along] / count),
                np.tile(body.colors[face] * _irradiance(outwards, lighting), (count, 1)),
                np.full(count, body.name),
            )
        )
    return Patches.joined(parts)


def _of_link(link: Body, lighting: Lighting) -> Patches:
    """Return patches for slices of a link, each a small round thing."""
    vertices = link.mesh.vertices
    along = int(np.argmax(np.ptp(vertices, axis=0)))
    bounds = np.quantile(vertices[:, along], [0.0, 1.0])
    slot = np.clip((vertices[:, along] - bounds[0]) / np.ptp(bounds) * _SLICES, 0, _SLICES - 1).astype(int)
    used = [k for k in range(_SLICES) if (slot == k).any()]
    centers = np.stack([vertices[slot == k].mean(axis=0) for k in used])
    width = np.delete(np.ptp(vertices, axis=0), along).mean() / 2
    color = np.bincount(link.mesh.groups, minlength=len(link.colors)) @ link.colors / len(link.mesh.groups)
    light = color * (lighting.ambient + sum(lamp.color for lamp in lighting.lamps) / 2)
    count = len(centers)
    return Patches(
        centers @ link.world_from_body[:3, :3].T + link.world_from_body[:3, 3],
        np.zeros((count, 3)),
        np.full(count, np.pi * width**2),
        np.tile(light, (count, 1)),
        np.full(count, link.name),
    )


def _irradiance(normal: FloatArray, lighting: Lighting) -> FloatArray:
    """Return the irradiance (3,) on an unoccluded surface of this normal (3,); the table below is dark."""
    total = lighting.ambient * sky_slope(normal[2])
    for lamp in lighting.lamps:
        total = total + lamp.color * max(float(lamp.direction @ normal), 0.0)
    result: FloatArray = total
    return result
