"""The motion estimate of one object from frame to frame, and which measurements may change it."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from tracker.checks import is_number
from tracker.conventions import FloatArray
from tracker.errors import TrackerError, shown
from tracker.geometry import so3
from tracker.objects.model import Box
from tracker.pose.fit import Fit
from tracker.pose.judge import alone, apparent, nearness, resting_on, trust
from tracker.pose.result import Forecast, MotionEstimate, MotionKind, PoseEstimate, Status
from tracker.tracking.motion import KINDS, MotionFilter, MotionState

ROUNDING = 5e-7
"""Error of a difference between timestamps since the epoch [s]."""

_ALONG_POSITION = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class TrackingOptions:
    """Limits within which `update` accepts a measurement.

    Attributes:
        coast_seconds: how long an unseen object is predicted [s]; after that it is lost.
        max_jump: largest plausible difference between measurement and prediction [m, rad].
        max_speed: growth of `max_jump` for each second in which the object is unseen [m/s, rad/s].
        jump_confidence: confidence at which an implausible measurement is accepted at once; below, a second
            must confirm it.
        single_camera_share: factor on these limits if only one camera sees the object, since it may confuse
            depth and rotation.
        min_confidence: smallest confidence of an accepted measurement, assuming that the calibration is
            right.
        max_disagreement: largest difference between measurements that agree [m, rad], plus half of
            `max_speed` per second.

    Raises:
        TrackerError: a value is negative or not a finite number, or `min_confidence` is above 1.
    """

    coast_seconds: float = 0.5
    max_jump: tuple[float, float] = (0.04, math.radians(45))
    max_speed: tuple[float, float] = (0.8, math.radians(400))
    jump_confidence: float = 0.95
    single_camera_share: float = 0.3
    min_confidence: float = 0.4
    max_disagreement: tuple[float, float] = (0.02, math.radians(15))

    def __post_init__(self) -> None:
        for field in fields(self):
            value, pair = getattr(self, field.name), isinstance(field.default, tuple)
            numbers = value if pair and isinstance(value, tuple | list) else (value,)
            if len(numbers) != 1 + pair or not all(is_number(number) and number >= 0 for number in numbers):
                valid = "two finite numbers that are" if pair else "a finite number that is"
                raise TrackerError(f"{field.name}: found {shown(value)}, expected {valid} not negative")
            object.__setattr__(self, field.name, tuple(value) if pair else value)
        if self.min_confidence > 1.0:
            valid = "a number that is not negative, and at most 1"
            raise TrackerError(f"min_confidence: found {shown(self.min_confidence)}, expected {valid}")


class Belief(NamedTuple):
    """The estimated motion of one object. Immutable: every method returns a new one."""

    options: TrackingOptions = TrackingOptions()
    timestamp: float | None = None
    """Timestamp of the last images [s]."""
    motion: MotionFilter | None = None
    """Pose and velocity of the object at the last images; None before it was first seen."""
    basis: MotionFilter | None = None
    """The same at the last accepted measurement, from which everything is predicted: many short predictions
    would blur the kinds of motion into each other."""
    last_pose: tuple[FloatArray, FloatArray] | None = None
    """Rotation (3, 3) and position (3,) [m] of the last accepted measurement."""
    seen: float | None = None
    """Timestamp of the last accepted measurement [s]; None: there is no pose to predict from."""
    trust: float = 0.0
    """Probability that the last measurement was of the object and that the calibration is right."""
    cameras: tuple[int, ...] = ()
    """Cameras on which that measurement rests."""
    spread: float = 0.0
    """Variance along each axis that the cameras' disagreement adds [m²]."""
    pending: tuple[float, FloatArray, FloatArray] | None = None
    """Timestamp [s], rotation (3, 3) and position (3,) [m] of an implausible measurement, if any, that waits
    for a second one to confirm it."""

    def advance(self, timestamp: float) -> tuple[Belief, MotionState | None]:
        """Predict to the timestamp [s] of the next images; return the belief then, and the motion if known.

        Raises:
            TrackerError: the timestamp is earlier than the last one.
        """
        passed, moved = self._seconds_since(timestamp), self._replace(timestamp=timestamp)
        if self.basis is None or passed is None:
            return moved._replace(seen=None, pending=None), None
        motion = self.basis.unseen(passed) if self._unseen else self.basis.predicted(passed)
        return moved._replace(motion=motion), motion.state

    def _seconds_since(self, timestamp: float) -> float | None:
        """Return how long before a timestamp [s] the object was seen [s]; None if it is lost by then."""
        if self.timestamp is not None and timestamp < self.timestamp:
            raise TrackerError(
                f"timestamp: found {timestamp:.6f} s after {self.timestamp:.6f} s, expected no earlier one; "
                "reset() starts another recording"
            )
        if self.seen is None or timestamp - self.seen > self.options.coast_seconds + ROUNDING:
            return None
        return timestamp - self.seen

    @property
    def _single(self) -> bool:
        """Whether the last accepted measurement rests on a single camera."""
        return len(self.cameras) < 2

    @property
    def _unseen(self) -> bool:
        """Whether the last images gave no accepted measurement."""
        return self.seen != self.timestamp

    def plausible(self, expected: MotionState, fit: Fit) -> bool:
        """Whether a measurement is close enough to the predicted state."""
        assert self.timestamp is not None
        assert self.seen is not None
        # If a measurement is pending, the object was visible then and cannot have gone far unseen before.
        seconds = self.timestamp - (self.seen if self.pending is None else self.pending[0])
        jump, speed = self.options.max_jump, self.options.max_speed
        share = self.options.single_camera_share if alone(fit) else 1.0
        shift, turn = (share * (jump[k] + speed[k] * seconds) for k in range(2))
        return _close(fit, expected.rotation, expected.position, shift, turn)

    def updated(
        self, fit: Fit, expected: MotionState | None, fitting: float = 1.0, spread: float = 0.0
    ) -> tuple[Belief, Status]:
        """Take in a measurement: return the new belief and TRACKING, FOUND or REFOUND; COASTING if rejected.

        Args:
            fit: the measurement.
            expected: the predicted state, if the object was known.
            fitting: probability that calibration errors leave the pose within 5 mm, see `judge.fits`.
            spread: see `agreement.spread`.
        """
        assert self.timestamp is not None
        if apparent(fit) < self.options.min_confidence:
            return self, Status.COASTING
        if self.motion is not None and expected is not None and self.plausible(expected, fit):
            others = self._single and resting_on(fit) != self.cameras
            motion = self.motion.updated(fit.position, fit.rotation, fit.covariance, others=others)
            return self._believed(fit, motion, fitting, spread), Status.TRACKING
        sure = apparent(fit) >= self.options.jump_confidence
        if expected is not None and not sure and not self._confirmed(fit):
            return self._replace(pending=(self.timestamp, fit.rotation, fit.position)), Status.COASTING
        motion = MotionFilter.start(fit.position, fit.rotation, fit.covariance)
        status = Status.FOUND if self.last_pose is None else Status.REFOUND
        return self._believed(fit, motion, fitting, spread), status

    def _believed(self, fit: Fit, motion: MotionFilter, fitting: float, spread: float) -> Belief:
        return self._replace(
            motion=motion,
            basis=motion,
            seen=self.timestamp,
            pending=None,
            trust=fitting * trust(fit),
            cameras=resting_on(fit),
            spread=spread,
            last_pose=(fit.rotation, fit.position),
        )

    def _confirmed(self, fit: Fit) -> bool:
        """Whether a fit confirms the pending measurement."""
        if self.pending is None or self.timestamp is None:
            return False
        limits, speed = self.options.max_disagreement, self.options.max_speed
        stamp, rotation, position = self.pending
        shift, turn = (limits[k] + 0.5 * speed[k] * (self.timestamp - stamp) for k in range(2))
        return _close(fit, rotation, position, shift, turn)

    def forecast(self, timestamp: float, box: Box, ground: float) -> Forecast | None:
        """Predict the object at a later timestamp [s] without images (see `advance`); None if it is lost.

        box: the object; ground: height [m] below which it is never predicted, unless last seen lower.
        """
        passed = self._seconds_since(timestamp)
        if self.basis is None or passed is None:
            return None
        if self._unseen:
            motion = changed = self.basis.unseen(passed)
            fused = motion.state
        else:
            motion, changed = self.basis.forecast(passed), self.basis.forecast(passed, changing=True)
            fused = motion.likeliest()
        near = self._near(changed, fused)
        kinds = tuple(
            MotionKind(**self._told(self._raised(state, box, ground), box), name=KINDS[k], probability=weight)
            for k, weight, state in motion.kinds()
        )
        return Forecast(**self._told(self._raised(fused, box, ground), box, near), kinds=kinds)

    def estimate(self, box: Box, ground: float) -> MotionEstimate | None:
        """Return the fused estimate; None while the object is lost. Arguments: as for `forecast`."""
        if self.seen is None or self.motion is None or self.basis is None or self.timestamp is None:
            return None
        if self._unseen:
            motion = self.basis.unseen(self.timestamp - self.seen)
            fused = motion.state
            near = self._near(motion, fused)
            return MotionEstimate(**self._told(self._raised(fused, box, ground), box, near))
        return MotionEstimate(**self._told(self.motion.state, box))

    def _near(self, motion: MotionFilter, fused: MotionState) -> float:
        """Nearness of a predicted pose: the object probably rests where it was, but may have moved far.

        motion: the object's, which may have changed its kind; fused: the state that gives the pose.
        """
        return sum(weight * nearness(spread, self._single) for weight, spread in motion.parts(fused))

    def _raised(self, state: MotionState, box: Box, ground: float) -> MotionState:
        """Return a state that is not below the ground [m] or, if lower, where the object was last seen."""
        if self.last_pose is not None:
            rotation, position = self.last_pose
            ground = min(ground, box.lowest(position, rotation))
        height = max(ground - box.lowest(state.position, state.rotation), 0.0)
        return state._replace(position=state.position + np.array([0.0, 0.0, height]))

    def _told(self, state: MotionState, box: Box, near: float | None = None) -> dict[str, Any]:
        """Return the fields of a MotionEstimate of a state; near: `nearness`, None: from the covariance."""
        pose = state.covariance[:6, :6]
        near = nearness(pose, self._single) if near is None else near
        return {
            "position": state.position,
            "orientation": so3.quaternion(state.rotation),
            "covariance": widened(pose, self.spread),
            "confidence": self.trust * near,
            "velocity": state.velocity,
            "velocity_covariance": state.covariance[6:, 6:],
            "size": 2 * box.half,
        }


def _close(fit: Fit, rotation: FloatArray, position: FloatArray, shift: float, turn: float) -> bool:
    """Whether a fit is within a distance [m] and an angle [rad] of a pose."""
    if math.dist(fit.position.tolist(), position.tolist()) > shift:
        return False
    cosine = (float(np.vdot(fit.rotation, rotation)) - 1.0) / 2.0
    return math.acos(min(1.0, max(-1.0, cosine))) <= turn


def widened(covariance: FloatArray, spread: float) -> FloatArray:
    """Add a variance [m²] along each position axis to a pose's covariance (6, 6)."""
    return covariance + spread * _ALONG_POSITION if spread > 0.0 else covariance


def measured(fit: Fit, fitting: float, spread: float, size: FloatArray) -> PoseEstimate:
    """Return a fit as a pose estimate; size: edge lengths (3,) [m]; the others are as of `Belief.updated`."""
    orientation, covariance = so3.quaternion(fit.rotation), widened(fit.covariance, spread)
    return PoseEstimate(fit.position, orientation, covariance, fitting * apparent(fit), size=size)
