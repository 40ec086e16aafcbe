"""Poses of many frames, one array per quantity: recorded, measured, and filtered over time.

Rows of frames without a pose are all NaN, so that no stale pose can be mistaken for a valid one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np

from tracker.checks import Frozen, described, float_array, freeze
from tracker.conventions import Array, FloatArray
from tracker.errors import LogError
from tracker.geometry import so3

UNIT_TOLERANCE = 1e-6
"""Largest deviation of a quaternion's length from 1."""

COVARIANCE_TOLERANCE = 1e-6
"""Largest asymmetry, and magnitude of a negative eigenvalue, of a covariance scaled to a unit diagonal."""

Columns = TypeVar("Columns", bound="PoseColumns")


@dataclass(frozen=True, eq=False)
class PoseColumns(Frozen):
    """Poses stored in a recording. Arrays are copied and read-only.

    `columns[rows]` are those of the frames that a slice, a mask or an array of row numbers selects.

    Raises:
        LogError: an array has the wrong shape or type, a row with a pose is not finite or not valid, or a
            row without one is not NaN.
    """

    has_pose: Array
    """(n,) bool: whether the frame has a pose."""
    position: FloatArray
    """(n, 3) the object's centre in the world [m]."""
    orientation: FloatArray
    """(n, 4) unit quaternions x, y, z, w of world_from_object."""
    confidence: FloatArray
    """(n,) for measured and filtered poses: the probability that the pose is within 5 mm and 5° of the
    truth; for recorded poses: the recording's own value, NaN if it has none."""

    ROW_SHAPES: ClassVar[dict[str, tuple[int, ...]]] = {
        "position": (3,),
        "orientation": (4,),
        "confidence": (),
    }
    """Shape of each column except `has_pose` in one frame."""
    MAY_BE_UNKNOWN: ClassVar[tuple[str, ...]] = ("confidence",)
    """Columns that may be NaN in rows with a pose."""

    def __post_init__(self) -> None:
        has_pose = np.array(self.has_pose)
        if has_pose.dtype != np.bool_ or has_pose.ndim != 1:
            raise LogError(f"has_pose: found {described(has_pose)}, expected bool of shape (n,)")
        freeze(self, "has_pose", has_pose)
        for name, row_shape in self.ROW_SHAPES.items():
            shape = (len(has_pose), *row_shape)
            column = float_array(getattr(self, name), shape, name, LogError, finite=False)
            freeze(self, name, column)
            axes = tuple(range(1, column.ndim))
            unknown, good = np.isnan(column).all(axis=axes), np.isfinite(column).all(axis=axes)
            if name in self.MAY_BE_UNKNOWN:
                good |= unknown
            refuse(name, has_pose & ~good, column, "finite numbers where has_pose is true")
            refuse(name, ~has_pose & ~unknown, column, "NaN where has_pose is false")
            if row_shape == (6, 6):
                _check_covariance(name, has_pose, column)
        with np.errstate(over="ignore"):
            length = np.linalg.norm(self.orientation, axis=1)
        bad = has_pose & ~(np.abs(length - 1) <= UNIT_TOLERANCE)
        refuse("orientation", bad, self.orientation, "a quaternion of length 1")
        if "confidence" not in self.MAY_BE_UNKNOWN:
            bad = has_pose & ~((self.confidence >= 0) & (self.confidence <= 1))
            refuse("confidence", bad, self.confidence, "a probability from 0 to 1")

    def __len__(self) -> int:
        return len(self.has_pose)

    @property
    def rotation(self) -> FloatArray:
        """(n, 3, 3) rotations of world_from_object; NaN without a pose."""
        return so3.matrix_from_quaternion(self.orientation)

    def arrays(self) -> dict[str, Array]:
        """Return all columns by name, `has_pose` first."""
        return {name: getattr(self, name) for name in ("has_pose", *self.ROW_SHAPES)}

    def __getitem__(self: Columns, rows: Any) -> Columns:
        return type(self)(**{name: column[rows] for name, column in self.arrays().items()})

    @classmethod
    def nothing(cls: type[Columns], count: int) -> Columns:
        """Return `count` frames without a pose."""
        rows = {name: np.full((count, *shape), np.nan) for name, shape in cls.ROW_SHAPES.items()}
        return cls(has_pose=np.zeros(count, np.bool_), **rows)

    @classmethod
    def joined(cls: type[Columns], parts: Sequence[Columns]) -> Columns:
        """Concatenate the frames of all parts; there must be at least one part."""
        arrays = [part.arrays() for part in parts]
        return cls(**{name: np.concatenate([part[name] for part in arrays]) for name in arrays[0]})


@dataclass(frozen=True, eq=False)
class MeasuredColumns(PoseColumns):
    """Poses measured in the images of each single frame."""

    covariance: FloatArray
    """(n, 6, 6) covariance of (δp, δθ), p = position + δp, R = exp(δθ) · rotation, in world axes [m, rad]."""

    ROW_SHAPES: ClassVar[dict[str, tuple[int, ...]]] = {**PoseColumns.ROW_SHAPES, "covariance": (6, 6)}
    MAY_BE_UNKNOWN: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True, eq=False)
class FilteredColumns(MeasuredColumns):
    """Poses fused over time, with the object's velocity."""

    velocity: FloatArray
    """(n, 6) linear [m/s] and angular [rad/s], both along world axes."""
    velocity_covariance: FloatArray
    """(n, 6, 6) covariance of `velocity` [m/s, rad/s]."""

    ROW_SHAPES: ClassVar[dict[str, tuple[int, ...]]] = {
        **MeasuredColumns.ROW_SHAPES,
        "velocity": (6,),
        "velocity_covariance": (6, 6),
    }


def refuse(name: str, bad: Array, column: Array, valid: str) -> None:
    """Raise a LogError that shows the first row of `column` where `bad` (n,) is true, if there is one."""
    if bad.any():
        row = int(np.argmax(bad))
        found = " ".join(f"{value:g}" for value in column[row].ravel()[:6])
        more = " …" if column[row].size > 6 else ""
        raise LogError(f"{name}: row {row}: found {found}{more}, expected {valid}")


def _check_covariance(name: str, has_pose: Array, column: FloatArray) -> None:
    covariance = np.where(has_pose[:, None, None], column, np.eye(6))
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    # Scale to a unit diagonal, so that one tolerance suits metres and radians of any magnitude.
    with np.errstate(all="ignore"):
        factor = 1 / np.sqrt(np.where(variance > 0, variance, 1))
        scaled = covariance * factor[:, :, None] * factor[:, None, :]
        asymmetry = np.abs(scaled - scaled.swapaxes(1, 2)).max(axis=(1, 2), initial=0)
        usable = np.all(variance >= 0, axis=1) & np.all(np.isfinite(scaled), axis=(1, 2))
    refuse(name, ~usable, column, "variances that are not negative")
    refuse(name, asymmetry > COVARIANCE_TOLERANCE, column, "a symmetric matrix")
    least = np.linalg.eigvalsh((scaled + scaled.swapaxes(1, 2)) / 2).min(axis=1, initial=np.inf)
    refuse(name, least < -COVARIANCE_TOLERANCE, column, "a positive semi-definite matrix")
