"""A renderer's input and output types, and a rasteriser with a depth buffer.

In an undistorted image 1 / depth is linear over a triangle; each pixel keeps the triangle with the largest
1 / depth at its centre.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synthetic.render.surfaces import BODY_SHIFT
from synthetic.scene import Mesh
from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray, Image


@dataclass(frozen=True, eq=False)
class PinholeView:
    """A camera without distortion: u = fx X/Z + cx, v = fy Y/Z + cy [px], with pixel centres at integers."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_from_world: FloatArray
    """(4, 4) [m]; OpenCV's axes: x to the right, y down, z forward."""
    block: int = 1
    """Pixels in a square block of this size may share the shading of one of them where they show the same
    surface: a camera's pixel made of one block has exact edges and is shaded about once."""


@dataclass(frozen=True, eq=False)
class Layers:
    """Output of a view, one value per pixel: that of the point hit by the ray through its centre."""

    color: npt.NDArray[np.float32]
    """(h, w, 3) linear BGR light: reflectance × irradiance, may exceed 1."""
    labels: Image
    """(h, w) uint8 label of the visible surface; 0 for non-objects."""
    alone: Image
    """(h, w) uint8 labels of the objects alone, the denominator of visible fractions."""
    nearness: npt.NDArray[np.float32]
    """(h, w) 1 / depth along the view's axis [1/m]; 0 where nothing is."""


_NEAR_M = 0.02
"""Distance of the near plane [m]; nothing nearer is drawn."""


def paint(view: PinholeView, bodies: Iterable[tuple[int, Mesh, FloatArray]]) -> tuple[Array, Array]:
    """Rasterise bodies, each with its number, mesh and world_from_body (4, 4).

    Return codes (h, w) uint32 and 1 / depth (h, w) float32 [1/m]; both are 0 where nothing is.
    """
    codes = np.zeros((view.height, view.width), np.uint32)
    nearness = np.zeros(codes.shape, np.float32)
    lens = np.array([view.fx, view.fy, view.cx, view.cy])
    for number, mesh, world_from_body in bodies:
        camera_from_body = view.camera_from_world @ world_from_body
        vertices = np.asarray(mesh.vertices) @ camera_from_body[:3, :3].T + camera_from_body[:3, 3]
        # Always copied: the kernel is compiled for writable arrays.
        triangles = np.asarray(mesh.triangles).astype(np.int32)
        _draw(vertices, triangles, lens, (number + 1) << BODY_SHIFT, nearness, codes)
    return codes, nearness


@compiled
def _draw(vertices: Array, triangles: Array, lens: Array, first: int, nearness: Array, codes: Array) -> None:
    """Rasterise triangles of vertices (V, 3) [m] in the camera's frame; triangle t has the code first + t."""
    seen, corners = np.empty(vertices.shape), np.ones((4, 3))
    _project(vertices, lens, seen)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if min(vertices[a, 2], vertices[b, 2], vertices[c, 2]) >= _NEAR_M:
            _fill(seen, a, b, c, first + t, nearness, codes)
            continue
        count = _in_front(vertices, triangles, t, corners)
        _project(corners, lens, corners)
        for k in range(2, count):
            _fill(corners, 0, k - 1, k, first + t, nearness, codes)


@compiled
def _project(points: Array, lens: Array, out: Array) -> None:
    """Project points (N, 3) [m] in the camera's frame to pixels and 1 / depth (N, 3)."""
    for n in range(points.shape[0]):
        near = 1.0 / points[n, 2]
        out[n, 0] = lens[0] * points[n, 0] * near + lens[2]
        out[n, 1] = lens[1] * points[n, 1] * near + lens[3]
        out[n, 2] = near


@compiled
def _in_front(vertices: Array, triangles: Array, t: int, corners: Array) -> int:
    """Clip a triangle at the near plane; fill `corners` with its polygon and return the number of corners."""
    count = 0
    for k in range(3):
        a, b = triangles[t, k], triangles[t, (k + 1) % 3]
        here, there = vertices[a, 2] - _NEAR_M, vertices[b, 2] - _NEAR_M
        if here >= 0:
            for c in range(3):
                corners[count, c] = vertices[a, c]
            count += 1
        if (here >= 0) != (there >= 0):
            share = here / (here - there)
            for c in range(3):
                corners[count, c] = vertices[a, c] + share * (vertices[b, c] - vertices[a, c])
            count += 1
    return count


@compiled
def _fill(seen: Array, a: int, b: int, c: int, code: int, nearness: Array, codes: Array) -> None:
    """Rasterise, row by row, the triangle of three rows (u, v, 1 / depth) of `seen`."""
    height, width = codes.shape
    ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
    if max(ax, bx, cx) < 0 or min(ax, bx, cx) > width - 1:
        return
    top, bottom = max(np.ceil(min(ay, by, cy)), 0.0), min(np.floor(max(ay, by, cy)), height - 1.0)
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if top > bottom or area == 0.0:
        return
    ab, ac = seen[b, 2] - seen[a, 2], seen[c, 2] - seen[a, 2]
    along_x = (ab * (cy - ay) - ac * (by - ay)) / area
    along_y = (ac * (bx - ax) - ab * (cx - ax)) / area
    edges = _edge(ax, ay, bx, by), _edge(bx, by, cx, cy), _edge(cx, cy, ax, ay)
    for j in range(int(top), int(bottom) + 1):
        low, high = np.inf, -np.inf
        for x, y, end, slope in edges:
            if y <= j <= end:
                here = x + (j - y) * slope
                low, high = min(low, here), max(high, here)
        left, right = max(np.ceil(low), 0.0), min(np.floor(high), width - 1.0)
        if left > right:
            continue
        first = int(left)
        start = np.float32(seen[a, 2] + along_y * (j - ay) + along_x * (left - ax))
        step, own = np.float32(along_x), np.uint32(code)
        # Numbers of one size and no branch, so that eight pixels are processed at once.
        for k in range(int(right) - first + 1):
            near = start + step * np.float32(k)
            seen_now, shown = nearness[j, first + k], codes[j, first + k]
            nearness[j, first + k] = max(near, seen_now)
            codes[j, first + k] = own if near > seen_now else shown


@compiled
def _edge(px: float, py: float, qx: float, qy: float) -> tuple[float, float, float, float]:
    """Return the upper end (x, y) of an edge, the y of its lower end, and the slope dx/dy.

    Starting at the upper end in either direction, triangles that share an edge leave no gap.
    """
    if py == qy:
        return px, np.inf, -np.inf, 0.0
    slope = (qx - px) / (qy - py)
    return (px, py, qy, slope) if py < qy else (qx, qy, py, slope)
