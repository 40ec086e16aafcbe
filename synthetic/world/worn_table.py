"""The effect `table`: a semi-gloss table with scratches, dust, and paint in the colours of faces."""

import dataclasses

import numpy as np

from synthetic.look.face_colors import reflectances
from synthetic.scene import Body, Mesh, PlatformScene
from synthetic.world.meshes import QUAD, circle, concatenate
from synthetic.world.platform import ARENA_RADIUS
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3

COAT, BLUR = (0.3, 1.0), (0.15, 0.5)
"""Ranges of the amount of the table's clear coat, and of the blur of what it mirrors [rad]."""

SCRATCHES, SPECKS = 25, 150
"""Largest numbers of scratches and specks on one table."""

PAINTED = 0.5
"""Share of tables with one to three painted crosses or rings."""

_MIRRORED, _LEAST = 0.03, 0.3
"""Light that a full coat mirrors from the ceiling to the cameras, relative to the light on the table; the
colour below is reduced by it, since measured colours include both. Smallest share of colour that stays."""

_DUST_HEIGHT, _PAINT_HEIGHT = 1.5e-4, 8e-5
_PAINT_OF = "cube_v2"
"""Object with the colours of the paint."""


def worn(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """Return the scene with a random worn table."""
    name = f"{rng.integers(2**62):x}"
    coat = rng.uniform([COAT[0], BLUR[0]], [COAT[1], BLUR[1]])[None]
    bodies = []
    for body in scene.bodies:
        if body.name == "table":
            below = np.maximum(body.colors - _MIRRORED * coat[0, 0], _LEAST * body.colors)
            coated = dataclasses.replace(body, colors=below, coats=coat)
            bodies += [coated, _dust(rng, body, name), *_paint(rng, name)]
        else:
            bodies.append(body)
    return dataclasses.replace(scene, bodies=tuple(bodies))


def _dust(rng: np.random.Generator, table: Body, name: str) -> Body:
    """Draw scratches, darker or paler than the table, and specks, which are paler."""
    scratches, specks = int(rng.integers(SCRATCHES + 1)), int(rng.integers(SPECKS + 1))
    count = scratches + specks
    length = np.concatenate([rng.uniform(0.004, 0.06, scratches), rng.uniform(0.0003, 0.002, specks)])
    width = np.concatenate([rng.uniform(0.0002, 0.001, scratches), length[scratches:]])
    places, turns = _places(rng, count), rng.uniform(0.0, np.pi, count)
    bars = [_bar(*row) for row in zip(places, length, width, turns, strict=True)]
    vertices, triangles = concatenate(bars) if bars else (np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    shades = table.colors[0] * rng.uniform([[0.4], [1.2]], [[2.0], [4.0]])
    groups = np.repeat((np.arange(count) >= scratches).astype(np.int64), 2)
    return _flat(f"dust_{name}", vertices, triangles, groups, shades, _DUST_HEIGHT)


def _paint(rng: np.random.Generator, name: str) -> list[Body]:
    """Draw crosses and rings."""
    count = int(rng.integers(1, 4)) * bool(rng.random() < PAINTED)
    result = []
    for number in range(count):
        color = reflectances(_PAINT_OF)[int(rng.integers(1, 7))] * rng.uniform(0.7, 1.2)
        ring, place, turn = bool(rng.random() < 0.5), 0.85 * _places(rng, 1)[0], rng.uniform(0.0, np.pi)
        width = rng.uniform(0.002, 0.009)
        if ring:
            vertices, triangles = _ring(place, rng.uniform(0.01, 0.04), width)
        else:
            length = rng.uniform(0.02, 0.07)
            # Split the second bar in two, since coinciding tops would flicker.
            side = (length + width) / 4
            step = side * np.array([-np.sin(turn), np.cos(turn)])
            halves = [
                _bar(place + way, (length - width) / 2, width, turn + np.pi / 2) for way in (step, -step)
            ]
            vertices, triangles = concatenate([_bar(place, length, width, turn), *halves])
        groups = np.zeros(len(triangles), dtype=np.int64)
        # Each is slightly lower than the one before, in case they cross.
        height = _PAINT_HEIGHT - 1e-5 * number
        result.append(_flat(f"paint_{name}_{number}", vertices, triangles, groups, color[None], height))
    return result


def _places(rng: np.random.Generator, count: int) -> FloatArray:
    """Draw positions (N, 2) [m], spread evenly over the table."""
    radius, azimuth = ARENA_RADIUS * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth)], axis=1)


def _bar(place: FloatArray, length: float, width: float, turn: float) -> tuple[FloatArray, Array]:
    along = length / 2 * np.array([np.cos(turn), np.sin(turn)])
    across = width / 2 * np.array([-np.sin(turn), np.cos(turn)])
    flat = place + np.stack([-along - across, along - across, along + across, -along + across])
    return np.column_stack([flat, np.zeros(4)]), QUAD


def _ring(place: FloatArray, radius: float, width: float, segments: int = 48) -> tuple[FloatArray, Array]:
    rim = circle(2 * np.pi * np.arange(segments) / segments)
    flat = np.concatenate([place + (radius - width / 2) * rim, place + (radius + width / 2) * rim])
    k = np.arange(segments)
    following = (k + 1) % segments
    first = np.stack([k, segments + k, segments + following], axis=1)
    second = np.stack([k, segments + following, following], axis=1)
    return np.column_stack([flat, np.zeros(len(flat))]), np.concatenate([first, second])


def _flat(
    name: str, vertices: FloatArray, triangles: Array, groups: Array, colors: FloatArray, height: float
) -> Body:
    mesh, pose = Mesh(name, vertices, triangles, groups), so3.transform(np.eye(3), [0.0, 0.0, height])
    return Body(name, mesh, pose, np.clip(colors, 0.0, 1.0), np.zeros(len(colors), dtype=np.uint8))
