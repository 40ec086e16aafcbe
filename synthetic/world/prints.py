"""The effect `surface`: faces with dirt, individual gloss, and prints with rounded corners."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from synthetic.scene import Body, Mesh, PlatformScene
from synthetic.world import meshes
from tracker.conventions import Array, FloatArray
from tracker.geometry.cuboid import FACE_NORMALS

MARGIN_M, CORNER_M = 0.0006, (0.0005, 0.0030)
"""Largest margin between a print and its face's edges, and smallest and largest corner radius [m]."""

_FACES = 6

_ARC = 3
"""Segments of a rounded corner."""


@dataclass(frozen=True, eq=False)
class Prints:
    """The coloured prints on the faces of one object."""

    margin: float
    """Width of the unprinted border of a face [m]."""
    corner: float
    """Radius of the print's corners [m]."""
    faded: float
    """Reflectance of the border relative to the print's."""
    pale: float
    """Added reflectance of the border in all colours: ink that thins out over white."""
    coats: FloatArray
    """(6, 2) clear coats, as rows of `Body.coats`."""
    dirt: float
    """Factor on the standard deviation of the reflectance over a face."""


def random_prints(rng: np.random.Generator) -> Prints:
    """Draw prints."""
    shared = rng.uniform([0.0, 0.05], [1.0, 0.4])
    return Prints(
        margin=float(rng.uniform(0.0, MARGIN_M)),
        corner=float(rng.uniform(*CORNER_M)),
        faded=float(rng.uniform(0.3, 1.1)),
        pale=float(rng.uniform(0.0, 0.08)),
        coats=np.clip(shared * rng.uniform(0.6, 1.4, (_FACES, 2)), 0.0, 1.0),
        dirt=float(rng.uniform(0.7, 1.5)),
    )


def printed(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """Return the scene with random prints on its cuboid's faces; dice stay as they are."""
    prints = random_prints(rng)
    return scene.with_cuboid(lambda body: with_prints(body, prints))


def with_prints(body: Body, prints: Prints) -> Body:
    """Return a body with prints on its groups 0 to 5, which are flat rectangles.

    The borders have their own groups, after all others, and the labels of their faces.
    """
    coats = np.concatenate([np.asarray(body.coats), prints.coats])
    coats[:_FACES] = prints.coats
    borders = np.clip(prints.faded * body.colors[:_FACES] + prints.pale, 0.0, 1.0)
    return dataclasses.replace(
        body,
        mesh=printed_mesh(body.mesh, len(body.colors), prints.margin, prints.corner),
        colors=np.concatenate([body.colors, borders]),
        labels=np.concatenate([np.asarray(body.labels), np.asarray(body.labels)[:_FACES]]),
        coats=coats,
        texture=body.texture * prints.dirt,
    )


def printed_mesh(mesh: Mesh, first: int, margin: float, corner: float) -> Mesh:
    """Return a cuboid's mesh with its groups 0 to 5, rectangles along the axes, cut into print and border.

    `first` is the group of the first face's border; those of the others follow. `margin` is the width of the
    borders and `corner` the radius of the prints' corners [m].
    """
    groups, triangles = np.asarray(mesh.groups), np.asarray(mesh.triangles)
    kept = groups >= _FACES
    parts, owners = [(mesh.vertices, triangles[kept])], [groups[kept]]
    for face, normal in enumerate(FACE_NORMALS):
        places = mesh.vertices[triangles[groups == face].ravel()]
        axis = face // 2
        across, along = (axis + 1) % 3, (axis + 2) % 3
        half = np.abs(places[:, [across, along]]).max(axis=0)
        flat, pieces, is_border = _rectangle_with_print(half, margin, corner)
        vertices = np.zeros((len(flat), 3))
        vertices[:, [across, along]] = flat
        vertices[:, axis] = places[0, axis]
        parts.append((vertices, pieces if normal[axis] > 0 else pieces[:, ::-1]))
        owners.append(np.where(is_border, first + face, face))
    key = f"{mesh.key}_print_{margin:.7f}_{corner:.7f}"
    return Mesh(key, *meshes.concatenate(parts), np.concatenate(owners))


def _rectangle_with_print(half: FloatArray, margin: float, corner: float) -> tuple[FloatArray, Array, Array]:
    """Return points (N, 2), counter-clockwise triangles, and which are border, of a face within ±half."""
    outline = _rounded_outline(half - margin, min(corner, float(half.min()) - margin))
    count = len(outline)
    inside = meshes.fan(count)
    around = []
    for k in range(count):
        quarter, following = k // (_ARC + 1), (k + 1) % count // (_ARC + 1)
        here = count + quarter
        around.append([here, (k + 1) % count, k])
        if following != quarter:
            around.append([here, count + following, (k + 1) % count])
    ends = half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    triangles = np.concatenate([inside, np.array(around)])
    return np.concatenate([outline, ends]), triangles, np.arange(len(triangles)) >= len(inside)


def _rounded_outline(half: FloatArray, radius: float) -> FloatArray:
    """Return points (N, 2), counter-clockwise, of a rectangle within ±half (2,) with rounded corners."""
    arc = np.linspace(0.0, np.pi / 2, _ARC + 1)
    points = []
    for quarter, signs in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = arc + quarter * np.pi / 2
        points.append(np.array(signs) * (half - radius) + radius * meshes.circle(angle))
    return np.concatenate(points)
