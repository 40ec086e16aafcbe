"""Which body each pixel shows, drawn by PyBullet's TinyRenderer: a software rasteriser without OpenGL."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from synthetic.render.interface import PinholeView, RendererError
from synthetic.scene import Body, Mesh
from tracker.conventions import Array, FloatArray

_NEAR_M, _FAR_M = 0.05, 5.0
_FAR_AWAY_M = (0.0, 0.0, -50.0)
_KEPT_PARTS = 500
"""Colour groups of bodies; PyBullet looks at all of them for every picture, wherever they are."""
_MAX_VERTICES = 130_000
"""Of one shape; PyBullet's shared memory holds little more."""


class Stage:
    """A PyBullet world of its own that holds nothing but shapes to look at.

    The renderer numbers whole bodies, so each colour group of a mesh is one. They stay in the world; those
    that a scene lacks are parked far away.
    """

    def __init__(self) -> None:
        import pybullet

        self._bullet: Any = pybullet
        self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise RendererError("tiny: PyBullet gives no further world")
        self._pool: dict[tuple[str, int], list[tuple[int, int]]] = {}
        self._places: dict[tuple[str, int], bytes] = {}

    def close(self) -> None:
        """Delete the world."""
        if self._client >= 0:
            self._bullet.disconnect(self._client)
            self._client = -1

    def paint(self, view: PinholeView, bodies: list[tuple[int, Body]]) -> tuple[Array, Array, FloatArray]:
        """Numbers of bodies (h, w) int16 or -1, their colour groups (h, w) int32, and depths (h, w) [m]."""
        table = self._arrange(bodies)
        bullet = self._bullet
        _, _, _, buffer, ids = bullet.getCameraImage(
            view.width,
            view.height,
            _opengl_from_world(view).T.ravel().tolist(),
            _projection(view).T.ravel().tolist(),
            renderer=bullet.ER_TINY_RENDERER,
            shadow=0,
            physicsClientId=self._client,
        )
        shape = view.height, view.width
        rows = table[np.asarray(ids).reshape(shape)]  # nothing is -1: the table's last row
        depth = (
            _FAR_M * _NEAR_M / (_FAR_M - (_FAR_M - _NEAR_M) * np.asarray(buffer, np.float64).reshape(shape))
        )
        return rows[..., 0].astype(np.int16), rows[..., 1], depth

    def _arrange(self, bodies: list[tuple[int, Body]]) -> Array:
        """Put all bodies in place; scene's number and group (ids + 1, 2) of PyBullet's numbers."""
        seen: dict[str, int] = defaultdict(int)
        rows = {}
        if sum(map(len, self._pool.values())) > _KEPT_PARTS:
            self._clear()
        for number, body in bodies:
            key = body.mesh.key, seen[body.mesh.key]
            seen[body.mesh.key] += 1
            if key not in self._pool:
                self._pool[key] = self._load(body.mesh)
            rows.update({unique: (number, group) for unique, group in self._pool[key]})
            self._move(key, body.world_from_body)
        for key in self._pool:
            if key[1] >= seen.get(key[0], 0):
                self._move(key, None)
        table = np.full((max(rows, default=-1) + 2, 2), -1, np.int32)
        for unique, row in rows.items():
            table[unique] = row
        return table

    def _load(self, mesh: Mesh) -> list[tuple[int, int]]:
        """PyBullet's numbers of the parts of a mesh, each with its colour group."""
        parts = []
        triangles, groups = np.asarray(mesh.triangles), np.asarray(mesh.groups)
        for group in np.unique(groups):
            used, indices = np.unique(triangles[groups == group].ravel(), return_inverse=True)
            if len(used) > _MAX_VERTICES:
                raise RendererError(
                    f"tiny: mesh {mesh.key}: found {len(used)} vertices, expected up to {_MAX_VERTICES}"
                )
            shape = self._bullet.createVisualShape(
                self._bullet.GEOM_MESH,
                vertices=np.asarray(mesh.vertices)[used].tolist(),
                indices=indices.ravel().tolist(),
                physicsClientId=self._client,
            )
            unique = self._bullet.createMultiBody(0, -1, shape, physicsClientId=self._client)
            if shape < 0 or unique < 0:
                raise RendererError(f"tiny: mesh {mesh.key}: PyBullet does not take it")
            parts.append((unique, int(group)))
        return parts

    def _move(self, key: tuple[str, int], world_from_body: FloatArray | None) -> None:
        place = b"" if world_from_body is None else world_from_body.tobytes()
        if self._places.get(key) == place:
            return
        self._places[key] = place
        position, orientation = _FAR_AWAY_M, (0.0, 0.0, 0.0, 1.0)
        if world_from_body is not None:
            position = tuple(world_from_body[:3, 3])
            # A copy, since older versions of SciPy take no read-only arrays.
            orientation = tuple(Rotation.from_matrix(world_from_body[:3, :3].copy()).as_quat())
        for unique, _ in self._pool[key]:
            self._bullet.resetBasePositionAndOrientation(
                unique, position, orientation, physicsClientId=self._client
            )

    def _clear(self) -> None:
        self._bullet.resetSimulation(physicsClientId=self._client)
        self._pool.clear()
        self._places.clear()


def _opengl_from_world(view: PinholeView) -> FloatArray:
    """OpenGL's camera looks along -z, with y up."""
    result: FloatArray = np.diag([1.0, -1.0, -1.0, 1.0]) @ view.camera_from_world
    return result


def _projection(view: PinholeView) -> FloatArray:
    """(4, 4) OpenGL projection for TinyRenderer.

    It samples pixel (i, j) at i, not at i + ½, from the left; from the bottom likewise, and then turns the
    rows around: row j of the picture is sampled at h - 1 - j from the bottom, j + 1 from the top.
    """
    w, h = view.width, view.height
    depth, product = _FAR_M - _NEAR_M, 2 * _FAR_M * _NEAR_M
    return np.array(
        [
            [2 * view.fx / w, 0.0, 1 - 2 * view.cx / w, 0.0],
            [0.0, 2 * view.fy / h, 2 * (view.cy + 1) / h - 1, 0.0],
            [0.0, 0.0, -(_FAR_M + _NEAR_M) / depth, -product / depth],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )
