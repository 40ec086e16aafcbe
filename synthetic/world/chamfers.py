"""The effect `chamfers`: a cuboid with rounded or cut, worn edges.

The object stays within the sharp cuboid of its pose: at an edge, a rim of width w removes from the silhouette
at most w (√2 − 1) if it is rounded and w / √2 if it is cut. Each point of a rim has the label of the face
with the nearest normal, whatever colour it shows. Dice keep their sharp edges.
"""

import dataclasses
import itertools
from dataclasses import dataclass

import numpy as np

from synthetic.scene import Body, Mesh, PlatformScene
from synthetic.world import meshes
from tracker.conventions import Array, FloatArray
from tracker.geometry.cuboid import CORNER_SIGNS, EDGES, FACE_CORNERS, FACE_NORMALS, corners

WIDTH_M, SPREAD_M = 0.001, 0.0005
"""Largest width of a rim along a face, and its largest difference from the recorded object's [m]."""

CUT = 0.3
"""Share of objects whose edges are cut flat instead of rounded."""

LOST = (0.1, 0.4)
"""Range of the share of colour that is worn off a rim."""

SEAM = (0.05, 0.5)
"""Range, over objects, of the largest relative reflectance of rims that hold dirt."""

PALE = 0.7
"""Reflectance of the material below the colour."""

_HALF_ARC = 2
"""Segments from a face to the middle of a rounded edge."""

_FACES, _EDGES, _CORNERS = 6, 12, 8


@dataclass(frozen=True, eq=False)
class Rims:
    """The rims of one object."""

    width: float
    """[m]"""
    cut: bool
    """Flat at 45°; else round."""
    pale: FloatArray
    """(24,) share of colour worn off each rim, two rims per edge."""
    dirt: FloatArray
    """(24,) factor on the reflectance of each rim."""
    coat: FloatArray
    """(2,) clear coat, as a row of `Body.coats`."""


def random_rims(rng: np.random.Generator, usual: float) -> Rims:
    """Draw rims, most likely of a `usual` width [m]; a random share of them is pale, the others dirty."""
    usual = min(usual, WIDTH_M)
    worn = np.repeat(rng.random(_EDGES) < rng.random(), 2)
    return Rims(
        width=float(rng.triangular(max(usual - SPREAD_M, 0.0), usual, min(usual + SPREAD_M, WIDTH_M))),
        cut=bool(rng.random() < CUT),
        pale=rng.uniform(*LOST, 2 * _EDGES) * worn,
        dirt=np.where(worn, 1.0, rng.uniform(0.0, rng.uniform(*SEAM), 2 * _EDGES)),
        coat=rng.uniform([0.3, 0.1], [1.0, 0.4]),
    )


def chamfered(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """Return the scene with random rims around its cuboid."""
    rims = random_rims(rng, 0.0 if scene.cuboid is None else scene.cuboid.rim)
    return scene.with_cuboid(lambda body: with_rims(body, rims))


def with_rims(body: Body, rims: Rims) -> Body:
    """Return a body with rims, from one whose mesh is a sharp box of six groups."""
    mesh = rimmed_box(body.size, rims.width, cut=rims.cut)
    faces, halves = group_faces(), group_halves()
    colors, coats = body.colors[faces], np.asarray(body.coats)[faces]
    on_rim = halves >= 0
    pale, dirt = rims.pale[halves[on_rim]][:, None], rims.dirt[halves[on_rim]][:, None]
    colors[on_rim] = ((1 - pale) * colors[on_rim] + pale * PALE) * dirt
    coats[on_rim] = rims.coat
    return dataclasses.replace(
        body, mesh=mesh, colors=colors, labels=np.asarray(body.labels)[faces], coats=coats
    )


def group_faces() -> Array:
    """(54,) the face of each group: faces, halves of edges, thirds of corners."""
    corner_faces = [_faces_of_corner(corner) for corner in range(_CORNERS)]
    return np.concatenate([np.arange(_FACES), EDGES[:, 2:].ravel(), np.concatenate(corner_faces)])


def group_halves() -> Array:
    """(54,) the half edge whose look each group has; -1: a face. A corner's third takes an adjacent half."""
    of_corner = [
        int(np.flatnonzero((EDGES[:, :2] == corner).any(axis=1)[:, None] & (EDGES[:, 2:] == face)).item(0))
        for corner in range(_CORNERS)
        for face in _faces_of_corner(corner)
    ]
    return np.concatenate([np.full(_FACES, -1), np.arange(2 * _EDGES), of_corner])


def rimmed_box(size: Array, width: float, *, cut: bool) -> Mesh:
    """Return a cuboid of edge lengths `size` (3,) [m] about the origin with rims of `width` [m].

    Its groups are the six faces, then the two halves of each edge in the order of EDGES, then the thirds of
    the corners, each in the order of FACE_NAMES.
    """
    inset = corners(np.asarray(size) - 2 * width)
    polygons: list[FloatArray] = []
    groups: list[int] = []

    def add(polygon: FloatArray, outwards: FloatArray, group: int) -> None:
        """Add a polygon (N, 3), star-shaped about its first point, in either orientation."""
        if np.cross(polygon[1] - polygon[0], polygon[2] - polygon[0]) @ outwards < 0:
            polygon = np.roll(polygon[::-1], 1, axis=0)
        polygons.append(polygon)
        groups.extend([group] * (len(polygon) - 2))

    for face, loop in enumerate(FACE_CORNERS):
        add(inset[loop] + width * FACE_NORMALS[face], FACE_NORMALS[face], face)
    for edge, (a, b, first, second) in enumerate(EDGES):
        for side, (near, far) in enumerate(((first, second), (second, first))):
            arc = width * _half_arc(FACE_NORMALS[near], FACE_NORMALS[far], cut=cut)
            for low, high in itertools.pairwise(arc):
                quad = np.stack([inset[a] + low, inset[b] + low, inset[b] + high, inset[a] + high])
                add(quad, low + high, _FACES + 2 * edge + side)
    for corner in range(_CORNERS):
        normals = FACE_NORMALS[_faces_of_corner(corner)]
        tip = CORNER_SIGNS[corner] / (3.0 if cut else np.sqrt(3.0))
        for k in range(3):
            here, next_, last = normals[k], normals[(k + 1) % 3], normals[(k + 2) % 3]
            ways = [_half_arc(here, other, cut=cut) for other in (next_, last)]
            rim = np.concatenate([tip[None], ways[1][::-1], ways[0][1:]])
            group = _FACES + 2 * _EDGES + 3 * corner + k
            add(inset[corner] + width * rim, CORNER_SIGNS[corner], group)
    key = f"rims_{'_'.join(f'{edge:.6f}' for edge in size)}_{width:.7f}_{'cut' if cut else 'round'}"
    parts = [(polygon, meshes.fan(len(polygon))) for polygon in polygons]
    return Mesh(key, *meshes.concatenate(parts), np.array(groups))


def _faces_of_corner(corner: int) -> list[int]:
    return [2 * axis + (0 if CORNER_SIGNS[corner, axis] > 0 else 1) for axis in range(3)]


def _half_arc(near: FloatArray, far: FloatArray, *, cut: bool) -> FloatArray:
    """Return points (N, 3) from `near` to halfway between both normals, on the unit circle or its chord."""
    if cut:
        return np.stack([near, (near + far) / 2])
    angle = np.linspace(0.0, np.pi / 4, _HALF_ARC + 1)[:, None]
    return np.cos(angle) * near + np.sin(angle) * far
