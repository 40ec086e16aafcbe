"""Results: a pose with its uncertainty, or the reason why there is none."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from tracker.checks import Frozen, float_array
from tracker.conventions import FloatArray
from tracker.errors import TrackerError
from tracker.geometry import cuboid, so3


class Word(str, enum.Enum):
    """An enum of texts: its value appears in comparisons, f-strings, `str()` and JSON."""

    __str__ = str.__str__


class Status(Word):
    """Why there is a pose, or why not; a text such as "found"."""

    FOUND = "found"
    """The object was found; see the pose's confidence."""
    NO_OBJECT_COLORS = "no_object_colors"
    """No camera shows a patch in the colours of the object's faces."""
    TOO_FEW_PIXELS = "too_few_pixels"
    """Face colours are in view, but too few pixels to determine a pose."""
    INCONSISTENT_VIEWS = "inconsistent_views"
    """Face colours are in view, but no pose in the arena explains them in all cameras. With a
    pose: the cameras contradict each other, so do not trust the calibration."""
    POOR_FIT = "poor_fit"
    """A pose explains the colours, but not the edges."""
    OTHER_OBJECT = "other_object"
    """Something with other colours or another shape is there: another object, or RGB instead of BGR."""
    AMBIGUOUS = "ambiguous"
    """Two different poses explain the images about equally well, or the pose is too uncertain."""
    TRACKING = "tracking"
    """Over time: the object was seen where it was expected."""
    REFOUND = "refound"
    """Over time: the object was found again, or in an unexpected place."""
    COASTING = "coasting"
    """Over time: the object is not seen, or not accepted yet; the filtered pose is a prediction."""
    LOST = "lost"
    """Over time: the object has been unseen for too long, or was never seen."""


class CameraUse(Word):
    """How one camera's image was used; a text such as "used"."""

    USED = "used"
    """It contributed to the pose, if there is one and the object is in view."""
    CONTRADICTING = "contradicting"
    """It shows the object elsewhere or differently, or was left out because the others agree without it."""
    NO_IMAGE = "no_image"
    """There was no image."""
    FROZEN = "frozen"
    """It is identical to the one before, noise included, while others change."""
    BLACK = "black"
    """It is black."""


@dataclass(frozen=True, eq=False)
class PoseEstimate(Frozen):
    """Pose of the object in the world, with its uncertainty. Arrays are read-only.

    The covariance is of (δp, δθ) with p = position + δp and R = exp(δθ) · rotation, both along world
    axes [m, rad].

    Attributes:
        position: (3,) the object's centre in the world [m].
        orientation: (4,) unit quaternion x, y, z, w of world_from_object.
        covariance: (6, 6) of position and rotation [m, rad]; includes the calibration errors that files state
            and, if they state any, the errors that disagreement between the cameras reveals.
        confidence: probability that the pose is within 5 mm and 5° of the truth.
        size: (3,) the object's edge lengths [m]; None if unknown, as in files of poses.
    """

    position: FloatArray
    orientation: FloatArray
    covariance: FloatArray
    confidence: float
    size: FloatArray | None = field(default=None, kw_only=True)

    _SHAPES: ClassVar = {"position": (3,), "orientation": (4,), "covariance": (6, 6), "size": (3,)}

    def __post_init__(self) -> None:
        for key, shape in self._SHAPES.items():
            given = getattr(self, key)
            if given is not None or key != "size":
                array = float_array(given, shape, f"pose: {key}", TrackerError, finite=False)
                object.__setattr__(self, key, array)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation of world_from_object."""
        return so3.matrix_from_quaternion(self.orientation)

    @property
    def world_from_object(self) -> FloatArray:
        """(4, 4) transform from the object's frame to the world's."""
        return so3.transform(self.rotation, self.position)

    @property
    def keypoints(self) -> FloatArray:
        """(8, 3) the object's corners in the world [m], in the order of the platform's data sets.

        Corner i is on the + side of the object's x, y, z where bit 0, 1, 2 of i is 0.

        Raises:
            TrackerError: the pose does not know the object's size.
        """
        return cuboid.keypoints(self.position, self.rotation, self._known_size())

    @property
    def keypoint_covariances(self) -> FloatArray:
        """(8, 3, 3) covariance of each corner [m²], along world axes: J Σ Jᵀ with J = [I, -[R s]×].

        Raises:
            TrackerError: the pose does not know the object's size.
        """
        lever = cuboid.keypoints(np.zeros(3), self.rotation, self._known_size())
        jacobian = np.concatenate([np.tile(np.eye(3), (8, 1, 1)), -so3.hat(lever)], axis=-1)
        return np.asarray(jacobian @ self.covariance @ np.swapaxes(jacobian, -1, -2))

    def _known_size(self) -> FloatArray:
        if self.size is None:
            raise TrackerError(
                "keypoints: found a pose without the object's size, as of files, expected one of a tracker; "
                "tracker.tasks.move_object.keypoints(position, orientation, size) takes the size"
            )
        return self.size

    def __repr__(self) -> str:
        std = np.sqrt(np.diag(self.covariance))
        place, off = (" ".join(f"{1e3 * value:.2f}" for value in part) for part in (self.position, std[:3]))
        turn = " ".join(f"{value:.4f}" for value in self.orientation)
        turned = " ".join(f"{value:.2f}" for value in np.degrees(std[3:]))
        return (
            f"{type(self).__name__}(position {place} ± {off} mm, orientation xyzw {turn} ± {turned}°, "
            f"{self._more()}confidence {self.confidence:.3f})"
        )

    def _more(self) -> str:
        return ""

    def as_json(self) -> dict[str, Any]:
        """Position, orientation, covariance and confidence as plain lists and numbers."""
        return {
            "position": self.position.tolist(),
            "orientation": self.orientation.tolist(),
            "covariance": self.covariance.tolist(),
            "confidence": float(self.confidence),
        }


@dataclass(frozen=True, eq=False, repr=False)
class MotionEstimate(PoseEstimate):
    """Pose and velocity of the object in the world, fused over time.

    Attributes:
        velocity: (6,) linear, of the centre [m/s], and angular [rad/s], along world axes.
        velocity_covariance: (6, 6) of the velocity.
    """

    velocity: FloatArray
    velocity_covariance: FloatArray

    _SHAPES = PoseEstimate._SHAPES | {"velocity": (6,), "velocity_covariance": (6, 6)}

    def _more(self) -> str:
        speed, turning = np.linalg.norm(self.velocity.reshape(2, 3), axis=1)
        return f"{1e3 * speed:.0f} mm/s, {np.degrees(turning):.0f} °/s, "


@dataclass(frozen=True, eq=False, repr=False)
class Forecast(MotionEstimate):
    """Pose and velocity at a later moment.

    The covariance is that of the likely kinds of motion if they continue; the confidence allows for changes.

    Attributes:
        kinds: the forecast for each kind of motion, the likeliest first.
    """

    kinds: tuple[MotionKind, ...] = ()

    def _more(self) -> str:
        kinds = "".join(f"{kind.name} {kind.probability:.2f}, " for kind in self.kinds)
        return super()._more() + kinds


@dataclass(frozen=True, eq=False, repr=False)
class MotionKind(MotionEstimate):
    """A forecast that assumes one kind of motion; so does its confidence.

    Attributes:
        name: name of the kind: "at rest", "pushed or carried", "thrown or dropped".
        probability: probability of this kind of motion.
    """

    name: str
    probability: float

    def _more(self) -> str:
        return f"{super()._more()}{self.name} {self.probability:.2f}, "


@dataclass(frozen=True, eq=False)
class Observation:
    """The result for one set of images.

    Attributes:
        object_pose: the pose measured in these images, or None; `status` says why.
        filtered_object_pose: prediction and measurement fused over time; None from `detect`, which has no
            memory, or if lost.
        status: why there is a pose, or why not.
        timing_ms: wall-clock time of each stage [ms].
        reason: from `update` without `object_pose`: why none was measured or accepted; AMBIGUOUS may also
            mean that it is not confirmed yet. From `detect`, with a pose: INCONSISTENT_VIEWS if the cameras
            contradict each other, which makes their calibration doubtful.
        cameras: how each camera's image was used, in the order of the rig.
    """

    object_pose: PoseEstimate | None
    filtered_object_pose: MotionEstimate | None
    status: Status
    timing_ms: dict[str, float] = field(default_factory=dict)
    reason: Status | None = None
    cameras: tuple[CameraUse, ...] = ()

    def __repr__(self) -> str:
        poses = [repr(pose) for pose in (self.object_pose, self.filtered_object_pose) if pose is not None]
        reason = "" if self.reason is None else f", since {self.reason}"
        time = f"; {self.timing_ms['total']:.1f} ms" if "total" in self.timing_ms else ""
        seen = f"; cameras {', '.join(self.cameras)}" if self.cameras else ""
        lines = ",\n            ".join(poses) or "no pose"
        return f"Observation({self.status}{reason}{seen}{time};\n            {lines})"
