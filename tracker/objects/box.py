"""The object's geometry in a form for compiled functions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.objects.model import CuboidModel


class Box(NamedTuple):
    """A cuboid with labelled faces."""

    half: FloatArray
    """(3,) half edge lengths [m]."""
    face_labels: Array
    """(6,) uint8 labels in the order of tracker.geometry.cuboid.FACE_NAMES."""
    rim: tuple[float, float]
    """How far inside the nominal edges the face colours end, and the standard deviation of that [m]."""

    @classmethod
    def of(cls, model: CuboidModel) -> Box:
        """Return the box of an object model."""
        labels = np.asarray(model.face_labels, dtype=np.uint8)
        return cls(np.asarray(model.size) / 2, labels, (model.rim, model.rim_std))

    @property
    def radius(self) -> float:
        """Distance of the corners from the centre [m]."""
        return math.sqrt(self.half @ self.half)

    def lowest(self, position: FloatArray, rotation: FloatArray) -> float:
        """Return z of the lowest corner [m] at a position (3,) [m] and rotation (3, 3), world from object."""
        depths = (abs(one) * half for one, half in zip(rotation[2].tolist(), self.half.tolist(), strict=True))
        return float(position[2] - sum(depths))
