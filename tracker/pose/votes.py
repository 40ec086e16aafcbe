"""Candidate positions of the object from label maps alone, without a prior.

Grid points over the arena vote by how much of the object's expected area the cameras see around them in face
colours. The best points are then centred on the pixels they gathered.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry.arena import Arena
from tracker.geometry.camera import Camera
from tracker.geometry.lens import clamped, project, project_with_jacobian, stack_lenses
from tracker.geometry.linear import solve_positive
from tracker.objects.labels import UNKNOWN
from tracker.objects.model import Box

MIN_VOTE, RELATIVE_VOTE = 0.15, 0.35
"""Smallest vote of a position: absolute, and relative to the best."""

DOUBT = 2.0
"""Number of imaginary cameras that see nothing at a point, added to those that view it. With fewer, points
behind the object, which only one camera views, outvote the place that all cameras view."""

GRID_STEP = 0.5
"""Spacing of the grid [radii of the object]."""

MOST_POINTS = 1 << 18
"""Maximum number of grid points: in a larger arena they are farther apart."""

TIGHT = 0.6
"""Width of the tight box relative to the wide one."""

SEPARATION = 0.7
"""Positions closer than this count as one [radii]."""

CENTRING_ROUNDS = 3

CELL = 2
"""Width of the cells in which pixels are counted [px of the label map]."""

FACE = np.float32(1.0 / 3.0)
"""Largest share of the object that one colour counts for: a camera sees up to three faces, and a cloth of one
colour is no object."""

BITS = 21
"""Width of a label's count: three share an integer."""

_COUNTS = np.array(
    [[0, 1, 1 << BITS, 1 << 2 * BITS, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1 << BITS, 1 << 2 * BITS, 0]]
)
"""What a pixel of each label adds to the two integers; the last column is for UNKNOWN."""

BOXES = np.dtype(
    [
        ("wide", np.uint16, (4,)),  # left, top, right, bottom of the box around it [cells]
        ("tight", np.uint16, (4,)),  # the same of the tight box
        ("share", np.float32),  # 1 / pixels that the object should fill; 0: it is out of view
    ]
)
"""Where a camera looks for an object at a point; unsigned, since signed indices could count from the end."""


@compiled
def _integrate(labels, lenses, pictures, out):  # type: ignore[no-untyped-def]
    """Fill out (C, h / CELL + 1, w / CELL + 1, 2): integral images of the labels 1 to 3 and 4 to 6."""
    for c in range(len(pictures)):
        rows, columns = lenses[c].height // CELL, lenses[c].width // CELL
        out[c, 0, : columns + 1] = 0
        for j in range(rows):
            first, second = 0, 0
            out[c, j + 1, 0, 0], out[c, j + 1, 0, 1] = 0, 0
            for i in range(columns):
                for v in range(CELL * j, CELL * j + CELL):
                    for u in range(CELL * i, CELL * i + CELL):
                        label = labels[c, v, u]
                        if label > 0:
                            first += _COUNTS[0, min(label, 7)]
                            second += _COUNTS[1, min(label, 7)]
                out[c, j + 1, i + 1, 0] = out[c, j, i + 1, 0] + first
                out[c, j + 1, i + 1, 1] = out[c, j, i + 1, 1] + second


@compiled
def _shown(integrals, c, box, share):  # type: ignore[no-untyped-def]
    """Share of the object that a box of camera c shows."""
    left, top, right, bottom = box[0], box[1], box[2], box[3]
    total = np.float32(0.0)
    for half in range(2):
        low = integrals[c, bottom, right, half] - integrals[c, bottom, left, half]
        counts = low - integrals[c, top, right, half] + integrals[c, top, left, half]
        if counts > 0:
            for k in range(3):
                count = (counts >> BITS * k) & ((1 << BITS) - 1)
                total += min(np.float32(count) * share, FACE)
    return total


@compiled
def view_points(labels, lenses, pictures, boxes, views):  # type: ignore[no-untyped-def]
    """Fill views (N, C): what each camera shows of an object around a point; -1: the point is out of view.

    This is V of equation (4) of docs/how-it-works.md.
    labels (C, h, w) of pictures (C,) of PICTURE; boxes (N, C) of BOXES. The tight box centres the vote, the
    wide one tolerates occlusion.
    """
    count, height, width = labels.shape
    integrals = np.empty((count, height // CELL + 1, width // CELL + 1, 2), np.int64)
    _integrate(labels, lenses, pictures, integrals)
    for p in range(len(views)):
        for c in range(len(pictures)):
            at, views[p, c] = boxes[p, c], -1.0
            if pictures[c].used and at.share > 0.0:
                wide = _shown(integrals, c, at.wide, at.share)
                views[p, c] = wide + _shown(integrals, c, at.tight, at.share) if wide > 0.0 else wide


@compiled
def vote(views, pictures, votes):  # type: ignore[no-untyped-def]
    """Fill votes (N,): the sum of views (N, C), over 1 + n / DOUBT where n cameras view a point.

    Cameras that pictures (C,) of PICTURE leaves out have no vote. Return the largest vote.
    """
    most = np.float32(0.0)
    for p in range(len(votes)):
        total, number = np.float32(0.0), 0.0
        for c in range(len(pictures)):
            if pictures[c].used and views[p, c] >= 0.0:
                total, number = total + views[p, c], number + 1.0
        votes[p] = total / (1.0 + number / DOUBT)
        most = max(most, votes[p])
    return most


@compiled
def _take_best(points, votes, radius, out):  # type: ignore[no-untyped-def]
    """Copy the best point to out (3,), and drop all within `radius` [m] from the vote; return its vote."""
    best = 0
    for p in range(len(votes)):
        if votes[p] > votes[best]:
            best = p
    found = votes[best]
    for i in range(3):
        out[i] = points[best, i]
    for p in range(len(votes)):
        distance = 0.0
        for i in range(3):
            distance += (points[p, i] - out[i]) ** 2
        if distance < radius * radius:
            votes[p] = -1.0
    return found


@compiled
def gather(lenses, labels, pictures, position, radius, stats):  # type: ignore[no-untyped-def]
    """Stats (C, 7, 3): count, mean column, mean row of each label within `radius` [m] of a position."""
    stats[:] = 0.0
    for c in range(len(pictures)):
        if not pictures[c].used:
            continue
        u, v, z = project(lenses, c, position[0], position[1], position[2])
        if z < radius:
            continue
        ru, rv = radius * lenses[c].focal[0] / z, radius * lenses[c].focal[1] / z
        width, height = lenses[c].width, lenses[c].height
        for j in range(clamped(v - rv, height), min(height, clamped(v + rv, height) + 2)):
            for i in range(clamped(u - ru, width), min(width, clamped(u + ru, width) + 2)):
                label = labels[c, j, i]
                if label == 0 or label == UNKNOWN or ((i - u) / ru) ** 2 + ((j - v) / rv) ** 2 > 1.0:
                    continue
                stats[c, label, 0] += 1.0
                stats[c, label, 1] += i
                stats[c, label, 2] += j
        for label in range(1, 7):
            if stats[c, label, 0] > 0:
                stats[c, label, 1] /= stats[c, label, 0]
                stats[c, label, 2] /= stats[c, label, 0]


@compiled
def _toward(lenses, stats, radius, face, position):  # type: ignore[no-untyped-def]
    """Move a position (3,) [m] in place so that it projects to the centroids of stats (C, 7, 3).

    It moves by at most 0.8 radii along each axis. face: the most of the object that a colour can show [m²];
    one that shows more counts less, since something else has it, too.
    """
    jacobian, matrix = np.empty((2, 3)), np.zeros((3, 3))
    vector, step = np.zeros(3), np.empty(3)
    for i in range(3):
        # A prior of 0.45 radii, against measurements of one pixel.
        matrix[i, i] = 5.0 / radius**2
    for c in range(len(stats)):
        n, su, sv = 0.0, 0.0, 0.0
        u, v, z = project_with_jacobian(lenses, c, position[0], position[1], position[2], jacobian)
        most = face * lenses[c].focal[0] * lenses[c].focal[1] / z**2
        for label in range(1, 7):
            count = stats[c, label, 0]
            count *= min(1.0, most / max(count, 1.0)) ** 2
            n += count
            su += count * stats[c, label, 1]
            sv += count * stats[c, label, 2]
        if n < 1:
            continue
        weight = min(n, 100.0) / 100.0
        du, dv = su / n - u, sv / n - v
        for i in range(3):
            vector[i] += weight * (jacobian[0, i] * du + jacobian[1, i] * dv)
            for k in range(3):
                matrix[i, k] += weight * (jacobian[0, i] * jacobian[0, k] + jacobian[1, i] * jacobian[1, k])
    solve_positive(matrix, vector, step)
    for i in range(3):
        position[i] += min(0.8 * radius, max(-0.8 * radius, step[i]))


@compiled
def next_place(points, votes, lenses, labels, pictures, sizes, position):  # type: ignore[no-untyped-def]
    """Put the best point into a position (3,), remove those near it, and centre it; return its vote.

    A centred point projects to the centroids of the face-coloured pixels around it.
    """
    radius, face = sizes
    best = _take_best(points, votes, 2.0 * SEPARATION * radius, position)
    stats = np.empty((len(pictures), 7, 3))
    for _ in range(CENTRING_ROUNDS):
        gather(lenses, labels, pictures, position, radius, stats)
        _toward(lenses, stats, radius, face, position)
    return best


def _grid(arena: Arena, step: float) -> FloatArray:
    """Grid points (N, 3) over the arena [m]."""
    bottom, top = arena.lowest, arena.ground + arena.height
    share = 4 * arena.radius**2 / MOST_POINTS
    step = max(step, share**0.5)  # as far apart as in a single layer
    step = max(step, (share * (top - bottom + step)) ** (1 / 3))
    # In floating point, a low arena may end where it begins.
    across, up = math.ceil(2 * arena.radius / step), max(1, math.ceil((top - bottom) / step))
    side = (np.arange(across) - (across - 1) / 2) * step
    heights = (bottom + top) / 2 + (np.arange(up) - (up - 1) / 2) * step
    x, y, z = np.meshgrid(side, side, heights, indexing="ij")
    # At least one column is always inside, even if it is about as wide as the arena.
    inside = np.hypot(x, y) <= max(arena.radius, 0.71 * step)
    return np.stack([x[inside] + arena.center[0], y[inside] + arena.center[1], z[inside]], axis=-1)


class PositionSearch:
    """Find candidate positions of an object in an arena; cameras: of the label maps."""

    def __init__(self, cameras: Sequence[Camera], box: Box, arena: Arena) -> None:
        self.lenses, self.radius = stack_lenses(cameras), box.radius
        self.points = _grid(arena, GRID_STEP * self.radius)
        # Cauchy: the mean projected area of a convex body is a quarter of its surface.
        half = box.half
        area = 2 * (half[0] * half[1] + half[1] * half[2] + half[2] * half[0])
        self._cameras, self._area = cameras, area
        self._sizes = self.radius, 4.0 * float(np.sort(half)[1:].prod())
        self.boxes = self.boxes_at(self.points)
        # Twice what a face shows in each camera at the nearest place: itself, and as much beside it.
        least = self.boxes["share"].min(axis=0, where=self.boxes["share"] > 0, initial=1.0)
        self._most = (2.0 * self._sizes[1] / (area * least)).tolist()

    def boxes_at(self, points: FloatArray) -> Array:
        """(N, C) of BOXES around points (N, 3) [m]."""
        one = [_boxes(camera, points, self.radius, self._area) for camera in self._cameras]
        return np.stack(one, axis=1)

    def floods(self, labels: Array, pictures: Array) -> list[tuple[int, int]]:
        """Cameras and colours of which a label map (C, h, w) shows much more than a face can: a table's."""
        found = []
        for c, colored in enumerate(pictures["colored"].tolist()):
            if colored > self._most[c]:
                counts = np.bincount(labels[c].ravel(), minlength=UNKNOWN)[1:UNKNOWN]
                found += [(c, k + 1) for k in np.flatnonzero(counts > self._most[c]).tolist()]
        return found

    def views(self, labels: Array, pictures: Array) -> Array:
        """Return `view_points` (N, C) of label maps (C, h, w) of pictures (C,) of PICTURE."""
        views = np.empty(self.boxes.shape, np.float32)
        view_points(labels, self.lenses, pictures, self.boxes, views)
        return views

    def __call__(self, views: Array, labels: Array, pictures: Array, most: int) -> Iterator[FloatArray]:
        """Up to `most` centred positions (3,) [m], from `views` and label maps (C, h, w).

        Cameras that pictures (C,) of PICTURE leaves out do not count.
        Best first; each is computed when it is asked for.
        """
        votes = np.empty(len(self.points), np.float32)
        least = max(MIN_VOTE, RELATIVE_VOTE * vote(views, pictures, votes))
        separation = SEPARATION * self.radius
        found: list[FloatArray] = []
        while len(found) < most:
            position = np.empty(3)
            if next_place(self.points, votes, self.lenses, labels, pictures, self._sizes, position) < least:
                return
            if all(math.dist(position, other) > separation for other in found):
                found.append(position)
                yield position


def _boxes(camera: Camera, points: FloatArray, radius: float, area: float) -> Array:
    """(N,) of BOXES of one camera for points (N, 3) [m]; area: mean projected area of the object [m²]."""
    boxes = np.zeros(len(points), BOXES)
    depth = points @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    pixels, size = camera.project_in_view(points), np.array([camera.width, camera.height])
    seen = (depth > 1.5 * radius) & ((pixels >= 0) & (pixels < size)).all(axis=1)
    pixels, focal = pixels[seen], camera.matrix[(0, 1), (0, 1)] / depth[seen, None]
    for name, share in (("wide", 1.0), ("tight", TIGHT)):
        reach = share * radius * focal
        boxes[name][seen, :2] = np.clip(np.rint((pixels - reach) / CELL), 0, size // CELL)
        boxes[name][seen, 2:] = np.clip(np.rint((pixels + reach + 1) / CELL), 0, size // CELL)
    boxes["share"][seen] = 1.0 / np.maximum(area * focal.prod(axis=1), 1.0)
    return boxes
