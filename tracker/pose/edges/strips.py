"""Where a posed cuboid's visible edges should appear in an image, as sample points with normals.

Each sample knows its pixel, the normal that points out of its face, how the pixel moves along that
normal with the pose, the label inside, the label outside (0 where background is), and how far the
surfaces on both sides reach.
"""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.cuboid import CORNER_SIGNS, EDGES
from tracker.geometry.lens import project, project_with_jacobian, rotate, visible_faces

PIECES = 24
"""Pieces of one edge, at most."""

MAX_STRIPS = 9 * PIECES
"""Pieces of the edges of one cuboid in one camera, at most: it shows nine of its twelve edges."""

STRIP = np.dtype(
    [
        ("pixel", np.float64, (2,)),  # middle of the piece of edge (u, v) [px]
        ("normal", np.float64, (2,)),  # unit vector out of the face
        ("jacobian", np.float64, (6,)),  # motion along the normal per (δp, δθ) [px/m, px/rad]
        ("rim", np.float64),  # motion along the normal per width of the object's rim [px/m]
        ("length", np.float64),  # of the piece [px]
        ("reach_in", np.float64),  # how far the face reaches inwards [px]
        ("reach_out", np.float64),  # how far the neighbouring face reaches outwards [px]; 1000: background
        ("edge", np.int64),  # which of the cuboid's twelve it is part of
        ("inside", np.int64),  # label of the face
        ("outside", np.int64),  # label of the neighbouring face; 0: background
        ("in_view", np.bool_),  # whether the picture shows it as a whole
        ("first", np.int64, (3,)),  # where its pixels begin, for each part of a mosaic, one after the other
        ("count", np.int64, (3,)),  # how many they are
        ("squares", np.float64),  # sum of their squared values
    ]
)
"""A piece of a visible edge."""

MIN_FACE = 1.5
"""A face narrower than this [px] gives no edges: its colour cannot be told from its neighbours' blur."""

_SIGNS = CORNER_SIGNS
_EDGES = EDGES


@compiled
def _face_depth(lenses, c, half, rotation, position, corner, face, axis, u, v, nu, nv):  # type: ignore[no-untyped-def]
    """How far [px, signed along the normal] from a corner's pixel the opposite edge of `face` lies."""
    # The in-face direction away from the edge is the face's axis that is neither its normal nor the edge.
    inward = 3 - axis - face // 2
    other = np.empty(3)
    for i in range(3):
        other[i] = corner[i]
    other[inward] = -corner[inward]
    world = np.empty(3)
    rotate(rotation, other, world)
    pu, pv, _ = project(lenses, c, world[0] + position[0], world[1] + position[1], world[2] + position[2])
    return (pu - u) * nu + (pv - v) * nv


@compiled
def _outwards(rotation, corner, one, other, out):  # type: ignore[no-untyped-def]
    """Out (3,) = mean of the normals of two faces that meet at a corner (3,), along world axes.

    A face's colour ends a rim's width before its neighbour's plane. Where both faces are seen, the middle
    between their borders is the edge.
    """
    for i in range(3):
        out[i] = 0.5 * (
            math.copysign(1.0, corner[one // 2]) * rotation[i, one // 2]
            + math.copysign(1.0, corner[other // 2]) * rotation[i, other // 2]
        )


@compiled
def edge_strips(lenses, c, half, face_labels, rotation, position, spacing, margin, out):  # type: ignore[no-untyped-def]
    """Fill out (MAX_STRIPS,) of STRIP with the pieces of the visible edges in camera c; returns their count.

    Their motion is equation (7) of docs/how-it-works.md.
    spacing: distance between samples [px]; margin: how far they keep from the corners [px].
    """
    heights = np.empty(6)
    visible_faces(lenses, c, half, rotation, position, heights)
    a, b = np.empty(3), np.empty(3)
    local, world = np.empty(3), np.empty(3)
    jacobian, outwards = np.empty((2, 3)), np.empty(3)
    # An edge so close to a camera is more than a picture can show.
    near = 0.5 * (half[0] + half[1] + half[2]) / 3.0
    count = 0
    for e in range(12):
        face, neighbour = _EDGES[e, 2], _EDGES[e, 3]
        if heights[face] <= 0.0 and heights[neighbour] <= 0.0:
            continue
        if heights[face] <= 0.0:
            face, neighbour = neighbour, face
        inner = heights[neighbour] > 0.0
        axis = 3 - _EDGES[e, 2] // 2 - _EDGES[e, 3] // 2
        for i in range(3):
            a[i] = _SIGNS[_EDGES[e, 0], i] * half[i]
            b[i] = _SIGNS[_EDGES[e, 1], i] * half[i]
        rotate(rotation, a, world)
        ua, va, za = project(
            lenses, c, world[0] + position[0], world[1] + position[1], world[2] + position[2]
        )
        rotate(rotation, b, world)
        ub, vb, zb = project(
            lenses, c, world[0] + position[0], world[1] + position[1], world[2] + position[2]
        )
        if za < near or zb < near:
            continue
        length = math.hypot(ub - ua, vb - va)
        usable = length - 2.0 * margin
        if usable < 0.5 * spacing:
            continue
        nu, nv = (vb - va) / length, (ua - ub) / length
        depth_a = _face_depth(lenses, c, half, rotation, position, a, face, axis, ua, va, nu, nv)
        depth_b = _face_depth(lenses, c, half, rotation, position, b, face, axis, ub, vb, nu, nv)
        if depth_a + depth_b > 0.0:
            nu, nv, depth_a, depth_b = -nu, -nv, -depth_a, -depth_b
        out_a, out_b = 1e3, 1e3
        if inner:
            out_a = _face_depth(lenses, c, half, rotation, position, a, neighbour, axis, ua, va, nu, nv)
            out_b = _face_depth(lenses, c, half, rotation, position, b, neighbour, axis, ub, vb, nu, nv)
        if -0.5 * (depth_a + depth_b) < MIN_FACE or 0.5 * (out_a + out_b) < MIN_FACE:
            continue
        _outwards(rotation, a, neighbour, face if inner else neighbour, outwards)
        n = min(PIECES, max(1, int(usable / spacing + 0.5)))
        for k in range(n):
            share = (margin + usable * (k + 0.5) / n) / length
            for i in range(3):
                local[i] = a[i] + share * (b[i] - a[i])
            rotate(rotation, local, world)
            u, v, _ = project_with_jacobian(
                lenses, c, world[0] + position[0], world[1] + position[1], world[2] + position[2], jacobian
            )
            # The normal of the edge's image here: perpendicular to its projected direction.
            du, dv = 0.0, 0.0
            for i in range(3):
                du += jacobian[0, i] * rotation[i, axis]
                dv += jacobian[1, i] * rotation[i, axis]
            norm = math.hypot(du, dv)
            su, sv = dv / norm, -du / norm
            if su * nu + sv * nv < 0.0:
                su, sv = -su, -sv
            strip = out[count]
            strip.pixel[0], strip.pixel[1] = u, v
            strip.normal[0], strip.normal[1] = su, sv
            jx = su * jacobian[0, 0] + sv * jacobian[1, 0]
            jy = su * jacobian[0, 1] + sv * jacobian[1, 1]
            jz = su * jacobian[0, 2] + sv * jacobian[1, 2]
            strip.jacobian[0], strip.jacobian[1], strip.jacobian[2] = jx, jy, jz
            strip.jacobian[3] = world[1] * jz - world[2] * jy
            strip.jacobian[4] = world[2] * jx - world[0] * jz
            strip.jacobian[5] = world[0] * jy - world[1] * jx
            strip.edge = e
            strip.inside = face_labels[face]
            strip.outside = face_labels[neighbour] if inner else 0
            strip.reach_in = -depth_a - share * (depth_b - depth_a)
            strip.reach_out = out_a + share * (out_b - out_a)
            strip.length = usable / n
            strip.rim = -(jx * outwards[0] + jy * outwards[1] + jz * outwards[2])
            count += 1
    return count
