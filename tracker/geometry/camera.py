"""The pinhole camera with lens distortion.

The model is OpenCV's: p_camera = camera_from_world · p_world, x = X/Z, y = Y/Z, (x', y') by
`geometry.distortion`, u = fx x' + cx, v = fy y' + cy.
"""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import numpy.typing as npt

from tracker.checks import float_rows, is_whole
from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError, TrackerError, shown
from tracker.geometry.distortion import COUNTS, distort, undistort

ROTATION_TOLERANCE = 1e-6
"""Largest |R Rᵀ - I| of a camera's rotation R."""

MAX_SIZE = 32767
"""Largest width and height [px]: OpenCV's remapping stores coordinates in 16 bits."""

FARTHEST = 1e4
"""Largest absolute coordinate of a camera's translation [m], and largest standard deviation."""

FOCAL, CENTER = (1e-2, 1e6), 1e6
"""Bounds of a focal length, and largest absolute coordinate of a principal point [px], which may lie outside
a cropped image."""

BENT = 1e6
"""Largest absolute distortion coefficient."""

_NAME = re.compile(r"[\w-]([\w. -]{0,98}[\w-])?")
"""Pattern of a valid camera name: names become parts of file names and are shown in pages."""

VIEW = 1.2
"""Points are in view up to this multiple of the largest tangent of the image's rays; beyond it, distortion
may fold them back into the image."""


def may_be_name(name: object) -> bool:
    """Whether this is a valid camera name."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def check_name(name: object, what: str, fault: type[TrackerError]) -> None:
    """Raise `fault`, with a message that begins with `what`, if this is not a valid camera name."""
    if not may_be_name(name):
        raise fault(
            f"{what}: found {shown(name)}, expected a name of up to 100 letters, digits, "
            "'_' and '-', with '.' and ' ' in between"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera. Arrays are copied and read-only.

    Raises:
        CalibrationError: a parameter has the wrong shape, is not finite, or is impossible.
    """

    name: str
    """Name, e.g. `camera60`: up to 100 letters, digits, '_' and '-', with '.' and ' ' in between."""
    width: int
    """Image width [px]."""
    height: int
    """Image height [px]."""
    matrix: FloatArray
    """(3, 3) `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]` [px]; pixel centres are at whole numbers."""
    distortion: FloatArray
    """(5,) k1, k2, p1, p2, k3; or (8,), (12,), (14,) with k4 … k6, s1 … s4, τx and τy appended."""
    camera_from_world: FloatArray
    """(4, 4) rigid transform, p_camera = camera_from_world · p_world [m]."""
    camera_from_world_std: FloatArray | None = None
    """(4, 4) element-wise standard deviations of `camera_from_world`, or None if unknown."""

    def __post_init__(self) -> None:
        check_name(self.name, "camera_name", CalibrationError)
        for key in ("width", "height"):
            object.__setattr__(self, key, self._size(key, getattr(self, key)))
        for key, shape in (("matrix", (3, 3)), ("camera_from_world", (4, 4))):
            object.__setattr__(self, key, self._array(key, getattr(self, key), shape))
        lens = [(count,) for count in COUNTS]
        object.__setattr__(self, "distortion", self._array("distortion", self.distortion, *lens))
        if self.camera_from_world_std is not None:
            std = self._array("camera_from_world_std", self.camera_from_world_std, (4, 4))
            if std.min() < 0 or std.max() > FARTHEST:
                worst = std.min() if std.min() < 0 else std.max()
                valid = f"standard deviations from 0 to {FARTHEST:g}"
                raise self._error("camera_from_world_std", f"{worst:g}", valid)
            object.__setattr__(self, "camera_from_world_std", std)
        self._check_matrix()
        self._check_transform()

    def __repr__(self) -> str:
        place = " ".join(f"{value:.3f}" for value in self.position)
        focal = f"{self.matrix[0, 0]:.1f}, {self.matrix[1, 1]:.1f}"
        return f"Camera({self.name!r}: {self.width}×{self.height} px, f {focal} px, at {place} m)"

    def _error(self, key: str, found: str, valid: str) -> CalibrationError:
        key = "camera_matrix" if key == "matrix" else key  # its name in files
        return CalibrationError(f"{self.name}: {key}: found {found}, expected {valid}")

    def _size(self, key: str, value: object) -> int:
        if not is_whole(value) or not 0 < value <= MAX_SIZE:
            raise self._error(key, shown(value), f"a whole number of pixels from 1 to {MAX_SIZE}")
        return int(value)

    def _array(self, key: str, value: object, *shapes: tuple[int, ...]) -> FloatArray:
        valid = " or ".join(map(str, shapes))
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise self._error(key, type(value).__name__, f"numbers of shape {valid}") from error
        if array.shape not in shapes:
            raise self._error(key, f"shape {array.shape}", f"shape {valid}")
        if not np.isfinite(array).all():
            raise self._error(key, "values that are not finite", "finite numbers")
        array.flags.writeable = False
        return array

    def _check_matrix(self) -> None:
        fx, fy = self.matrix[0, 0], self.matrix[1, 1]
        if min(fx, fy) < FOCAL[0] or max(fx, fy) > FOCAL[1]:
            valid = f"both from {FOCAL[0]:g} to {FOCAL[1]:g} px"
            raise self._error("matrix", f"focal lengths {fx:g}, {fy:g}", valid)
        if np.abs(self.matrix[:2, 2]).max() > CENTER:
            found = f"principal point {self.matrix[0, 2]:g}, {self.matrix[1, 2]:g}"
            raise self._error("matrix", found, f"at most {CENTER:g} px from the picture")
        if np.abs(self.distortion).max() > BENT:
            found = f"{np.abs(self.distortion).max():g}"
            raise self._error("distortion", found, f"coefficients of at most {BENT:g}")
        if self.matrix[0, 1] != 0 or self.matrix[1, 0] != 0:
            raise self._error("matrix", f"skew {self.matrix[0, 1]:g}, {self.matrix[1, 0]:g}", "no skew")
        if (self.matrix[2] != (0, 0, 1)).any():
            raise self._error("matrix", f"last row {self.matrix[2].tolist()}", "[0, 0, 1]")

    def _check_transform(self) -> None:
        if (self.camera_from_world[3] != (0, 0, 0, 1)).any():
            found = f"last row {self.camera_from_world[3].tolist()}"
            raise self._error("camera_from_world", found, "[0, 0, 0, 1]")
        if np.abs(self.camera_from_world[:3, 3]).max() > FARTHEST:
            found = f"a translation by {np.abs(self.camera_from_world[:3, 3]).max():g} m"
            raise self._error("camera_from_world", found, f"at most {FARTHEST:g} m")
        deviation = rotation_deviation(self.camera_from_world[:3, :3])
        if deviation > ROTATION_TOLERANCE:
            found = f"a 3×3 part that deviates from a rotation by {deviation:.2g}"
            raise self._error("camera_from_world", found, f"at most {ROTATION_TOLERANCE:g}")

    @property
    def world_from_camera(self) -> FloatArray:
        """(4, 4) inverse of `camera_from_world`."""
        out = np.eye(4)
        out[:3, :3] = self.camera_from_world[:3, :3].T
        out[:3, 3] = self.position
        return out

    @property
    def position(self) -> FloatArray:
        """(3,) centre of projection in the world [m]."""
        return -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]

    def project(self, points_world: npt.ArrayLike) -> FloatArray:
        """Project world points (N, 3) [m] to pixels (N, 2); NaN for points not in front of the camera.

        As in OpenCV, distortion folds points far outside the image back into it (beyond about 40° off the
        axis with the platform's lenses): `project_in_view` returns NaN there.
        """
        return self.project_with_jacobian(points_world)[0]

    def project_with_jacobian(self, points_world: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Like `project`: pixels (N, 2) of world points (N, 3) [m], and derivatives (N, 2, 3) [px/m]."""
        in_camera = self._in_camera(points_world)
        in_camera[in_camera[:, 2] <= 0] = np.nan
        normalized = in_camera[:, :2] / in_camera[:, 2:]
        distorted, lens = distort(normalized, self.distortion)
        perspective = np.zeros((len(in_camera), 2, 3))
        perspective[:, 0, 0] = perspective[:, 1, 1] = 1
        perspective[:, :, 2] = -normalized
        perspective /= in_camera[:, 2, None, None]
        focal, center = self.matrix[(0, 1), (0, 1)], self.matrix[:2, 2]
        jacobian = focal[:, None] * (lens @ perspective @ self.camera_from_world[:3, :3])
        return distorted * focal + center, jacobian

    @functools.cached_property
    def largest_tangent(self) -> float:
        """Largest tangent of the angle between the optical axis and the rays of the image's border."""
        columns, rows = (np.linspace(-0.5, count - 0.5, 9) for count in (self.width, self.height))
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        tangents = np.linalg.norm(self.undistort(pixels), axis=1)
        return float(tangents[np.isfinite(tangents)].max(initial=0.0))

    def project_in_view(self, points_world: npt.ArrayLike) -> FloatArray:
        """Like `project`, but NaN also for points far outside the field of view."""
        points = float_rows(points_world, 3, f"{self.name}: points", CalibrationError).copy()
        in_camera = self._in_camera(points)
        tangent = np.hypot(in_camera[:, 0], in_camera[:, 1])
        points[~(tangent < VIEW * self.largest_tangent * in_camera[:, 2])] = np.nan
        return self.project(points)

    def undistort(self, pixels: npt.ArrayLike) -> FloatArray:
        """Return undistorted normalised coordinates (N, 2) = (X/Z, Y/Z) of pixels (N, 2), to about 1e-12.

        NaN for pixels that no ray reaches before the distortion folds. On this platform that affects only
        a few pixels in the corners of uncropped 720×540 images.
        """
        focal, center = self.matrix[(0, 1), (0, 1)], self.matrix[:2, 2]
        target = (float_rows(pixels, 2, f"{self.name}: pixels", CalibrationError) - center) / focal
        return undistort(target, self.distortion)

    def rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Return unit directions (N, 3) in the world of the rays from the camera through pixels (N, 2)."""
        normalized = self.undistort(pixels)
        directions = np.concatenate([normalized, np.ones((len(normalized), 1))], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return directions @ self.camera_from_world[:3, :3]

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the camera for an image cropped to `width` × `height`; its first pixel is (left, top)."""
        matrix = self.matrix.copy()
        matrix[:2, 2] -= self._array("left and top", (left, top), (2,))
        return dataclasses.replace(self, width=width, height=height, matrix=matrix)

    def resized(self, width: int, height: int) -> Camera:
        """Return the camera for an image scaled to `width` × `height` by `cv2.resize`.

        Pixel centres are at whole numbers, so c' = (c + ½) s - ½ and f' = f s along each axis.
        """
        width, height = self._size("width", width), self._size("height", height)
        scale = np.array([width / self.width, height / self.height])
        matrix = self.matrix.copy()
        matrix[(0, 1), (0, 1)] *= scale
        matrix[:2, 2] = (matrix[:2, 2] + 0.5) * scale - 0.5
        return dataclasses.replace(self, width=width, height=height, matrix=matrix)

    def with_halved_principal_point_corrected(self) -> Camera:
        """Return the camera with its principal point corrected, for files made by halving K[:2].

        Halving an image moves it to c/2 - ¼; the platform's `*_cropped_and_downsampled.yml` have c/2.
        """
        matrix = self.matrix.copy()
        matrix[:2, 2] -= 0.25
        return dataclasses.replace(self, matrix=matrix)

    def _in_camera(self, points_world: npt.ArrayLike) -> FloatArray:
        points = float_rows(points_world, 3, f"{self.name}: points", CalibrationError)
        return points @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]


def rotation_deviation(matrix: Array) -> float:
    """Return how far a matrix (3, 3) is from a rotation: max |M Mᵀ - I|, or infinity if det M ≤ 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        deviation = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
        mirrored = bool(np.dot(np.cross(matrix[0], matrix[1]), matrix[2]) <= 0)
    return float("inf") if mirrored or not np.isfinite(deviation) else deviation
