"""The effect `fittings`: screws and bearings on the robot's shells, cables along links, seams of the wall."""

from __future__ import annotations

import dataclasses

import numpy as np

from synthetic.scene import Body, Mesh, PlatformScene
from synthetic.world.meshes import concatenate, disc
from tracker.conventions import Array, FloatArray

SCREWS = (4, 12)
"""Least and greatest number of screws on one link."""

SCREW_M, BEARING_M = (0.0015, 0.003), (0.005, 0.009)
"""Radius of screws and bearings [m]."""

CABLED = 0.6
"""Share of links with a cable."""

CABLE_M = (0.0015, 0.003)
"""Radius of a cable [m]."""

SEAMS = (2, 6)
"""Least and greatest number of seams in the wall."""

_LINKS = ("finger_upper_link_", "finger_middle_link_", "finger_lower_link_")
_METAL, _BLACK = (0.25, 0.55), (0.004, 0.02)
"""Reflectances."""

_METAL_COAT, _BLACK_COAT = (1.0, 0.25), (0.5, 0.3)
_LIFT = 2e-4
"""Of what lies on a surface, lest it flickers [m]."""


def fitted(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """The scene with fittings drawn from `rng`."""
    name = f"{rng.integers(2**62):x}"
    metal, black = rng.uniform(*_METAL), rng.uniform(*_BLACK)
    colors = np.stack([np.full(3, black), np.full(3, metal)])
    coats = np.array([_BLACK_COAT, _METAL_COAT])
    bodies = list(scene.bodies)
    for body in scene.bodies:
        if body.name == "wall":
            parts, groups = _seams(rng)
        elif any(body.name.startswith(link) and "visuals" not in body.name for link in _LINKS):
            parts, groups = _on_link(rng, body.mesh)
        else:
            continue
        vertices, triangles = concatenate(parts)
        key = f"fittings_{body.name}_{name}"
        mesh = Mesh(key, vertices, triangles, np.repeat(groups, [len(part[1]) for part in parts]))
        labels = np.zeros(2, dtype=np.uint8)
        bodies.append(Body(key, mesh, body.world_from_body, colors, labels, coats=coats))
    return dataclasses.replace(scene, bodies=tuple(bodies))


def _on_link(rng: np.random.Generator, mesh: Mesh) -> tuple[list[tuple[FloatArray, Array]], list[int]]:
    """Parts and their groups (0 black, 1 metal) on one link, in its frame."""
    count = int(rng.integers(SCREWS[0], SCREWS[1] + 1))
    places, normals = _on_surface(rng, mesh, count + 1)
    parts, groups = [], []
    for k, (place, normal) in enumerate(zip(places, normals, strict=True)):
        radius = rng.uniform(*(BEARING_M if k == count else SCREW_M))
        for group, share, lift in ((1, 1.0, 1.0), (0, rng.uniform(0.45, 0.75), 2.0)):
            flat = disc("", share * radius, 12)
            parts.append((_turned(flat.vertices, normal) + place + lift * _LIFT * normal, flat.triangles))
            groups.append(group)
    if rng.random() < CABLED:
        parts.append(_cable(rng, mesh))
        groups.append(0)
    return parts, groups


def _on_surface(rng: np.random.Generator, mesh: Mesh, count: int) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) spread evenly over a mesh, and the normals there."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    chosen = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("nk,nkc->nc", weights, corners[chosen]), across[chosen] / area[chosen, None]


def _cable(rng: np.random.Generator, mesh: Mesh) -> tuple[FloatArray, Array]:
    """A cable that sags along a link, on its outside."""
    low, high = np.asarray(mesh.vertices).min(axis=0), np.asarray(mesh.vertices).max(axis=0)
    along = int(np.argmax(high - low))
    beside = (along + int(rng.integers(1, 3))) % 3
    radius = rng.uniform(*CABLE_M)
    share = np.linspace(0.0, 1.0, 13)
    line = np.tile((low + high) / 2, (len(share), 1))
    line[:, along] = low[along] + (0.1 + 0.8 * share) * (high[along] - low[along])
    reach = 0.75 * (high - low)[beside] / 2 + radius
    sag = rng.uniform(0.0, 0.006) * np.sin(np.pi * share * rng.integers(1, 4))
    line[:, beside] += rng.choice([-1.0, 1.0]) * (reach + sag)
    return _tube(line, radius)


def _tube(line: FloatArray, radius: float, sides: int = 8) -> tuple[FloatArray, Array]:
    """A tube around the points (N, 3) of a line."""
    ways = np.gradient(line, axis=0)
    angle = 2 * np.pi * np.arange(sides) / sides
    circle = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    vertices = np.concatenate(
        [_turned(circle, way / np.linalg.norm(way)) + p for p, way in zip(line, ways, strict=True)]
    )
    k = np.arange(sides)
    following = (k + 1) % sides
    ring = np.concatenate(
        [
            np.stack([k, following, sides + following], axis=1),
            np.stack([k, sides + following, sides + k], axis=1),
        ]
    )
    return vertices, np.concatenate([ring + sides * n for n in range(len(line) - 1)])


def _turned(points: FloatArray, normal: FloatArray) -> FloatArray:
    """Points (N, 3) turned so that z becomes `normal`, always alike for one normal."""
    side = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.7 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    result: FloatArray = points @ np.stack([side, np.cross(normal, side), normal])
    return result


def _seams(rng: np.random.Generator) -> tuple[list[tuple[FloatArray, Array]], list[int]]:
    """Upright seams in the wall, as strips just within it."""
    heights, radii = np.array([0.025, 0.038, 0.103, 0.172]), np.array([0.199, 0.1985, 0.2375, 0.277])
    parts = []
    for azimuth in rng.uniform(0.0, 2 * np.pi, int(rng.integers(SEAMS[0], SEAMS[1] + 1))):
        half = rng.uniform(0.0002, 0.0006)
        out, side = (
            np.array([np.cos(azimuth), np.sin(azimuth), 0]),
            np.array([-np.sin(azimuth), np.cos(azimuth), 0]),
        )
        line = radii[:, None] * out + heights[:, None] * [0.0, 0.0, 1.0]
        vertices = np.concatenate([line - half * side, line + half * side])
        k, n = np.arange(len(line) - 1), len(line)
        triangles = np.concatenate(
            [np.stack([k, n + k, k + 1], axis=1), np.stack([k + 1, n + k, n + k + 1], axis=1)]
        )
        parts.append((vertices, triangles))
    return parts, [0] * len(parts)
