"""A scene: bodies with meshes and materials at exact poses, and the light on them.

The simulated platform passes it to the renderers. Positions are in the world's frame [m]; colours are linear
blue-green-red reflectances from 0 to 1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.objects.model import CuboidModel, load_object

DRAWN_STD = 1e-4
"""Standard deviation of the rim width of an object that is drawn with sharp edges [m]."""


def drawn(name: str) -> CuboidModel:
    """Return one of the package's objects as drawn without wear: its colours end at its edges."""
    return dataclasses.replace(load_object(name), rim=0.0, rim_std=DRAWN_STD)


def direction(azimuth: float, elevation: float = 0.0) -> FloatArray:
    """Return the unit vector (3,) at an azimuth from x about z, and an elevation above the horizon [rad]."""
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _frozen(array: Any) -> FloatArray:
    result = np.array(array, dtype=np.float64)
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with one colour group each; several bodies may share a mesh."""

    key: str
    """Unique name, by which renderers cache the mesh."""
    vertices: FloatArray
    """(V, 3) [m] in the body's frame."""
    triangles: Array
    """(T, 3) indices of vertices, counter-clockwise seen from outside."""
    groups: Array
    """(T,) index into the colours and labels of the body that uses the mesh."""

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        # Compiled code would read wrong rows, even past the end, so equal keys are not trusted.
        return (
            isinstance(other, Mesh)
            and self.key == other.key
            and np.array_equal(self.vertices, other.vertices)
            and np.array_equal(self.triangles, other.triangles)
            and np.array_equal(self.groups, other.groups)
        )


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in view."""

    name: str
    mesh: Mesh
    world_from_body: FloatArray
    """(4, 4)."""
    colors: FloatArray
    """(G, 3) linear BGR reflectance of each colour group."""
    labels: Array
    """(G,) uint8: 0 for non-objects; 1 red … 6 yellow for a cuboid's faces; 1 … 25 for dice."""
    gloss: float = 0.0
    """Strength of highlights, 0 to 1."""
    texture: float = 0.0
    """Relative standard deviation of the reflectance over the surface (grain, dirt)."""
    faces: bool = False
    """Whether groups 0 to 5 are a cuboid's faces along the body's axes, in the order of FACE_NAMES."""
    rim: float = 0.0
    """Approximate distance from its edges at which a worn cuboid's colours end [m]."""
    coats: FloatArray | None = None
    """(G, 2) clear coat of each colour group: its amount, 0 to 1, and the blur of what it mirrors [rad];
    None: no coat."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "world_from_body", _frozen(self.world_from_body))
        object.__setattr__(self, "colors", _frozen(self.colors))
        coats = np.zeros((len(self.colors), 2)) if self.coats is None else self.coats
        object.__setattr__(self, "coats", _frozen(coats))

    @property
    def points(self) -> FloatArray:
        """(V, 3) the mesh's vertices in the world [m]."""
        pose = self.world_from_body
        return np.asarray(self.mesh.vertices) @ pose[:3, :3].T + pose[:3, 3]

    @property
    def size(self) -> FloatArray:
        """(3,) edge lengths of a cuboid about the origin [m]."""
        result: FloatArray = 2 * np.abs(self.mesh.vertices).max(axis=0)
        return result


@dataclass(frozen=True, eq=False)
class Lamp:
    """A distant lamp."""

    direction: FloatArray
    """(3,) unit vector from the scene to the lamp."""
    color: FloatArray
    """(3,) linear BGR irradiance on a surface that faces it."""
    shadows: bool = True


@dataclass(frozen=True, eq=False)
class Lighting:
    """All light: lamps and an isotropic ambient part."""

    ambient: FloatArray
    """(3,) linear BGR."""
    lamps: tuple[Lamp, ...] = ()
    sky: int = 12
    """Number of directions of the ambient light that are tested for shade; few give blotchy shade."""


class Patches(NamedTuple):
    """Small patches of surfaces that light what is near them."""

    places: FloatArray
    """(N, 3) [m] in the world."""
    normals: FloatArray
    """(N, 3) unit vectors in the world; zeros: a round thing, which faces everything."""
    areas: FloatArray
    """(N,) [m²]."""
    light: FloatArray
    """(N, 3) BGR light that they emit, as reflectance × irradiance."""
    owners: Array
    """(N,) names of the bodies to which they belong; the kernels take their numbers."""

    def chosen(self, which: Array) -> Patches:
        """Return the patches where `which` (N,) is true."""
        return Patches(*(column[which] for column in self))

    @staticmethod
    def joined(parts: Sequence[Patches]) -> Patches:
        """Concatenate several sets of patches."""
        return Patches(*map(np.concatenate, zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class ObjectState:
    """The exact pose of one object."""

    name: str
    position: FloatArray
    """(3,) [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""


@dataclass(frozen=True, eq=False)
class PlatformScene:
    """Everything visible to a camera, and the ground truth."""

    bodies: tuple[Body, ...]
    lighting: Lighting
    objects: tuple[ObjectState, ...] = ()
    """The cube or cuboid alone, or all dice; empty: no object."""
    robot_position: FloatArray = field(default_factory=lambda: np.zeros(9))
    """(9,) joint angles [rad]."""
    about: dict[str, Any] = field(default_factory=dict)
    """Description of the scene for the ground truth file (JSON values only)."""
    patches: Patches | None = None
    """Patches that light their neighbours; None: no such light."""
    contact: tuple[float, float] = (0.0, 0.0)
    """Share of the sky's light that a cuboid and the table hide from each other where it stands, 0 to 1, and
    the reach of this shade [m]: see `synthetic.render.shadows`."""

    @property
    def cuboid(self) -> Body | None:
        """The body with faces; None: there is no object, or it is dice."""
        return next((body for body in self.bodies if body.faces), None)

    def with_cuboid(self, change: Callable[[Body], Body]) -> PlatformScene:
        """Return the scene with a changed cuboid, if there is one."""
        bodies = tuple(change(body) if body.faces else body for body in self.bodies)
        return dataclasses.replace(self, bodies=bodies)

    def emptied(self) -> PlatformScene:
        """Return the scene without its objects and look-alikes."""
        gone = {body.name for body in self.bodies if np.any(body.labels)}
        bodies = tuple(body for body in self.bodies if body.name not in gone)
        patches = self.patches
        if patches is not None:
            patches = patches.chosen(~np.isin(patches.owners, list(gone)))
            patches = patches if len(patches.owners) else None
        return dataclasses.replace(self, bodies=bodies, objects=(), patches=patches)


SceneAt = Callable[[float], PlatformScene]
"""The scene at a time [s]."""
