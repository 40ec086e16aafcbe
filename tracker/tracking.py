"""What is remembered from one set of images to the next, and what is believed of the next one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import TrackerError
from tracker.pose.acceptance import VAGUE, confidence, probably_near, trust
from tracker.pose.contour import INLIERS
from tracker.pose.fit import Fit
from tracker.pose.motion import MotionFilter, MotionState, quaternion
from tracker.pose.result import MotionEstimate, Observation, PoseEstimate, Status

MIN_VIEW = 4.0
"""Weight of the pieces of edges on which a camera must agree to count as seeing the object."""


@dataclass(frozen=True)
class TrackingOptions:
    """When an object is believed to be where."""

    coast_seconds: float = 0.5
    """For so long after it was last seen its pose is predicted [s]; then it is lost."""
    jump: tuple[float, float] = (0.04, math.radians(45))
    """Difference from the prediction [m, rad] beyond which a measurement is implausible, …"""
    speed: tuple[float, float] = (0.8, math.radians(400))
    """… plus so much for every second since the object was last seen [m/s, rad/s]."""
    sure: float = 0.95
    """Confidence from which an implausible measurement is believed at once; else another must agree."""
    alone: float = 0.3
    """Share of these limits where one camera alone sees the object, which may take depth for turn, …"""
    lonely: float = 0.8
    """… and the probability that it is right to 20 mm and 5°, without which it is not believed then."""
    agree: tuple[float, float] = (0.02, math.radians(15))
    """Difference of two measurements that agree [m, rad], plus half of `speed` for every second between."""


@dataclass(frozen=True, eq=False)
class _Pending:
    """A measurement that nobody has confirmed yet."""

    timestamp: float
    position: FloatArray
    rotation: FloatArray


class Track:
    """The memory of one object's motion."""

    def __init__(self, options: TrackingOptions | None = None) -> None:
        self.options = options or TrackingOptions()
        self.timestamp: float | None = None
        """Of the last images [s]."""
        self.latest: Observation | None = None
        """The last answer."""
        self.last_pose: tuple[FloatArray, FloatArray] | None = None
        """Rotation (3, 3) and position (3,) [m] as last measured."""
        self._filter = MotionFilter()
        self._seen: float | None = None
        self._trust = 0.0
        self._pending: _Pending | None = None
        self._step = 0.0

    @property
    def alive(self) -> bool:
        """Whether there is a pose to predict from."""
        return self._seen is not None

    def advance(self, timestamp: float) -> MotionState | None:
        """Move on to the images of a time stamp [s]; returns where the object is expected, if it is known.

        Raises:
            TrackerError: the stamp is not finite, or earlier than the last one.
        """
        if not math.isfinite(timestamp):
            raise TrackerError(f"timestamp: found {timestamp}, expected a finite number of seconds")
        if self.timestamp is not None and timestamp < self.timestamp:
            raise TrackerError(
                f"timestamp: found {timestamp:.6f} s after {self.timestamp:.6f} s, expected no earlier one; "
                "reset() begins another recording"
            )
        last, self.timestamp = self.timestamp, float(timestamp)
        self._step = 0.0 if last is None else self.timestamp - last
        if self._seen is None or last is None:
            return None
        if timestamp - self._seen > self.options.coast_seconds:
            self._seen = None
            self._pending = None
            return None
        if self.last_unseen:
            self._filter.slow_down(timestamp - last)
        self._filter.predict(timestamp - last)
        return self._filter.state

    @property
    def last_unseen(self) -> bool:
        """Whether the object was not seen in the last images."""
        return self.latest is not None and self.latest.object_pose is None

    def plausible(self, expected: MotionState, fit: Fit) -> bool:
        """Whether a measurement may come from an object that was expected there."""
        shift, turn = _differences(fit, expected.rotation, expected.position)
        share = self.options.alone if alone(fit) else 1.0
        return all(
            difference <= share * (limit + speed * self._seconds_unseen)
            for difference, limit, speed in zip(
                (shift, turn), self.options.jump, self.options.speed, strict=True
            )
        )

    def see(self, fit: Fit, expected: MotionState | None) -> Status:
        """Take in a measurement; returns TRACKING, FOUND, REFOUND, or COASTING if it is not believed yet."""
        assert self.timestamp is not None
        if alone(fit) and trust(fit) * probably_near(fit.covariance, VAGUE) < self.options.lonely:
            return Status.COASTING
        if expected is not None and self.plausible(expected, fit):
            self._filter.update(fit.position, fit.rotation, fit.covariance)
            return self._believe(fit, Status.TRACKING)
        sure = confidence(fit) >= self.options.sure
        # Nothing turns over on the spot so fast: poor colours mislead in one image after the other.
        if expected is None or not self._turned_over(expected, fit):
            sure = sure or self._confirmed(fit)
        if expected is not None and not sure:
            self._pending = _Pending(self.timestamp, fit.position, fit.rotation)
            return Status.COASTING
        first = self.last_pose is None
        self._filter.start(fit.position, fit.rotation, fit.covariance)
        return self._believe(fit, Status.FOUND if first else Status.REFOUND)

    @property
    def _seconds_unseen(self) -> float:
        """For so long the object may have moved without being seen [s]."""
        assert self.timestamp is not None
        assert self._seen is not None
        # Images that showed it elsewhere are none in which it was hidden, and could go far unseen.
        return self._step if self._pending is not None else self.timestamp - self._seen

    def _turned_over(self, expected: MotionState, fit: Fit) -> bool:
        """Whether a measurement is where the object was expected, but turned over."""
        shift, turn = _differences(fit, expected.rotation, expected.position)
        most = 3.0 * self.options.jump[1] + self.options.speed[1] * self._seconds_unseen
        return shift < self.options.jump[0] and turn > most

    def _believe(self, fit: Fit, status: Status) -> Status:
        self._seen, self._pending, self._trust = self.timestamp, None, trust(fit)
        self.last_pose = fit.rotation, fit.position
        return status

    def _confirmed(self, fit: Fit) -> bool:
        """Whether the measurement that was not believed is now seen a second time."""
        if self._pending is None or self.timestamp is None:
            return False
        seconds = self.timestamp - self._pending.timestamp
        shift, turn = _differences(fit, self._pending.rotation, self._pending.position)
        return all(
            difference <= limit + 0.5 * speed * seconds
            for difference, limit, speed in zip(
                (shift, turn), self.options.agree, self.options.speed, strict=True
            )
        )

    def estimate(self) -> MotionEstimate | None:
        """The fused estimate; None while the object is lost."""
        if self._seen is None:
            return None
        state = self._filter.state
        pose = state.covariance[:6, :6]
        return MotionEstimate(
            state.position,
            quaternion(state.rotation),
            pose,
            self._trust * probably_near(pose),
            state.velocity,
            state.covariance[6:, 6:],
        )


def _differences(fit: Fit, rotation: FloatArray, position: FloatArray) -> tuple[float, float]:
    """Distance [m] and angle [rad] of a fit from a pose, good enough to compare with limits."""
    cosine = (float(np.vdot(fit.rotation, rotation)) - 1.0) / 2.0
    shift = float(np.linalg.norm(fit.position - position))
    return shift, math.acos(min(1.0, max(-1.0, cosine)))


def alone(fit: Fit) -> bool:
    """Whether the pose rests on what one camera sees."""
    return bool(np.count_nonzero(fit.samples[:, INLIERS] >= MIN_VIEW) < 2)


def measured(fit: Fit) -> PoseEstimate:
    """The pose of a fit."""
    return PoseEstimate(fit.position, quaternion(fit.rotation), fit.covariance, confidence(fit))
