"""Size of the object in each image; lengths in pixels are stated for a reference size."""

import functools
import math
from collections.abc import Sequence

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.arena import Arena
from tracker.geometry.camera import Camera
from tracker.geometry.lens import clamped, project
from tracker.objects.model import Box

REFERENCE = 55.0
"""Size in the image for which lengths are stated [px]: a little more than that of the platform's objects at
270×270."""

LEAST_SIZE = 0.6
"""Smallest size relative to the reference: below it, strips would have too few pixels."""

LABELS = 25.0
"""Size of the object in the label maps that search and alignment use [px]."""

THIN = 4.2
"""Largest size of a box relative to a narrow edge: label maps and strips that suit the longest edge of a more
slender one would be coarser and wider than its narrow faces."""

WINDOW_RIM = 12.0
"""Margin around the expected object, which may have moved differently [px of the label map]."""


@compiled
def extent(half, narrow):  # type: ignore[no-untyped-def]
    """One length [m] for the size of a box, between its longest edge and its diagonal; less for a thin box.

    Their geometric mean agrees to within 4 % for a cube of 65 mm and a cuboid of 20 × 20 × 80 mm, for which
    the same lengths suit the refinement. narrow: half the edge that must still be resolved [m].
    """
    radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    size = math.sqrt(2.0 * max(half[0], half[1], half[2]) * 2.0 * radius)
    return min(size, THIN * 2.0 * narrow)


@compiled
def relative_size(lenses, c, half, position):  # type: ignore[no-untyped-def]
    """Size of the object at a position (3,) [m] in camera c's image, relative to the reference.

    This is equation (3) of docs/how-it-works.md.
    """
    lens, size = lenses[c], extent(half, min(half[0], half[1], half[2]))
    depth = lens.translation[2]
    for i in range(3):
        depth += lens.rotation[2, i] * position[i]
    focal = math.sqrt(lens.focal[0] * lens.focal[1])
    return max(LEAST_SIZE, focal * size / max(depth, size) / REFERENCE)


def label_factors(cameras: Sequence[Camera], box: Box, arena: Arena) -> tuple[int, ...]:
    """Return the whole number by which each camera's images are reduced for label maps.

    An object in the arena's middle then has about the size LABELS.
    """
    middle = np.array([*arena.center, arena.ground + box.half.min()])
    # Not finer for a plate: more pixels of its wide faces would count as more evidence.
    factors, length = [], extent(box.half, np.sort(box.half)[1])
    for camera in cameras:
        depth = float(camera.camera_from_world[2, :3] @ middle + camera.camera_from_world[2, 3])
        focal = math.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
        size = focal * length / max(depth, length)
        # Label maps narrower than 16 pixels would show nothing.
        most = max(1, min(camera.width, camera.height) // 16)
        factors.append(min(most, max(1, round(size / LABELS))))
    return tuple(factors)


@functools.lru_cache(maxsize=32)
def label_camera(camera: Camera, factor: int) -> Camera:
    """The camera of label maps reduced by a factor; incomplete pixels are left out.

    Each part of an estimator asks for it, and finding how far it sees takes a millisecond.
    """
    width, height = camera.width // factor, camera.height // factor
    return camera.cropped(0, 0, width * factor, height * factor).resized(width, height)


@compiled
def window(lenses, c, position, radius):  # type: ignore[no-untyped-def]
    """Return left, top, right, bottom around an object of a radius [m] that is expected at (3,) [m]."""
    width, height = lenses[c].width, lenses[c].height
    u, v, z = project(lenses, c, position[0], position[1], position[2])
    if z < 2.0 * radius:
        return 0, 0, width, height
    reach = 1.3 * radius * max(lenses[c].focal[0], lenses[c].focal[1]) / (z - radius) + WINDOW_RIM
    left, top = clamped(u - reach, width), clamped(v - reach, height)
    right, bottom = clamped(u + reach + 1.0, width), clamped(v + reach + 1.0, height)
    return left, top, right, bottom
