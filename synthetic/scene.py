"""What is to be seen: bodies with meshes and materials at exact places, and the light on them.

This is what the simulated platform hands to the renderers. Positions are in the world's frame [m],
colours are linear blue-green-red reflectances from 0 to 1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tracker.conventions import Array, FloatArray
from tracker.objects.model import CuboidModel, load_object

DRAWN_STD = 1e-4
"""Standard deviation of the rim of an object that is drawn with sharp edges [m]."""


def drawn(name: str) -> CuboidModel:
    """One of the package's objects as it is drawn, if not worn: its colours end at its edges."""
    return dataclasses.replace(load_object(name), rim=0.0, rim_std=DRAWN_STD)


def direction(azimuth: float, elevation: float = 0.0) -> FloatArray:
    """Unit vector (3,) at an angle around z from x, and at one above the horizon [rad]."""
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def transform(rotation: Array, position: npt.ArrayLike) -> FloatArray:
    """The transform (4, 4) of a rotation (3, 3) and a position (3,) [m]."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation, position
    return result


def _frozen(array: Any) -> FloatArray:
    result = np.array(array, dtype=np.float64)
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one colour group each; several bodies may share a mesh."""

    key: str
    """Unique name; renderers keep what they have uploaded under it."""
    vertices: FloatArray
    """(V, 3) [m] in the body's frame."""
    triangles: Array
    """(T, 3) indices of vertices, counter-clockwise seen from outside."""
    groups: Array
    """(T,) index into the colours and labels of the body that uses the mesh."""


@dataclass(frozen=True, eq=False)
class Body:
    """One rigid thing in view."""

    name: str
    mesh: Mesh
    world_from_body: FloatArray
    """(4, 4)."""
    colors: FloatArray
    """(G, 3) linear BGR reflectance of each colour group."""
    labels: Array
    """(G,) uint8: 0 for what is no object; 1 red … 6 yellow of a cuboid's faces; 1 … 25 of dice."""
    gloss: float = 0.0
    """Strength of highlights, 0 to 1."""
    texture: float = 0.0
    """Relative standard deviation of the reflectance over the surface (grain, dirt)."""
    faces: bool = False
    """Groups 0 to 5 are the faces of a cuboid along the body's axes, in the order of FACE_NAMES."""
    rim: float = 0.0
    """How far within its edges the colours of such a cuboid end where it is worn, about [m]."""
    coats: FloatArray | None = None
    """(G, 2) clear coat of each colour group: how much of it there is, 0 to 1, and by how much it blurs what
    it mirrors [rad]; None: there is none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "world_from_body", _frozen(self.world_from_body))
        object.__setattr__(self, "colors", _frozen(self.colors))
        coats = np.zeros((len(self.colors), 2)) if self.coats is None else self.coats
        object.__setattr__(self, "coats", _frozen(coats))

    @property
    def size(self) -> FloatArray:
        """(3,) edge lengths of a cuboid about the origin [m]."""
        result: FloatArray = 2 * np.abs(self.mesh.vertices).max(axis=0)
        return result


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp that is far away."""

    direction: FloatArray
    """(3,) unit vector from the scene to the lamp."""
    color: FloatArray
    """(3,) linear BGR irradiance on a surface that faces it."""
    shadows: bool = True


@dataclass(frozen=True, eq=False)
class Lighting:
    """All light: lamps and an ambient part from everywhere."""

    ambient: FloatArray
    """(3,) linear BGR."""
    lamps: tuple[Lamp, ...] = ()
    sky: int = 12
    """Directions from which the ambient light is looked at for shade; few give cloudy shade on the wall."""


class Patches(NamedTuple):
    """Small parts of surfaces that light what is near them."""

    places: FloatArray
    """(N, 3) [m] in the world."""
    normals: FloatArray
    """(N, 3) unit vectors in the world; zeros: a round thing, which faces everything."""
    areas: FloatArray
    """(N,) [m²]."""
    light: FloatArray
    """(N, 3) BGR that comes from them, as reflectance × irradiance."""
    owners: Array
    """(N,) names of the bodies that they are part of; of kernels their numbers."""

    def chosen(self, which: Array) -> Patches:
        """Those where `which` (N,) is true."""
        return Patches(*(column[which] for column in self))

    @staticmethod
    def joined(parts: Sequence[Patches]) -> Patches:
        """All of several."""
        return Patches(*map(np.concatenate, zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class ObjectState:
    """Where one object is, exactly."""

    name: str
    position: FloatArray
    """(3,) [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""


@dataclass(frozen=True, eq=False)
class PlatformScene:
    """Everything that a camera can see, and the truth about it."""

    bodies: tuple[Body, ...]
    lighting: Lighting
    objects: tuple[ObjectState, ...] = ()
    """The cube or cuboid alone, or all dice; empty: no object."""
    robot_position: FloatArray = field(default_factory=lambda: np.zeros(9))
    """(9,) joint angles [rad]."""
    about: dict[str, Any] = field(default_factory=dict)
    """What kind of scene it is, for the ground truth file (JSON values only)."""
    patches: Patches | None = None
    """What lights its neighbours; None: nothing does."""
    contact: tuple[float, float] = (0.0, 0.0)
    """Share of the sky's light that a cuboid and the table take from each other where it stands, 0 to 1, and
    how far that reaches [m]: see `synthetic.render.shadows`."""

    @property
    def cuboid(self) -> Body | None:
        """The body with faces; None: there is no object, or dice are."""
        return next((body for body in self.bodies if body.faces), None)

    def with_cuboid(self, change: Callable[[Body], Body]) -> PlatformScene:
        """The same with a changed cuboid, if there is one."""
        bodies = tuple(change(body) if body.faces else body for body in self.bodies)
        return dataclasses.replace(self, bodies=bodies)

    def emptied(self) -> PlatformScene:
        """The same without its objects, and without what stands in for them."""
        gone = {body.name for body in self.bodies if np.any(body.labels)}
        bodies = tuple(body for body in self.bodies if body.name not in gone)
        patches = self.patches
        if patches is not None:
            patches = patches.chosen(~np.isin(patches.owners, list(gone)))
            patches = patches if len(patches.owners) else None
        return dataclasses.replace(self, bodies=bodies, objects=(), patches=patches)


SceneAt = Callable[[float], PlatformScene]
"""The scene at a time [s]."""
