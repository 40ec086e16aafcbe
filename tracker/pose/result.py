"""What the tracker answers: a pose with its uncertainty, or none with the reason."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3


class Status(enum.Enum):
    """Why there is a pose, or none."""

    FOUND = "found"
    """The object was found; see the pose's confidence."""
    NO_OBJECT_COLORS = "no object colours"
    """No camera shows a patch in the colours of the object's faces."""
    TOO_FEW_PIXELS = "too few pixels"
    """Face colours are in view, but too little of the object to fix a pose."""
    INCONSISTENT_VIEWS = "inconsistent views"
    """Face colours are in view, but no pose above the table explains them in the cameras together. With a
    pose, over time: the cameras contradict each other lastingly; the calibration is not to be trusted."""
    POOR_FIT = "poor fit"
    """A pose explains the colours, but the edges do not lie where it puts them."""
    OTHER_OBJECT = "other object"
    """What is there has other colours or another shape: another object, or pictures in RGB for BGR."""
    AMBIGUOUS = "ambiguous"
    """Two different poses explain the images about equally well."""
    TRACKING = "tracking"
    """Over time: the object was seen where it was expected."""
    REFOUND = "refound"
    """Over time: the object was found again, or somewhere else than expected."""
    COASTING = "coasting"
    """Over time: the object is not seen now; the filtered pose is predicted from before."""
    LOST = "lost"
    """Over time: the object was seen too long ago, or never."""


class CameraUse(str, enum.Enum):
    """What became of one camera's picture."""

    USED = "used"
    """The pose comes from it too, as far as the object is in view; or there is no pose."""
    CONTRADICTING = "contradicting"
    """It shows the object somewhere else or otherwise, or was left out since the others agree without it."""
    NO_IMAGE = "no image"
    """It gave none."""
    FROZEN = "frozen"
    """It is the same as before down to its noise, while others change."""
    BLACK = "black"
    """It is black."""


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """Pose of the object in the world, with its uncertainty. Arrays are read-only.

    The covariance is of (δp, δθ) with p = position + δp and R = exp(δθ) · rotation, both along world
    axes [m, rad].
    """

    position: FloatArray
    """(3,) the object's centre in the world [m]."""
    orientation: FloatArray
    """(4,) unit quaternion x, y, z, w of world_from_object."""
    covariance: FloatArray
    """(6, 6) of position and rotation [m, rad]; calibration errors included as far as their size is known."""
    confidence: float
    """Probability that the pose is within 5 mm and 5° of the truth."""

    def __post_init__(self) -> None:
        for key, shape in (("position", (3,)), ("orientation", (4,)), ("covariance", (6, 6))):
            array = np.array(getattr(self, key), dtype=np.float64).reshape(shape)
            array.flags.writeable = False
            object.__setattr__(self, key, array)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation of world_from_object."""
        return so3.matrix_from_quaternion(self.orientation)

    @property
    def world_from_object(self) -> FloatArray:
        """(4, 4) transform from the object's frame to the world's."""
        transform = np.eye(4)
        transform[:3, :3] = self.rotation
        transform[:3, 3] = self.position
        return transform

    def as_json(self) -> dict[str, Any]:
        """Position, orientation, covariance and confidence as plain lists and numbers."""
        return {
            "position": self.position.tolist(),
            "orientation": self.orientation.tolist(),
            "covariance": self.covariance.tolist(),
            "confidence": float(self.confidence),
        }


@dataclass(frozen=True, eq=False)
class MotionEstimate(PoseEstimate):
    """Pose and velocity of the object in the world, fused over time."""

    velocity: FloatArray
    """(6,) of the centre [m/s] and of the rotation [rad/s], along world axes."""
    velocity_covariance: FloatArray
    """(6, 6) of the velocity."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, shape in (("velocity", (6,)), ("velocity_covariance", (6, 6))):
            array = np.array(getattr(self, key), dtype=np.float64).reshape(shape)
            array.flags.writeable = False
            object.__setattr__(self, key, array)


@dataclass(frozen=True, eq=False)
class Forecast(MotionEstimate):
    """Pose and velocity at a later moment: the covariance is that of the likely kinds of motion."""

    kinds: tuple[MotionKind, ...] = ()
    """What each kind of motion leads to, the likeliest first."""


@dataclass(frozen=True, eq=False)
class MotionKind(MotionEstimate):
    """The same if the object's motion is of one kind; the confidence holds if it is."""

    name: str
    """Of the kind: "at rest", "pushed or carried", "thrown or dropped"."""
    probability: float
    """That the motion is of this kind."""


@dataclass(frozen=True, eq=False)
class Observation:
    """The answer to one set of images."""

    object_pose: PoseEstimate | None
    """The pose measured in these images, or None: then `status` says why."""
    filtered_object_pose: MotionEstimate | None
    """Prediction and measurement fused over time; None where there is no memory (`detect`), or it is lost."""
    status: Status
    """Why there is a pose, or none."""
    timing_ms: dict[str, float] = field(default_factory=dict)
    """Wall-clock time of each stage [ms]."""
    reason: Status | None = None
    """Over time, where nothing was measured: why these images by themselves gave no pose."""
    cameras: tuple[CameraUse, ...] = ()
    """What became of each camera's picture, in the order of the rig."""
