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
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tracker.checks import Frozen, float_rows, is_whole
from tracker.compiled import compiled
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
        distorted, slope = distort(normalized, self._lens)
        perspective = np.zeros((len(in_camera), 2, 3))
        perspective[:, 0, 0] = perspective[:, 1, 1] = 1
        perspective[:, :, 2] = -normalized
        perspective /= in_camera[:, 2, None, None]
        focal, center = self.matrix[(0, 1), (0, 1)], self.matrix[:2, 2]
        jacobian = focal[:, None] * (slope @ perspective @ self.camera_from_world[:3, :3])
        return distorted * focal + center, jacobian

    @functools.cached_property
    def _lens(self) -> Distortion:
        return Distortion.of(self.distortion)

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
        return undistort(target, self._lens)

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


class Distortion(NamedTuple):
    """The distortion of a lens."""

    coefficients: FloatArray
    """(14,) all coefficients, 0 for those not given."""
    tilt: FloatArray
    """(3, 3) homography of the tilted sensor."""
    plain: bool
    """Whether only the first five coefficients are not 0."""

    @classmethod
    def of(cls, coefficients: FloatArray) -> Distortion:
        """Return the lens with these coefficients."""
        every = np.zeros(COUNTS[-1])
        every[: len(coefficients)] = coefficients
        return cls(every, tilt(every), not every[5:].any())


def tilt(coefficients: FloatArray) -> FloatArray:
    """Return the homography (3, 3) from distorted coordinates to the tilted sensor, of (14,) coefficients."""
    angles = coefficients[12:]
    (sx, sy), (cx, cy) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    turned = about_y @ about_x
    (_, _, a), (_, _, b), (_, _, c) = turned
    return np.asarray(np.array([[c, 0, -a], [0, c, -b], [0, 0, 1]]) @ turned)


@compiled
def bent(lens, a, b):  # type: ignore[no-untyped-def]
    """Distort (a, b); return (u, v, ua, ub, va, vb), coordinates and derivatives.

    lens: with the fields of Distortion.
    """
    k, tilt, s = lens.coefficients, lens.tilt, a * a + b * b
    radial = 1.0 + s * (k[0] + s * (k[1] + s * k[4]))
    slope = k[0] + s * (2.0 * k[1] + s * 3.0 * k[4])
    if not lens.plain:
        below = 1.0 + s * (k[5] + s * (k[6] + s * k[7]))
        radial /= below
        slope = (slope - radial * (k[5] + s * (2.0 * k[6] + s * 3.0 * k[7]))) / below
    x = a * radial + 2.0 * k[2] * a * b + k[3] * (s + 2.0 * a * a)
    y = b * radial + k[2] * (s + 2.0 * b * b) + 2.0 * k[3] * a * b
    mixed = 2.0 * a * b * slope + 2.0 * k[2] * a + 2.0 * k[3] * b
    xa = radial + 2.0 * a * a * slope + 2.0 * k[2] * b + 6.0 * k[3] * a
    yb = radial + 2.0 * b * b * slope + 6.0 * k[2] * b + 2.0 * k[3] * a
    if lens.plain:
        return x, y, xa, mixed, mixed, yb
    prism_x, prism_y = 2.0 * (k[8] + 2.0 * s * k[9]), 2.0 * (k[10] + 2.0 * s * k[11])
    x, y = x + s * (k[8] + s * k[9]), y + s * (k[10] + s * k[11])
    xa, xb, ya, yb = xa + prism_x * a, mixed + prism_x * b, mixed + prism_y * a, yb + prism_y * b
    w = 1.0 / (tilt[2, 0] * x + tilt[2, 1] * y + tilt[2, 2])
    u = (tilt[0, 0] * x + tilt[0, 1] * y + tilt[0, 2]) * w
    v = (tilt[1, 0] * x + tilt[1, 1] * y + tilt[1, 2]) * w
    ux, uy = (tilt[0, 0] - u * tilt[2, 0]) * w, (tilt[0, 1] - u * tilt[2, 1]) * w
    vx, vy = (tilt[1, 0] - v * tilt[2, 0]) * w, (tilt[1, 1] - v * tilt[2, 1]) * w
    return u, v, ux * xa + uy * ya, ux * xb + uy * yb, vx * xa + vy * ya, vx * xb + vy * yb


def distort(normalized: FloatArray, lens: Distortion) -> tuple[FloatArray, FloatArray]:
    """Return distorted coordinates (N, 2) of normalised ones (N, 2), and their derivatives (N, 2, 2)."""
    u, v, *derivatives = bent.py_func(lens, *normalized.T)
    return np.stack([u, v], axis=1), np.stack(derivatives, axis=1).reshape(-1, 2, 2)


def undistort(target: FloatArray, lens: Distortion) -> FloatArray:
    """Invert `distort` for targets (N, 2) by Newton's method; NaN if it finds no solution before the fold."""
    solution, tolerance = target.copy(), 1e-12
    with np.errstate(all="ignore"):  # diverging rows become NaN
        for _ in range(30):
            value, slope = distort(solution, lens)
            error = value - target
            (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
            determinant = a * d - b * c
            solution[:, 0] -= (d * error[:, 0] - b * error[:, 1]) / determinant
            solution[:, 1] -= (a * error[:, 1] - c * error[:, 0]) / determinant
            if np.abs(error).max(initial=0) < tolerance:
                break
        good = (np.abs(error).max(axis=1) < 100 * tolerance) & (determinant > 0) & (a + d > 0)
        for share in np.linspace(0.05, 0.95, 19):  # Newton's method may leap over the fold
            _, slope = distort(share * solution, lens)
            (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
            good &= a * d > b * c
    solution[~good] = np.nan
    return solution
