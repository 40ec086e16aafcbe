"""What fingers know of the cube: the truth, poses from late images, or true ones with delay and errors."""

from collections import deque
from typing import Any

import numpy as np
from cube_pusher import Pushing

import tracker
from synthetic.camera.rigs import sized, standard_rig
from synthetic.camera.sensor import Sensor
from synthetic.look.appearance import random_lighting, random_look
from synthetic.stills import take
from synthetic.world.platform import Platform
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.live import Live, Moment, Pushed
from tracker.viz import overlay

PERIOD, DELAY = 0.1, 0.09
"""Time between sets of images, and from exposure to arrival [s], as on the platform."""

FILMED = 2
"""The film shows one in this many sets."""

ERROR_MM, ERROR_DEGREES, REPEATED = 1.4, 2.0, 0.1
"""Median errors of the platform's own tracker, and the share of its poses that repeat the previous one."""

_SIGMA = 1.538  # median length of a vector of three normal numbers, in standard deviations

Pose = tuple[FloatArray, FloatArray]
"""Position (3,) [m] and rotation (3, 3)."""


class Truth:
    """Knows where the cube is."""

    def __init__(self, *_: object) -> None: ...

    def pose(self, time: float, pushing: Pushing) -> Pose | None:
        """What is known of the cube's pose at a time [s]."""
        return pushing.truth

    def close(self) -> None:
        """Called after the last `pose`."""


class Late(Truth):
    """Knows what was sensed every PERIOD, from the first `pose` on, and arrived DELAY later."""

    def __init__(self) -> None:
        self._due: float | None = None
        self._coming: deque[tuple[float, Any]] = deque()

    def pose(self, time: float, pushing: Pushing) -> Pose | None:
        """See `Truth`."""
        self._due = time if self._due is None else self._due
        if time >= self._due - 1e-9:
            self._coming.append((self._due, self._sensed(pushing)))
            self._due += PERIOD
        while self._coming and self._coming[0][0] + DELAY <= time + 1e-9:
            self._arrived(*self._coming.popleft())
        return self._known(time)

    def _sensed(self, pushing: Pushing) -> Any:
        raise NotImplementedError

    def _arrived(self, stamp: float, sensed: Any) -> None:
        raise NotImplementedError

    def _known(self, time: float) -> Pose | None:
        raise NotImplementedError


class Predecessor(Late):
    """Knows true poses, late and with the errors of the platform's own tracker."""

    def __init__(self, platform: Platform, seed: int) -> None:
        super().__init__()
        self._rng = np.random.default_rng([seed, 2])
        self._newest: Pose | None = None

    def _sensed(self, pushing: Pushing) -> Pose | None:
        position, rotation = pushing.truth
        off = self._rng.normal(0.0, 1e-3 * ERROR_MM / _SIGMA, 3)
        turn = self._rng.normal(0.0, np.radians(ERROR_DEGREES) / _SIGMA, 3)
        return None if self._rng.random() < REPEATED else (position + off, so3.exp(turn) @ rotation)

    def _arrived(self, stamp: float, pose: Pose | None) -> None:
        self._newest = self._newest if pose is None else pose

    def _known(self, time: float) -> Pose | None:
        return self._newest


class Newest(Late):
    """Knows what the tracker found in the newest images that have arrived."""

    def __init__(self, platform: Platform, seed: int) -> None:
        super().__init__()
        self._rng = np.random.default_rng([seed, 1])
        self._platform, self._rig = platform, sized(standard_rig(), 270)
        assert platform.model is not None
        self._model = platform.model
        self._look, self._light = random_look(self._rng, self._model), random_lighting(self._rng)
        self._moment, self._source = -1, Pushed()
        self.film: list[Image] = []
        follower = tracker.ObjectTracker(self._model, self._rig)
        self._live = Live(self._source, follower, listeners=[self._hear])

    def close(self) -> None:
        """See `Truth`."""
        self._live.close()

    def _sensed(self, pushing: Pushing) -> list[Image]:
        position, rotation = pushing.truth
        states = self._platform.object_states(position[None], rotation[None])
        joints = pushing.world.joint_angles()
        scene = self._platform.scene(states, joints, self._look, self._light, {})
        return take(scene, self._rig.cameras, Sensor.realistic(), self._rng, points=1).images

    def _arrived(self, stamp: float, images: list[Image]) -> None:
        self._source.push(images, stamp)
        # The simulation waits meanwhile: DELAY includes the tracker's time.
        moment = self._live.wait(after=self._moment)
        assert moment is not None
        self._moment = moment.sequence

    def _hear(self, moment: Moment) -> None: ...

    def _known(self, time: float) -> Pose | None:
        moment = self._live.latest()
        pose = None if moment is None else moment.filtered_object_pose
        return None if pose is None else (pose.position, pose.rotation)


class Predicted(Newest):
    """Knows what the tracker predicts, from the images that have arrived, for the moment of acting."""

    def _hear(self, moment: Moment) -> None:
        if moment.sequence % FILMED == 0:
            title = f"{moment.timestamp:.1f} s"
            picture = overlay(moment.taken.images, self._rig, self._model, moment.observation, title=title)
            self.film.append(picture[::2, ::2].copy())

    def _known(self, time: float) -> Pose | None:
        pose = self._live.at(time)
        return None if pose is None else (pose.position, pose.rotation)
