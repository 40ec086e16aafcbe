"""The arena: where the object's centre may be, and where the table is in the world."""

import dataclasses
import math
from typing import Any

import numpy as np

from tracker.checks import is_number
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError, shown
from tracker.geometry.camera import FARTHEST

LARGEST = 10.0
"""Largest radius and height [m]: a larger value is probably in millimetres."""

LARGEST_STD = 1.0, 1.6
"""Largest standard deviations of a table [m, rad]: larger ones are probably in millimetres or degrees."""

SLACK = 2.0
"""Tolerance of the arena's bounds, in standard deviations of the table's height."""


@dataclasses.dataclass(frozen=True)
class Arena:
    """The region where the object's centre may be: a vertical cylinder on the table. Numbers become floats.

    Attributes:
        center: x and y of the cylinder's axis in the world [m].
        radius: largest horizontal distance of the object's centre from the axis [m].
        height: largest height of the object's centre above the table [m]; without a table, bound of |z|.
        table: z of the table in the world, at the axis [m]; None: there is no table.
        table_std: standard deviations of the table's height [m] and of its tilt about any horizontal axis
            [rad].

    Raises:
        CalibrationError: a value has the wrong type, is not finite, or is impossible.
    """

    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.235
    height: float = 0.185
    table: float | None = 0.0
    table_std: tuple[float, float] = (0.008, 0.017)

    def __post_init__(self) -> None:
        for key in ("center", "table_std"):
            object.__setattr__(self, key, _pair(key, getattr(self, key)))
        for key in ("radius", "height") if self.table is None else ("radius", "height", "table"):
            object.__setattr__(self, key, _number(key, getattr(self, key), "a finite number"))
        for key in ("radius", "height"):
            if not 0 < getattr(self, key) <= LARGEST:
                raise _error(key, getattr(self, key), f"more than 0 and at most {LARGEST:g} metres")
        for key, away in (("center", math.hypot(*self.center)), ("table", abs(self.ground))):
            if away > FARTHEST:
                valid = f"at most {FARTHEST:g} metres from the world's origin"
                raise _error(key, getattr(self, key), valid)
        if not all(0 <= std <= most for std, most in zip(self.table_std, LARGEST_STD, strict=True)):
            valid = "standard deviations from 0 to {:g} metre and {:g} rad".format(*LARGEST_STD)
            raise _error("table_std", self.table_std, valid)

    @property
    def ground(self) -> float:
        """World z from which heights are measured [m]: the table's, or 0 without a table."""
        return 0.0 if self.table is None else self.table

    @property
    def lowest(self) -> float:
        """Smallest z at which the object is searched [m], given the table's uncertainty."""
        return -self.height if self.table is None else self.table - SLACK * self.table_std[0]

    def holds(self, position: FloatArray, lowest: float, height_std: float = 0.0) -> bool:
        """Whether an object with its lowest corner at z = `lowest` [m] may be at a position (3,) [m].

        height_std: standard deviation of these heights [m].
        """
        away = math.hypot(position[0] - self.center[0], position[1] - self.center[1])
        slack = SLACK * math.hypot(self.table_std[0], min(away, self.radius) * self.table_std[1], height_std)
        high = position[2] <= self.ground + self.height + slack
        bottom, least = (position[2], -self.height) if self.table is None else (lowest, self.table)
        return bool(bottom >= least - slack and high and away <= self.radius + slack)


def _error(key: str, found: object, valid: str) -> CalibrationError:
    return CalibrationError(f"arena: {key}: found {shown(found)}, expected {valid}")


def _pair(key: str, value: Any) -> tuple[float, float]:
    valid = "two finite numbers"
    values = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(values, (list, tuple)) or len(values) != 2:
        raise _error(key, value, valid)
    return _number(key, values[0], valid), _number(key, values[1], valid)


def _number(key: str, value: Any, valid: str) -> float:
    if not is_number(value):
        raise _error(key, value, valid)
    return float(value)
