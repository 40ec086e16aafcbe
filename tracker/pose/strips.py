"""Strips of pixels across the visible edges of a posed cuboid in an image.

Each strip holds its middle, the normal that points out of its face, the Jacobian of the edge's motion along
that normal, the labels inside and outside (0: background), and how far the surfaces on both sides reach. Its
pixels are collected once; later only their distances from the edge change with the pose.
"""

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.camera import bent
from tracker.geometry.cuboid import CORNER_SIGNS, EDGES
from tracker.geometry.lens import face_heights, project_corners
from tracker.segmentation.light import CLIPPED

PIECES = 24
"""Maximum number of pieces of one edge."""

MAX_STRIPS = 9 * PIECES
"""Maximum number of pieces of one cuboid in one camera, which sees at most nine of its twelve edges."""

STRIP = np.dtype(
    [
        ("pixel", np.float64, (2,)),  # middle of the piece of edge (u, v) [px]
        ("normal", np.float64, (2,)),  # unit vector out of the face
        ("jacobian", np.float64, (6,)),  # motion along the normal per (δp, δθ) [px/m, px/rad]
        ("rim", np.float64),  # motion along the normal per width of the object's rim [px/m]
        ("length", np.float64),  # of the piece [px]
        ("reach_in", np.float64),  # how far the face reaches inwards [px]
        ("reach_out", np.float64),  # how far the neighbouring face reaches outwards [px]; 1000: background
        ("edge", np.int64),  # which of the cuboid's twelve edges
        ("inside", np.int64),  # label of the face
        ("outside", np.int64),  # label of the neighbouring face; 0: background
        ("in_view", np.bool_),  # whether it lies in the image and no mask hides it
        ("first", np.int64, (3,)),  # where its pixels begin, for each part of a mosaic in turn
        ("count", np.int64, (3,)),  # number of its pixels
        ("squares", np.float64),  # sum of their squared values
    ]
)
"""A piece of a visible edge."""

MIN_FACE = 1.5
"""A face narrower than this [px] has no edges: its colour mixes with its neighbours'."""

PIXELS = 1 << 14
"""Maximum number of pixels of a camera's strips, a multiple of BLOCK: beyond half of it, only every second
row and column is used, or fewer."""

MAX_PIXELS = 1024
"""Maximum number of pixels of a strip, a multiple of BLOCK."""

BLOCK = 8
"""Each strip's pixels begin at a multiple of this, so that sums consist of whole vectors."""

BESIDE = 2.0
"""Distance from a strip's middle, on both sides, at which no mask may hide the pixel [px]."""

FAR = 1e6
"""Distance that fills the gaps [px]."""

SUMS = {"reassoc", "contract", "nsz"}
"""Fast-math flags of sums: any order, but always the same."""


@compiled
def _face_depth(corners, k, face, axis, nu, nv):  # type: ignore[no-untyped-def]
    """Signed distance along a normal from corner k of an edge to the opposite edge of `face` [px].

    corners: from `project_corners`; axis: of the edge.
    """
    # The in-face direction away from the edge is the face's axis that is neither its normal nor the edge.
    other = k ^ (1 << (3 - axis - face // 2))
    return (corners[other, 0] - corners[k, 0]) * nu + (corners[other, 1] - corners[k, 1]) * nv


@compiled
def _depths(corners, ends, faces, length):  # type: ignore[no-untyped-def]
    """How far the face and the neighbour of an edge reach at its ends, and the face's outward normal.

    corners: from `project_corners`; ends: the edge's corners; faces: face, neighbour, whether the neighbour
    is visible, and the edge's axis; length: of the edge [px].
    """
    (a, b), (face, neighbour, inner, axis) = ends, faces
    nu, nv = (corners[b, 1] - corners[a, 1]) / length, (corners[a, 0] - corners[b, 0]) / length
    depth_a = _face_depth(corners, a, face, axis, nu, nv)
    depth_b = _face_depth(corners, b, face, axis, nu, nv)
    if depth_a + depth_b > 0.0:
        nu, nv, depth_a, depth_b = -nu, -nv, -depth_a, -depth_b
    out_a, out_b = 1e3, 1e3
    if inner:
        out_a = _face_depth(corners, a, neighbour, axis, nu, nv)
        out_b = _face_depth(corners, b, neighbour, axis, nu, nv)
    return depth_a, depth_b, out_a, out_b, nu, nv


@compiled
def _begin_edge(lens, half, rotation, position, ends, edge):  # type: ignore[no-untyped-def]
    """Fill edge (4, 3): an edge's first end and the way to its other end, along world and camera axes [m].

    The former are relative to the object's centre. ends: the edge's corners.
    """
    (a, b), r = ends, lens.rotation
    edge[:, :] = 0.0
    for i in range(3):
        for k in range(3):
            edge[0, i] += rotation[i, k] * CORNER_SIGNS[a, k] * half[k]
            edge[1, i] += rotation[i, k] * (CORNER_SIGNS[b, k] - CORNER_SIGNS[a, k]) * half[k]
    for i in range(3):
        edge[2, i] = lens.translation[i]
        for k in range(3):
            edge[2, i] += r[i, k] * (edge[0, k] + position[k])
            edge[3, i] += r[i, k] * edge[1, k]


@compiled
def _place_piece(lens, edge, share, outwards, strip):  # type: ignore[no-untyped-def]
    """Fill in pixel, normal and Jacobian of a piece with its middle at a share of the way along an edge.

    edge: from `_begin_edge`; outwards (3,): normal of the plane where the face's colour ends;
    strip: its normal's sign is kept.
    """
    x, y = edge[0, 0] + share * edge[1, 0], edge[0, 1] + share * edge[1, 1]
    z = edge[0, 2] + share * edge[1, 2]
    inverse = 1.0 / max(edge[2, 2] + share * edge[3, 2], 1e-6)
    a, b = (edge[2, 0] + share * edge[3, 0]) * inverse, (edge[2, 1] + share * edge[3, 1]) * inverse
    u, v, ua, ub, va, vb = bent(lens, a, b)
    (fx, fy), r = (lens.focal[0], lens.focal[1]), lens.rotation
    # The normal of the edge's image here: perpendicular to its projected direction.
    da, db = edge[3, 0] - a * edge[3, 2], edge[3, 1] - b * edge[3, 2]
    du, dv = fx * (ua * da + ub * db), fy * (va * da + vb * db)
    scale = 1.0 / math.sqrt(du * du + dv * dv)
    su, sv = dv * scale, -du * scale
    if su * strip.normal[0] + sv * strip.normal[1] < 0.0:
        su, sv = -su, -sv
    strip.pixel[0], strip.pixel[1] = fx * u + lens.center[0], fy * v + lens.center[1]
    strip.normal[0], strip.normal[1] = su, sv
    # The motion along the normal, for a motion of the piece along the camera's axes, then the world's.
    ja, jb = (su * fx * ua + sv * fy * va) * inverse, (su * fx * ub + sv * fy * vb) * inverse
    jc = -(a * ja + b * jb)
    jx = ja * r[0, 0] + jb * r[1, 0] + jc * r[2, 0]
    jy = ja * r[0, 1] + jb * r[1, 1] + jc * r[2, 1]
    jz = ja * r[0, 2] + jb * r[1, 2] + jc * r[2, 2]
    strip.jacobian[0], strip.jacobian[1], strip.jacobian[2] = jx, jy, jz
    strip.jacobian[3] = y * jz - z * jy
    strip.jacobian[4] = z * jx - x * jz
    strip.jacobian[5] = x * jy - y * jx
    strip.rim = -(jx * outwards[0] + jy * outwards[1] + jz * outwards[2])


@compiled
def edge_strips(lenses, c, half, face_labels, rotation, position, spacing, margin, out):  # type: ignore[no-untyped-def]
    """Fill out (MAX_STRIPS,) of STRIP with pieces of the visible edges in camera c; return their number.

    Their motion is equation (7) of docs/how-it-works.md.
    spacing: distance between pieces [px]; margin: their distance from the corners [px].
    """
    heights, corners = np.empty(6), np.empty((8, 3))
    face_heights(lenses, c, half, rotation, position, heights)
    project_corners(lenses, c, half, rotation, position, corners)
    outwards, edge = np.empty(3), np.empty((4, 3))
    # An edge closer to the camera than this extends beyond the image.
    near = 0.5 * (half[0] + half[1] + half[2]) / 3.0
    count = 0
    for e in range(12):
        face, neighbour = EDGES[e, 2], EDGES[e, 3]
        if heights[face] <= 0.0 and heights[neighbour] <= 0.0:
            continue
        if heights[face] <= 0.0:
            face, neighbour = neighbour, face
        inner = heights[neighbour] > 0.0
        axis = 3 - EDGES[e, 2] // 2 - EDGES[e, 3] // 2
        a, b = EDGES[e, 0], EDGES[e, 1]
        length = math.sqrt((corners[b, 0] - corners[a, 0]) ** 2 + (corners[b, 1] - corners[a, 1]) ** 2)
        usable = length - 2.0 * margin
        if min(corners[a, 2], corners[b, 2]) < near or not usable >= 0.5 * spacing:
            continue
        depth_a, depth_b, out_a, out_b, nu, nv = _depths(
            corners, (a, b), (face, neighbour, inner, axis), length
        )
        if -0.5 * (depth_a + depth_b) < MIN_FACE or 0.5 * (out_a + out_b) < MIN_FACE:
            continue
        # A face's colour ends a rim's width before its neighbour's plane. If both faces are visible, the edge
        # is midway between their borders.
        one, other = neighbour // 2, (face if inner else neighbour) // 2
        for i in range(3):
            outwards[i] = CORNER_SIGNS[a, one] * rotation[i, one]
            outwards[i] = 0.5 * (outwards[i] + CORNER_SIGNS[a, other] * rotation[i, other])
        _begin_edge(lenses[c], half, rotation, position, (a, b), edge)
        n = max(1, int(min(usable / spacing + 0.5, PIECES)))
        first, step = margin / length, usable / (n * length)
        for k in range(n):
            share = first + step * (k + 0.5)
            strip = out[count]
            strip.normal[0], strip.normal[1] = nu, nv
            _place_piece(lenses[c], edge, share, outwards, strip)
            strip.edge = e
            strip.inside = face_labels[face]
            strip.outside = face_labels[neighbour] if inner else 0
            strip.reach_in = -depth_a - share * (depth_b - depth_a)
            strip.reach_out = out_a + share * (out_b - out_a)
            strip.length = usable / n
            count += 1
    return count


@compiled
def padded(count):  # type: ignore[no-untyped-def]
    """Return a number of pixels plus the gap after them."""
    return (count + BLOCK - 1) // BLOCK * BLOCK


@compiled
def _columns_of(red, channel, j):  # type: ignore[no-untyped-def]
    """Which columns of row j of a mosaic measured a channel: 0 for even, 1 for odd, -1 for none."""
    has_red = (j & 1) == red >> 1
    if channel == 1:
        return (red & 1) ^ 1 if has_red else red & 1
    return (red & 1) ^ (channel == 0) if has_red == (channel == 2) else -1


@compiled
def _in_view(strip, reach, width, height):  # type: ignore[no-untyped-def]
    """Whether a strip lies completely in the image."""
    along = 0.5 * strip.length
    du = abs(strip.normal[0]) * reach + abs(strip.normal[1]) * along
    dv = abs(strip.normal[1]) * reach + abs(strip.normal[0]) * along
    u, v = strip.pixel[0], strip.pixel[1]
    return u - du >= 0.0 and v - dv >= 0.0 and u + du <= width - 1.0 and v + dv <= height - 1.0


@compiled
def _collect(image, tilt, strip, reach, at, pixels):  # type: ignore[no-untyped-def]
    """Collect the signed distances [px] and colours of a strip's pixels; return their number.

    at: first index, stride, which pixels of the mosaic measured red, and the channel whose measured pixels
    count.
    """
    start, stride, red, channel = at
    distance, values = pixels
    u, v, nu, nv, along = strip.pixel[0], strip.pixel[1], strip.normal[0], strip.normal[1], 0.5 * strip.length
    du, dv = abs(nu) * reach + abs(nv) * along, abs(nv) * reach + abs(nu) * along
    # The light changes little over a strip: its factors are linearised.
    across, down = 2.0 / image.shape[1], 2.0 / image.shape[0]
    even = tilt[0, 0] == 0.0 and tilt[0, 1] == 0.0 and tilt[1, 0] == 0.0 and tilt[1, 1] == 0.0
    blue = 1.0 if even else math.exp(-tilt[0, 0] * (u * across - 1.0) - tilt[0, 1] * (v * down - 1.0))
    red_ = 1.0 if even else math.exp(-tilt[1, 0] * (u * across - 1.0) - tilt[1, 1] * (v * down - 1.0))
    last = min(start + MAX_PIXELS, len(distance))
    place, step = start, stride
    for j in range(math.ceil(v - dv), int(v + dv) + 1, stride):
        y = j - v
        # The part of the row whose pixels lie in the strip.
        low, high = u - du, u + du
        if abs(nu) > 1e-9:
            one, two = (-reach - y * nv) / nu, (reach - y * nv) / nu
            low, high = max(low, u + min(one, two)), min(high, u + max(one, two))
        if abs(nv) > 1e-9:
            one, two = (y * nu - along) / nv, (y * nu + along) / nv
            low, high = max(low, u + min(one, two)), min(high, u + max(one, two))
        first = math.ceil(low)
        if red >= 0:
            odd, step = _columns_of(red, channel, j), 2
            if odd < 0:
                continue
            first += (first & 1) ^ odd
        for i in range(first, min(math.floor(high) + 1, first + step * (last - place)), step):
            x = i - u
            distance[place] = x * nu + y * nv
            b, g, r = image[j, i, 0], image[j, i, 1], image[j, i, 2]
            values[0, place], values[1, place], values[2, place] = b, g, r
            place += 1
            if even:
                continue
            bend = 1.0 - tilt[0, 0] * across * x - tilt[0, 1] * down * y
            values[0, place - 1] = 255.0 if b >= CLIPPED else min(b * blue * bend, CLIPPED - 1.0)
            bend = 1.0 - tilt[1, 0] * across * x - tilt[1, 1] * down * y
            values[2, place - 1] = 255.0 if r >= CLIPPED else min(r * red_ * bend, CLIPPED - 1.0)
    return place - start


@compiled(fastmath=SUMS)
def _sum_of_squares(values, first, last):  # type: ignore[no-untyped-def]
    """Sum of squares of a range of values (P,)."""
    total = 0.0
    for i in range(np.uint64(first), np.uint64(last)):
        total += values[i] * values[i]
    return total


@compiled
def _stride(strips, n, reach):  # type: ignore[no-untyped-def]
    """Stride of rows and columns at which the pixels of all strips fit into their arrays."""
    total, most = 0.0, 0.0
    for s in range(n):
        size = strips[s].length * 2.0 * reach
        total, most = total + size, max(most, size)
    return max(1, math.ceil(math.sqrt(2.0 * max(total / PIXELS, most / MAX_PIXELS))))


@compiled
def collect(shown, picture, camera, strips, every, pixels):  # type: ignore[no-untyped-def]
    """Collect the pixels of strips in one image (H, W, 3) into pixels: distance (P,) and values (3, P).

    shown: the image and its mask of hidden pixels (H, W); picture: its light and mosaic (`views.PICTURE`);
    camera (`solution.CAMERA`): number of strips, their half width, and whether the mosaic counts; every:
    collect for every n-th strip only, unless already done. Each strip stores where its pixels are, separately
    for each channel of a mosaic. Gaps up to the next multiple of BLOCK are filled with FAR and 0; P must be
    such a multiple.
    """
    (image, mask), start, parts, reach = shown, camera.pixels, camera.parts, camera.reach
    stride = _stride(strips, camera.strips, reach) if parts == 1 else 1
    red = picture.mosaic if parts > 1 else -1
    distance, values = pixels
    for s in range(camera.strips):
        if camera.every > 0 and s % camera.every == 0:
            continue
        strip = strips[s]
        strip.in_view = _in_view(strip, reach, image.shape[1], image.shape[0])
        if picture.hidden != 0 and strip.in_view:
            # The contour of an occluder is not an edge of the object.
            for side in (-BESIDE, 0.0, BESIDE):
                u, v = strip.pixel[0] + side * strip.normal[0], strip.pixel[1] + side * strip.normal[1]
                strip.in_view = strip.in_view and not mask[int(v + 0.5), int(u + 0.5)]
        strip.squares = 0.0
        for part in range(3):
            strip.first[part], strip.count[part] = start, 0
            if not strip.in_view or part >= parts or s % every:
                continue
            at = start, stride, red, part
            count = _collect(image, picture.tilt, strip, reach, at, pixels)
            end = start + padded(count)
            for k in range(part, part + 3 // parts):
                for i in range(start + count, end):
                    distance[i], values[k, i] = FAR, 0.0
                strip.squares += _sum_of_squares(values[k], start, end)
            strip.count[part], start = count, end
    camera.every, camera.pixels = every, start
