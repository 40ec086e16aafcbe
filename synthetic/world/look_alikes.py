"""Look-alikes: other things in the object's place, which a tracker should not report.

Each kind is a function from the true object's body, whose groups are the six faces, to the bodies in its
place. Their labels are the visible colours. Only `size` and `stretched` have the true arrangement of faces.
"""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from synthetic.look.face_colors import reflectances
from synthetic.scene import Body, Mesh, PlatformScene, direction
from synthetic.world import meshes
from synthetic.world.placement import face_up
from tracker.conventions import Array, FloatArray
from tracker.errors import TrackerError
from tracker.geometry import so3
from tracker.geometry.cuboid import FACE_CORNERS, FACE_NORMALS, corners
from tracker.objects.model import load_object

SMALLER, LARGER = (0.7, 0.9), (1.1, 1.3)
"""Ranges of the scale of copies that differ in size only."""

SHORTER, LONGER = (0.6, 0.8), (1.25, 1.5)
"""Ranges of the factor on one of its edges."""

_ROUND = 24
"""Sides of a prism that approximates a cylinder."""

_PLATE_M = 0.003
"""Thickness of loose plates."""

_PAPER = 0.75
"""Reflectance of the paper of a photo."""


def _paints(own: Body, labels: Array) -> FloatArray:
    """Return the reflectances (N, 3) of a body's colours for labels (N,)."""
    place = {int(label): row for row, label in enumerate(own.labels)}
    return np.stack([own.colors[place[int(label)]] for label in labels])


def _as_body(own: Body, mesh: Mesh, labels: Array, colors: Array | None = None, **more: object) -> Body:
    """Return a body with the object's material and pose; `colors` defaults to those of the labels."""
    colors = _paints(own, labels) if colors is None else colors
    changes = {"mesh": mesh, "labels": np.asarray(labels, np.uint8), "colors": colors, "coats": None}
    return dataclasses.replace(own, **changes, **{"faces": False, **more})  # type: ignore[arg-type]


def _repainted(own: Body, labels: Array, colors: Array | None = None) -> list[Body]:
    """Return the object with other colours on its faces."""
    return [_as_body(own, own.mesh, labels, colors, faces=True)]


def _scaled(own: Body, factors: Array | float) -> list[Body]:
    """Return the object with its edges scaled by `factors` (3,), or all by the same one."""
    return [_on_table(own, _as_body(own, meshes.box(factors * own.size), own.labels, faces=True))]


def _on_table(own: Body, body: Body) -> Body:
    """Return a body moved vertically so that its lowest point is as high as the object's."""
    height = np.min(body.points[:, 2]) - np.min(own.points[:, 2])
    pose = np.array(body.world_from_body)
    pose[2, 3] -= height
    return dataclasses.replace(body, world_from_body=pose)


def look_alike(scene: PlatformScene, kind: str, rng: np.random.Generator) -> PlatformScene:
    """Replace the scene's cuboid, if there is one, by a random look-alike of this kind.

    Raises:
        TrackerError: the object has fewer than six colours.
    """
    body = scene.cuboid
    if body is None:
        return scene
    if len(set(body.labels.tolist())) < 6:
        raise TrackerError(f"look_alike: found {body.name} of fewer than six colours")
    others = tuple(other for other in scene.bodies if other is not body)
    about = {**scene.about, "look_alike": kind}
    bodies = (*others, *KINDS_OF[kind](body, rng))
    return dataclasses.replace(scene, bodies=bodies, objects=(), about=about)


def turned_arrangements(labels: Array) -> set[tuple[int, ...]]:
    """Return all arrangements of faces that are rotations of `labels` (6,)."""
    turns = Rotation.create_group("O").as_matrix()
    places = np.argmax(FACE_NORMALS @ turns @ FACE_NORMALS.T, axis=-1)
    return {tuple(map(int, labels[row])) for row in places}


def _permuted_labels(labels: Array, rng: np.random.Generator, avoid: Array | None = None) -> Array:
    """Draw an order of the labels that no rotation makes true, nor equals `avoid` (6,) on any face."""
    true = turned_arrangements(labels)
    while True:
        chosen = rng.permutation(labels)
        if tuple(map(int, chosen)) not in true and (avoid is None or (chosen != avoid).all()):
            return chosen


def _permuted(own: Body, rng: np.random.Generator) -> list[Body]:
    return _repainted(own, _permuted_labels(own.labels, rng))


def _mirrored(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return the object's mirror image: two opposite faces are exchanged."""
    labels, axis = own.labels.copy(), int(rng.integers(3))
    labels[[2 * axis, 2 * axis + 1]] = labels[[2 * axis + 1, 2 * axis]]
    return _repainted(own, labels)


def _pairs(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return the object with opposite faces in the same colour, that of either."""
    return _repainted(own, np.repeat(own.labels[2 * np.arange(3) + rng.integers(2, size=3)], 2))


def _size(own: Body, rng: np.random.Generator) -> list[Body]:
    return _scaled(own, rng.uniform(*(SMALLER if rng.random() < 0.5 else LARGER)))


def _stretched(own: Body, rng: np.random.Generator) -> list[Body]:
    factors = np.ones(3)
    factors[rng.integers(3)] = rng.uniform(*(SHORTER if rng.random() < 0.5 else LONGER))
    return _scaled(own, factors)


def _plain(own: Body, rng: np.random.Generator) -> list[Body]:
    return _repainted(own, np.full(6, rng.choice(own.labels)))


def _other_object(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return the object with the faces and paints of cube_v2, or of cube_v1 if it has those of cube_v2."""
    true = turned_arrangements(own.labels)
    models = [load_object(name) for name in ("cube_v2", "cube_v1")]
    other = next(model for model in models if tuple(map(int, model.face_labels)) not in true)
    return _repainted(own, other.face_labels, reflectances(other.colors)[other.face_labels])


def _layers(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return two or three slabs across the longest edge, with no face in its true colour."""
    count, axis = int(rng.integers(2, 4)), int(np.argmax(own.size))
    ends = np.concatenate([[0.0], np.cumsum(rng.uniform(0.7, 1.3, count))])
    ends = (ends / ends[-1] - 0.5) * own.size[axis]
    avoid = own.labels
    parts: list[tuple[FloatArray, Array]] = []
    labels: list[Array] = []
    for low, high in itertools.pairwise(ends):
        slab = own.size.copy()
        slab[axis] = high - low
        solid = meshes.box(slab)
        parts.append((solid.vertices + (low + high) / 2 * np.eye(3)[axis], solid.triangles))
        before = labels[-1] if labels else avoid
        while True:
            chosen = _permuted_labels(own.labels, rng, avoid)
            if (chosen != before).all():
                break
        labels.append(chosen)
    groups = np.concatenate([6 * k + np.repeat(np.arange(6), 2) for k in range(count)])
    mesh = Mesh(f"layers_{ends.tobytes().hex()}", *meshes.concatenate(parts), groups)
    return [_as_body(own, mesh, np.concatenate(labels))]


def _prism(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return a prism of three or six sides, each in one colour."""
    sides = int(rng.choice([3, 6]))
    return [_upright(own, sides, sides, rng)]


def _round(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return a cylinder with three to six bands of colour from end to end."""
    return [_upright(own, _ROUND, int(rng.integers(3, 7)), rng)]


def _upright(own: Body, sides: int, bands: int, rng: np.random.Generator) -> Body:
    """Return a prism along the longest edge, as thick as the object is wide, with sides in `bands` bands."""
    axis = int(np.argmax(own.size))
    width = np.delete(own.size, axis).mean()
    # The same cross-section area as the square that it replaces.
    radius = width * np.sqrt(2 / (sides * np.sin(2 * np.pi / sides)))
    rim, half = radius * meshes.circle(2 * np.pi * np.arange(sides) / sides), own.size[axis] / 2
    parts, groups = [], []
    for k in range(sides):
        a, b = rim[k], rim[(k + 1) % sides]
        quad = [(*a, -half), (*b, -half), (*b, half), (*a, half)]
        parts.append((np.array(quad), meshes.QUAD))
        groups += 2 * [k * bands // sides]
    fan = meshes.fan(sides)
    for end, (height, triangles) in enumerate(((-half, fan[:, ::-1]), (half, fan))):
        parts.append((np.insert(rim, 2, height, axis=1), triangles))
        groups += [bands + end] * len(fan)
    vertices, triangles = meshes.concatenate(parts)
    labels = np.concatenate([rng.permutation(own.labels), rng.permutation(own.labels)])[: bands + 2]
    # Rotate the axes so that z becomes the longest edge.
    key = f"prism_{sides}_{bands}_{own.mesh.key}"
    mesh = Mesh(key, np.roll(vertices, axis - 2, 1), triangles, np.array(groups))
    return _on_table(own, _as_body(own, mesh, labels))


def _plates(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return one to three loose plates on the table, lying or standing, with two of the object's edges."""
    count, bodies = int(rng.integers(1, 4)), []
    middle = own.world_from_body[:2, 3]
    labels = rng.choice(own.labels, count, replace=False)
    for number, label in enumerate(labels):
        size = np.array([*rng.choice(own.size, 2), _PLATE_M])
        turn = so3.exp([0.0, 0.0, rng.uniform(0.0, 2 * np.pi)])
        stands = bool(rng.random() < 0.4)
        away, azimuth = rng.uniform(0.2, 0.6) * own.size.max() * (count > 1), 2 * np.pi * number / count
        place = middle + away * direction(azimuth)[:2]
        # Each is slightly thicker than the one before, so that tops of overlapping plates do not coincide.
        size[2] += 2e-4 * number
        facing = turn @ so3.exp([np.pi / 2, 0.0, 0.0]) if stands else turn
        pose = so3.transform(facing, [*place, size[1 if stands else 2] / 2])
        mesh = meshes.box(size, one_group=True)
        plate = _as_body(own, mesh, np.array([label]), world_from_body=pose, name=f"plate_{number}")
        bodies.append(plate)
    return bodies


def _photo(own: Body, rng: np.random.Generator) -> list[Body]:
    """Return a photo of the object from above, cut out or on white paper, that lies or leans on the table.

    The object in the photo rests on any face, whatever the object does: a film shows one photo.
    """
    elevation, azimuth = rng.uniform([np.radians(25), 0.0], [np.radians(65), 2 * np.pi])
    towards = direction(azimuth, elevation)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    axes = np.stack([right, np.cross(towards, right), towards])
    turned = face_up(int(rng.integers(6)))
    points = corners(own.size) @ turned.T @ axes.T
    flat = points[:, :2] / (1 - points[:, 2:] / 0.5)
    normals = FACE_NORMALS @ turned.T
    seen = [k for k in range(6) if (0.5 * axes[2] - normals[k] * own.size[k // 2] / 2) @ normals[k] > 0]
    flat -= (flat.min(axis=0) + flat.max(axis=0)) / 2
    labels = [*own.labels[seen]]
    parts = [(np.insert(flat[FACE_CORNERS[k]], 2, 2e-4, axis=1), meshes.QUAD) for k in seen]
    if rng.random() < 0.5:
        half = np.abs(flat).max(axis=0) + rng.uniform(0.004, 0.015, 2)
        sheet = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * np.array([*half, 0.0])
        parts.append((sheet, meshes.QUAD))
        labels.append(0)
    vertices, triangles = meshes.concatenate(parts)
    mesh = Mesh(
        f"photo_{vertices.tobytes().hex()}", vertices, triangles, np.repeat(np.arange(len(labels)), 2)
    )
    colors = np.stack(
        [np.full(3, _PAPER) if label == 0 else _paints(own, np.array([label]))[0] for label in labels]
    )
    lean = 0.0 if rng.random() < 0.4 else rng.uniform(0.3, 1.2)
    pose = np.array(own.world_from_body)
    pose[:3, :3] = so3.exp([0.0, 0.0, rng.uniform(0.0, 2 * np.pi)]) @ so3.exp([lean, 0.0, 0.0])
    photo = _as_body(own, mesh, np.array(labels), colors, world_from_body=pose, texture=0.0)
    pose[2, 3] -= np.min(photo.points[:, 2]) - 0.0005
    return [dataclasses.replace(photo, world_from_body=pose)]


KINDS_OF: dict[str, Callable[[Body, np.random.Generator], list[Body]]] = {
    "permuted": _permuted,
    "size": _size,
    "plain": _plain,
    "plates": _plates,
    "layers": _layers,
    "prism": _prism,
    "photo": _photo,
    "other_object": _other_object,
    "mirrored": _mirrored,
    "pairs": _pairs,
    "stretched": _stretched,
    "round": _round,
}

KINDS = tuple(KINDS_OF)
"""permuted: the faces in another order. size: another size. plain: one colour. plates: loose coloured plates.
layers: bands of wrong colours. prism: three or six coloured sides. photo: a flat photo of the object.
other_object: the faces of another object. mirrored: two opposite faces exchanged. pairs: opposite faces
alike. stretched: one edge longer or shorter. round: a cylinder in bands of colour."""
