"""Maps between a calibrated camera's pixels and a wide pinhole view without distortion.

Each pixel is sampled on a lattice of points. Their rays come from OpenCV's inverse of the lens, iterated
to convergence. The tracker's own projection is not used.
"""

import dataclasses
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np

from synthetic.render.raster import PinholeView
from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera

_MARGIN_PX = 2
"""Margin of the view beyond the outermost ray [px], so that interpolation stays inside the view."""

_TOLERANCE_PX = 1e-6


class Lens:
    """A camera's lens at a given supersampling: the view to render, and the map from it to the image."""

    def __init__(self, camera: Camera, supersampling: int) -> None:
        """Set the points per pixel along each axis: 1 is fast, 2 the default, 3 or 4 for the best images."""
        self.camera = camera
        self.supersampling = supersampling
        lens = camera.width, camera.height, camera.matrix.tobytes(), camera.distortion.tobytes()
        view, self._map_x, self._map_y = _tables(camera.name, *lens, supersampling)
        self.view = dataclasses.replace(view, camera_from_world=camera.camera_from_world)
        """The view to render: all rays of the image, `supersampling` times as fine as the image."""

    def to_camera(
        self, layer: Array, mode: Literal["mean", "label"], stretch: FloatArray | None = None
    ) -> Array:
        """Resample a layer (h, w, …) of `view` to the camera's pixels (H, W, …).

        `stretch` (channels,), for means only, magnifies each channel by its factor about the principal
        point.

        Modes:
            mean: the mean over the pixel's square, as float32; for colours, and for the coverage of masks.
            label: the most frequent label among the pixel's points, the smallest in a tie; as uint8.
        """
        s, size = self.supersampling, (self.camera.height, self.camera.width)
        if mode == "mean":
            layer = layer.astype(np.float32, copy=False)
            if stretch is None:
                fine = cv2.remap(layer, self._map_x, self._map_y, cv2.INTER_LINEAR)
            else:
                channels = [
                    cv2.remap(np.ascontiguousarray(layer[..., c]), *self._stretched(one), cv2.INTER_LINEAR)
                    for c, one in enumerate(stretch.tolist())
                ]
                fine = np.dstack(channels)
            return fine if s == 1 else np.asarray(cv2.resize(fine, size[::-1], interpolation=cv2.INTER_AREA))
        fine = cv2.remap(layer.astype(np.uint8, copy=False), self._map_x, self._map_y, cv2.INTER_NEAREST)
        if s == 1:
            return np.asarray(fine)
        return _most_frequent(fine.reshape(size[0], s, size[1], s))

    def _stretched(self, size: float) -> tuple[Array, Array]:
        """Return the maps (x, y) into the view for an image magnified by `size` about the principal point."""
        if size == 1.0:
            return self._map_x, self._map_y
        height, width = self._map_x.shape
        center = (self.camera.matrix[:2, 2] + 0.5) * self.supersampling - 0.5
        x, y = (
            (middle + (np.arange(count) - middle) / size).astype(np.float32)
            for middle, count in zip(center, (width, height), strict=True)
        )
        # Points less than one pixel beyond the border take the border's value.
        grid = np.broadcast_to(x, (height, width)).copy(), np.broadcast_to(y[:, None], (height, width)).copy()
        maps = (
            np.asarray(cv2.remap(part, *grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
            for part in (self._map_x, self._map_y)
        )
        return next(maps), next(maps)


@lru_cache(maxsize=8)
def _tables(
    name: str, width: int, height: int, matrix: bytes, distortion: bytes, s: int
) -> tuple[PinholeView, Array, Array]:
    """Return the view of a lens, independent of the camera's pose, and the maps from the image into it.

    The view holds s × s rays per pixel, evenly spread over its square, at s times the image's resolution.
    The maps are x and y in the view for each point of the image, (H s, W s) float32 [px].
    """
    own = np.frombuffer(matrix).reshape(3, 3)
    columns, rows = ((np.arange(count * s) + 0.5) / s - 0.5 for count in (width, height))
    lattice = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = rays_of(name, lattice, own, np.frombuffer(distortion)).reshape(height * s, width * s, 2)
    focal = own[0, 0] * s, own[1, 1] * s
    pixels = rays * np.array(focal)
    low = np.floor(pixels.min(axis=(0, 1))) - _MARGIN_PX
    across, down = (np.ceil(pixels.max(axis=(0, 1))) + _MARGIN_PX - low + 1).astype(int).tolist()
    x, y = (-low).tolist()
    places = (pixels - low).astype(np.float32)
    view = PinholeView(across, down, *focal, x, y, np.eye(4))
    return view, places[..., 0].copy(), places[..., 1].copy()


def rays_of(name: str, pixels: Array, matrix: Array, distortion: Array) -> FloatArray:
    """Return normalised coordinates (N, 2) of pixels (N, 2) of the camera `name`, iterated to convergence.

    matrix (3, 3) and distortion (5,) to (14,) are those of `Camera`.

    Raises:
        CalibrationError: the lens model cannot be inverted at some of the pixels.
    """
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-11)
    if hasattr(cv2, "undistortPointsIter"):  # until OpenCV 5, undistortPoints takes no criteria
        rays = cv2.undistortPointsIter(pixels[:, None], matrix, distortion, np.eye(3), np.eye(3), criteria)
    else:
        rays = cv2.undistortPoints(pixels[:, None], matrix, distortion, criteria=criteria)
    result: FloatArray = rays.reshape(-1, 2)
    error = np.abs(seen_at(result, matrix, distortion) - pixels).max()
    if not error < _TOLERANCE_PX:
        raise CalibrationError(
            f"{name}: the lens has no inverse all over the image: found a residual of {error:.2g} px, "
            f"expected less than {_TOLERANCE_PX:g}"
        )
    return result


def seen_at(rays: Array, matrix: Array, distortion: Array) -> FloatArray:
    """Project rays (N, 2) to pixels (N, 2) by OpenCV's model, without the derivatives of `projectPoints`."""
    if len(distortion) > 5:  # rare, so the derivatives do not matter
        ahead = np.insert(rays, 2, 1.0, axis=1)
        pixels, _ = cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), matrix, distortion)
        return np.asarray(pixels.reshape(-1, 2), np.float64)
    x, y = rays[:, 0], rays[:, 1]
    k1, k2, p1, p2, k3 = distortion
    squared = x * x + y * y
    radial = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
    twice = 2.0 * x * y
    bent_x = x * radial + p1 * twice + p2 * (squared + 2.0 * x * x)
    bent_y = y * radial + p1 * (squared + 2.0 * y * y) + p2 * twice
    return np.stack([matrix[0, 0] * bent_x + matrix[0, 2], matrix[1, 1] * bent_y + matrix[1, 2]], axis=1)


def _most_frequent(blocks: Array) -> Array:
    """Return the most frequent value (H, W) of each block; blocks (H, s, W, s) uint8."""
    height, s, width, _ = blocks.shape
    values = blocks.transpose(0, 2, 1, 3).reshape(height, width, s * s)
    out = values[..., 0].copy()
    mixed = (values != values[..., :1]).any(axis=-1)
    rows = values[mixed]
    counts = (rows[:, :, None] == rows[:, None, :]).sum(axis=-1)
    # In a tie the smallest value wins: background (0) before a label.
    best = np.where(counts == counts.max(axis=1, keepdims=True), rows, 255).min(axis=1, initial=255)
    out[mixed] = best
    return np.asarray(out)
