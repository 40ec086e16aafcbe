"""The effect `clutter`: things on the wall or outside, in the same places for a whole film.

Things on the wall are close to it, and so hide only objects next to it. Things outside are no higher than the
rim, over which every camera looks.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from synthetic.look.face_colors import reflectances
from synthetic.scene import Body, Mesh, PlatformScene
from synthetic.world import meshes
from tracker.conventions import Array, FloatArray

PIECES = (2, 7)
"""Smallest and largest number of things."""

IN_FACE_COLORS = 0.5
"""Share of things in the colour of a face; the others are black, grey, white, or like wood or skin."""

_PAINTS = "cube_v2"
_OTHERS = np.array([[0.01] * 3, [0.1] * 3, [0.5] * 3, [0.8] * 3, [0.08, 0.16, 0.25], [0.2, 0.3, 0.5]])
"""Linear BGR reflectances."""

_HEIGHTS, _RADII = np.array([0.025, 0.038, 0.103, 0.172]), np.array([0.199, 0.1985, 0.2375, 0.277])
"""Profile of the wall's inner surface: heights and radii [m]."""

Part = tuple[FloatArray, Array]
"""Vertices (V, 3) [m] and triangles (T, 3)."""


def cluttered(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """Return the scene with random things."""
    name, bodies = f"{rng.integers(2**62):x}", list(scene.bodies)
    for number in range(int(rng.integers(PIECES[0], PIECES[1] + 1))):
        kind = _KINDS[int(rng.integers(len(_KINDS)))]
        color, gloss = _color(rng), float(rng.uniform(0.0, 0.4))
        vertices, triangles = meshes.concatenate(kind(rng, rng.uniform(0.0, 2 * np.pi)))
        mesh = Mesh(f"clutter_{name}_{number}", vertices, triangles, np.zeros(len(triangles), int))
        nothing = np.zeros(1, dtype=np.uint8)
        bodies.append(Body(mesh.key, mesh, np.eye(4), color[None], nothing, gloss, 0.08))
    return dataclasses.replace(scene, bodies=tuple(bodies))


def _color(rng: np.random.Generator) -> FloatArray:
    of_face = bool(rng.random() < IN_FACE_COLORS)
    chosen = reflectances(_PAINTS)[int(rng.integers(1, 7))] if of_face else _OTHERS[int(rng.integers(6))]
    result: FloatArray = np.clip(chosen * rng.uniform(0.7, 1.2), 0.0, 0.95)
    return result


def _on_wall(azimuth: Array, height: Array, lift: Array | float) -> FloatArray:
    """Return points (..., 3) [m] at a distance `lift` [m] inside the wall."""
    radius = np.interp(height, _HEIGHTS, _RADII) - lift
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.asarray(height)], axis=-1)


def _sheet(points: FloatArray) -> Part:
    """Return a surface through a grid of points (R, C, 3)."""
    rows, columns = points.shape[:2]
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    halves = np.array([[0, 1, columns + 1], [0, columns + 1, columns]])
    return points.reshape(-1, 3), (corner[:, None, None] + halves).reshape(-1, 3)


def _tape(rng: np.random.Generator, azimuth: float) -> list[Part]:
    """Draw a strip of tape, 10 to 25 mm wide, on the wall."""
    half, turn = rng.uniform([0.015, 0.005], [0.06, 0.0125]), rng.uniform(0.0, np.pi)
    along, across = np.meshgrid(np.linspace(-half[0], half[0], 9), half[1] * np.array([-1.0, 1.0]))
    up = np.sin(turn) * along + np.cos(turn) * across
    side = np.cos(turn) * along - np.sin(turn) * across
    # The wall leans outwards: height is seven eighths of the distance along it.
    height = np.clip(rng.uniform(0.045, 0.15) + 0.87 * up, 0.026, 0.172)
    return [_sheet(_on_wall(azimuth + side / 0.23, height, 0.003))]


def _cloth(rng: np.random.Generator, azimuth: float) -> list[Part]:
    """Draw a sleeve or cloth that hangs over the rim, in folds."""
    width, end = rng.uniform(0.15, 0.5), rng.uniform(0.06, 0.13)
    turns = np.linspace(-width, width, 41)
    hem = end + 0.005 * np.sin(rng.uniform(2.0, 5.0) * turns / width) + 0.03 * (turns / width) ** 2
    share = np.linspace(0.0, 1.0, 7)[:, None]
    folds = 0.010 + 0.003 * np.sin(rng.uniform(6.0, 12.0) * turns / width + 2.0 * share)
    height = np.minimum(hem + share * (0.172 - hem), 0.172)
    return [_sheet(_on_wall(azimuth + np.broadcast_to(turns, height.shape), height, folds))]


def _cable(rng: np.random.Generator, azimuth: float) -> list[Part]:
    """Draw a cable, 4 to 8 mm thick, from the rim down the wall."""
    radius, share = rng.uniform(0.002, 0.004), np.linspace(0.0, 1.0, 25)
    height = 0.172 - share * (0.172 - rng.uniform(0.03, 0.12))
    wander = rng.uniform(-0.4, 0.4) * share + 0.05 * np.sin(rng.uniform(3.0, 9.0) * share)
    return [meshes.tube(_on_wall(azimuth + wander, height, radius + 0.001), radius)]


def _tool(rng: np.random.Generator, azimuth: float) -> list[Part]:
    """Draw a tool, a handle with a thin shaft, that hangs on the wall above what lies on the table."""
    thick, thin = rng.uniform([0.008, 0.002], [0.012, 0.004])
    ends = 0.165 - np.cumsum([0.0, *rng.uniform([0.03, 0.02], [0.05, 0.04])])
    tilt = rng.uniform(-0.5, 0.5)
    return [
        meshes.tube(_on_wall(azimuth + tilt * (0.165 - height), height, thick + 0.001), radius)
        for height, radius in (
            (np.linspace(ends[0], ends[1], 5), thick),
            (np.linspace(ends[1], ends[2], 5), thin),
        )
    ]


def _box(rng: np.random.Generator, azimuth: float) -> list[Part]:
    """Draw a box beyond the wall, no higher than its rim."""
    size = rng.uniform([0.04, 0.04, 0.12], [0.15, 0.15, 0.19])
    solid = meshes.box(size)
    turn = rng.uniform(0.0, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    radius = rng.uniform(0.42, 0.5)
    place = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), size[2] / 2 - 0.02])
    return [
        (solid.vertices @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + place, solid.triangles)
    ]


_KINDS: tuple[Callable[[np.random.Generator, float], list[Part]], ...] = (_tape, _cloth, _cable, _tool, _box)
