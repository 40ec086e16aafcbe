"""The pinhole camera with lens distortion.

The model is OpenCV's, with 5, 8, 12 or 14 coefficients of distortion: p_camera = camera_from_world · p_world,
and from normalised coordinates x = X/Z, y = Y/Z with r² = x² + y²:
    radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    x' = x radial + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
    y' = y radial + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴
If the sensor is tilted by τx, τy, the homography of `tilt` is applied to (x', y'). The pixel is
    u = fx x' + cx, v = fy y' + cy.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from tracker.checks import Frozen, float_rows, is_whole
from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError, TrackerError, shown
from tracker.geometry import so3

COUNTS = (5, 8, 12, 14)
"""Numbers of coefficients: k1 k2 p1 p2 k3, k4 k5 k6, s1 s2 s3 s4, τx τy."""

ROTATION_TOLERANCE = 1e-6
"""Largest |R Rᵀ - I| of a camera's rotation R."""

MAX_SIZE = 32767
"""Largest width and height [px]: OpenCV's remapping stores coordinates in 16 bits."""

FARTHEST, BENT = 1e4, 1e6
"""Largest absolute coordinate of a translation [m] or standard deviation, and distortion coefficient."""

FOCAL, CENTER = (1e-2, 1e6), 1e6
"""Bounds of a focal length, and largest absolute coordinate of a principal point [px], which may lie outside
a cropped image."""

_NAME = re.compile(r"[\w-]([\w. -]{0,98}[\w-])?")
"""Pattern of a valid camera name: names become parts of file names and are shown in pages."""

_IN_FILES = {"matrix": "camera_matrix", "width": "image_width", "height": "image_height"}
"""Names of a camera's fields in files, for messages."""

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
class Camera(Frozen):
    """One calibrated camera. Arrays are copied and read-only.

    Attributes:
        name: e.g. `camera60`; up to 100 letters, digits, '_' and '-', with '.' and ' ' in between.
        width: image width [px].
        height: image height [px].
        matrix: (3, 3) `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]` [px]; pixel centres are at whole numbers.
        distortion: (5,) k1, k2, p1, p2, k3; or (8,), (12,), (14,) with k4 … k6, s1 … s4, τx and τy appended.
        camera_from_world: (4, 4) rigid transform, p_camera = camera_from_world · p_world [m].
        camera_from_world_std: (4, 4) element-wise standard deviations of `camera_from_world`, or None if
            unknown.

    Raises:
        CalibrationError: a parameter has the wrong shape, is not finite, or is impossible.
    """

    name: str
    width: int
    height: int
    matrix: FloatArray
    distortion: FloatArray
    camera_from_world: FloatArray
    camera_from_world_std: FloatArray | None = None

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
            worst = std.min() if std.min() < 0 else std.max()
            valid = f"standard deviations from 0 to {FARTHEST:g}"
            self._require(0 <= worst <= FARTHEST, "camera_from_world_std", f"{worst:g}", valid)
            object.__setattr__(self, "camera_from_world_std", std)
        self._check_lens()
        self._check_transform()

    def __repr__(self) -> str:
        place = " ".join(f"{value:.3f}" for value in self.position)
        focal = f"{self.matrix[0, 0]:.1f}, {self.matrix[1, 1]:.1f}"
        return f"Camera({self.name!r}: {self.width}×{self.height} px, f {focal} px, at {place} m)"

    def _require(self, holds: object, key: str, found: str, valid: str) -> None:
        if not holds:
            raise self._error(key, found, valid)

    def _error(self, key: str, found: str, valid: str) -> CalibrationError:
        key = _IN_FILES.get(key, key)
        return CalibrationError(f"{self.name}: {key}: found {found}, expected {valid}")

    def _size(self, key: str, value: Any) -> int:
        valid = f"a whole number of pixels from 1 to {MAX_SIZE}"
        self._require(is_whole(value) and 0 < value <= MAX_SIZE, key, shown(value), valid)
        return int(value)

    def _array(self, key: str, value: object, *shapes: tuple[int, ...]) -> FloatArray:
        valid = " or ".join(map(str, shapes))
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise self._error(key, type(value).__name__, f"numbers of shape {valid}") from error
        self._require(array.shape in shapes, key, f"shape {array.shape}", f"shape {valid}")
        self._require(np.isfinite(array).all(), key, "values that are not finite", "finite numbers")
        array.flags.writeable = False
        return array

    def _check_lens(self) -> None:
        (fx, right, cx), (down, fy, cy), last = self.matrix.tolist()
        bent = np.abs(self.distortion).max()
        both = f"both from {FOCAL[0]:g} to {FOCAL[1]:g} px"
        within = FOCAL[0] <= min(fx, fy) and max(fx, fy) <= FOCAL[1]
        self._require(within, "matrix", f"focal lengths {fx:g}, {fy:g}", both)
        near, center = f"at most {CENTER:g} px from the image", f"principal point {cx:g}, {cy:g}"
        self._require(max(abs(cx), abs(cy)) <= CENTER, "matrix", center, near)
        self._require(bent <= BENT, "distortion", f"{bent:g}", f"coefficients of at most {BENT:g}")
        self._require(right == down == 0, "matrix", f"skew {right:g}, {down:g}", "no skew")
        self._require(last == [0, 0, 1], "matrix", f"last row {last}", "[0, 0, 1]")

    def _check_transform(self) -> None:
        key, last = "camera_from_world", self.camera_from_world[3].tolist()
        self._require(last == [0, 0, 0, 1], key, f"last row {last}", "[0, 0, 0, 1]")
        away = np.abs(self.camera_from_world[:3, 3]).max()
        self._require(away <= FARTHEST, key, f"a translation by {away:g} m", f"at most {FARTHEST:g} m")
        what = f"{self.name}: {key}"
        check_rotation(self.camera_from_world[:3, :3], ROTATION_TOLERANCE, what, CalibrationError)

    @property
    def world_from_camera(self) -> FloatArray:
        """(4, 4) inverse of `camera_from_world`."""
        return so3.transform(self.camera_from_world[:3, :3].T, self.position)

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


def check_rotation(matrix: Array, most: float, what: str, fault: type[TrackerError]) -> float:
    """Return how far a transform's 3×3 part M is from a rotation: max |M Mᵀ - I|, or infinity if det M ≤ 0.

    Raise `fault`, which names `what`, if that is above `most`.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        deviation = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
        if np.dot(np.cross(matrix[0], matrix[1]), matrix[2]) <= 0 or not np.isfinite(deviation):
            deviation = float("inf")
    if deviation > most:
        found = f"a 3×3 part that deviates from a rotation by {deviation:.2g}"
        inverted = ": its determinant is not positive; is an axis inverted?" if np.isinf(deviation) else ""
        raise fault(f"{what}: found {found}, expected at most {most:g}{inverted}")
    return deviation


def all_coefficients(coefficients: FloatArray) -> FloatArray:
    """Return all 14 coefficients, with 0 for those not given."""
    result = np.zeros(COUNTS[-1])
    result[: len(coefficients)] = coefficients
    return result


def tilt(coefficients: FloatArray) -> FloatArray:
    """Return the homography (3, 3) from distorted coordinates to the tilted sensor; identity if untilted."""
    angles = all_coefficients(coefficients)[12:]
    (sx, sy), (cx, cy) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    turned = about_y @ about_x
    (_, _, a), (_, _, b), (_, _, c) = turned
    return np.asarray(np.array([[c, 0, -a], [0, c, -b], [0, 0, 1]]) @ turned)


def distort(normalized: FloatArray, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distorted coordinates (N, 2) of normalised ones (N, 2), and their derivatives (N, 2, 2)."""
    k1, k2, p1, p2, k3 = coefficients[:5]
    x, y = normalized[:, 0], normalized[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial/dx = x · slope
    if len(coefficients) > 5:
        k4, k5, k6 = coefficients[5:8]
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        slope = (slope - radial * 2 * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / below
    bent = np.empty_like(normalized)
    bent[:, 0] = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent[:, 1] = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    derivative = np.empty((len(normalized), 2, 2))
    derivative[:, 0, 0] = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    derivative[:, 1, 1] = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    derivative[:, 0, 1] = derivative[:, 1, 0] = x * y * slope + 2 * p1 * x + 2 * p2 * y
    if len(coefficients) > 8:
        s1, s2, s3, s4 = coefficients[8:12]
        bent += np.stack([r2 * (s1 + r2 * s2), r2 * (s3 + r2 * s4)], axis=1)
        along = 2 * np.stack([s1 + 2 * r2 * s2, s3 + 2 * r2 * s4], axis=1)
        derivative += along[:, :, None] * normalized[:, None, :]
    if len(coefficients) > 12:
        homography = tilt(coefficients)
        seen = bent @ homography[:, :2].T + homography[:, 2]
        bent = seen[:, :2] / seen[:, 2:]
        rows = homography[:2, :2] - bent[:, :, None] * homography[2, :2]
        derivative = (rows / seen[:, 2, None, None]) @ derivative
    return bent, derivative


def undistort(target: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Invert `distort` for targets (N, 2) by Newton's method; NaN if it finds no solution before the fold."""
    solution, tolerance = target.copy(), 1e-12
    with np.errstate(all="ignore"):  # diverging rows become NaN
        for _ in range(30):
            value, slope = distort(solution, coefficients)
            error = value - target
            (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
            determinant = a * d - b * c
            solution[:, 0] -= (d * error[:, 0] - b * error[:, 1]) / determinant
            solution[:, 1] -= (a * error[:, 1] - c * error[:, 0]) / determinant
            if np.abs(error).max(initial=0) < tolerance:
                break
        good = (np.abs(error).max(axis=1) < 100 * tolerance) & (determinant > 0) & (a + d > 0)
        for share in np.linspace(0.05, 0.95, 19):  # Newton's method may leap over the fold
            _, slope = distort(share * solution, coefficients)
            (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
            good &= a * d > b * c
    solution[~good] = np.nan
    return solution
