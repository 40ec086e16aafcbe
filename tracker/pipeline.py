"""ObjectTracker: images in, poses out; where what is seen, estimated and remembered meets."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, Image
from tracker.errors import ImageError, TrackerError
from tracker.objects.box import Box
from tracker.objects.model import CuboidModel
from tracker.pose.estimate import PoseEstimator
from tracker.pose.fit import Fit, Lag
from tracker.pose.judge import rank
from tracker.pose.result import CameraUse, Forecast, Observation, Status
from tracker.segmentation.color_model import ColorModel, check_colors, load_colors
from tracker.segmentation.labels import check_image
from tracker.tracking.belief import TrackingOptions, measured
from tracker.tracking.cameras import usable
from tracker.tracking.doubt import after, heard, held_back
from tracker.tracking.filter import MotionState, unknown_velocity
from tracker.tracking.follow import Follower, settled
from tracker.tracking.gate import Gate
from tracker.tracking.memory import Memory
from tracker.tracking.stamps import check_stamps
from tracker.warm_up import warm_up

JUMP_LEAD = 3.0
"""Log odds by which a fit that takes a jump must lead over one where the object was expected."""


def _check(value: object, name: str, kind: type, whence: str) -> None:
    if not isinstance(value, kind):
        raise TrackerError(f"{name}: {type(value).__name__} given; a {kind.__name__} is needed: {whence}")


class ObjectTracker:
    """Finds one object in the images of a rig of calibrated cameras.

    Args:
        model: the object.
        rig: the cameras; images come in their order.
        colors: a colour model; None takes the object's own.
        tracking: what `update` believes; None for what suits the platform.
        support: whether it counts that an object often stands on the table, as well as `rig.arena` knows it.

    Raises:
        TrackerError: one of them is something else, as a name.
    """

    def __init__(
        self,
        model: CuboidModel,
        rig: CameraRig,
        colors: ColorModel | None = None,
        tracking: TrackingOptions | None = None,
        *,
        support: bool = True,
    ) -> None:
        _check(model, "model", CuboidModel, "tracker.load_object gives one")
        _check(rig, "rig", CameraRig, "tracker.CameraRig.load gives one")
        if colors is not None:
            check_colors(colors)
        warm_up()
        self.model, self.rig = model, rig
        self.colors = colors if colors is not None else load_colors(model.colors)
        self._estimator = PoseEstimator(Box.of(model), rig, self.colors, support)
        self._follow = Follower(self._estimator)
        self._memory = Memory.empty(len(rig), tracking)
        self._gate = Gate()

    def detect(self, images: Sequence[Array | None]) -> Observation:
        """The object's pose in one set of images, without memory: same images, same answer to the bit.

        Args:
            images: one (H, W, 3) uint8 BGR image for each camera of the rig, None where there is none.

        Raises:
            ImageError: wrong count, type, shape or size, or no image at all.
        """
        start = time.perf_counter()
        timing: dict[str, float] = {}
        fit, uses = self._search(images, timing)
        timing["total"] = 1e3 * (time.perf_counter() - start)
        if isinstance(fit, Status):
            return Observation(None, None, fit, timing, cameras=uses)
        return Observation(measured(fit), None, Status.FOUND, timing, cameras=after(uses, fit))

    def reset(self) -> None:
        """Forget what `update` remembers: the next images are the first of another recording.

        Raises:
            TrackerError: `update` is at work in another thread.
        """
        with self._gate:
            self._memory = Memory.empty(len(self.rig), self._memory.belief.options)

    def predict(self, timestamp: float) -> Forecast | None:
        """The pose expected at a later moment, from all that `update` has seen; changes nothing.

        Images are late: a control loop that acts at `timestamp` asks for the pose then. The object rests, is
        carried or pushed on, or is thrown: `kinds` has what each of these leads to, and how probable it is.
        The pose is the mean over the likely kinds, 95 % of all, and the covariance theirs. No forecast has
        the object in the table. None where it is lost, or has not been seen for longer than
        `TrackingOptions.coast_seconds` by then.

        Args:
            timestamp: on the clock of `update`'s stamps [s], not before the last of them.

        Raises:
            TrackerError: the stamp is not finite, or earlier than that of the last images.
        """
        return self.forecast()(timestamp)

    def forecast(self) -> Callable[[float], Forecast | None]:
        """What `predict` answers now, as a function that goes on answering so while `update` goes on."""
        belief, box, table = self._memory.belief, self._estimator.box, self.rig.arena.table
        ground = -math.inf if table is None else table
        return lambda timestamp: belief.forecast(timestamp, box, ground)

    def update(self, images: Sequence[Array | None], timestamp: float | Sequence[float]) -> Observation:
        """The object's pose in the next set of images, with the memory of those before.

        The object is looked for where its motion so far lets it be expected, and everywhere if it is not
        there. Measurements are fused over time: the filtered pose is smoother, has a velocity, and goes on
        for a while (`TrackingOptions.coast_seconds`) when the object is not seen. A pose that appears
        somewhere else all of a sudden is believed if it is sure, or if the next images confirm it.

        Images with the stamp of those before are not used twice: the answer is the same as before. A camera
        whose image is black, or the same as before down to its noise while others change, counts as one
        that gave none.

        Args:
            images: as for `detect`, but all may be None.
            timestamp: when they were taken [s], not earlier than those before; or one stamp for each camera,
                where they were not taken at once: the pose is that of the latest, and what the others show is
                moved by the object's velocity. Stamps of cameras without an image do not count.

        Raises:
            ImageError: wrong count, type, shape or size.
            TrackerError: the wrong number of stamps, one that is not finite, or all earlier than before; or
                another call of `update` or `reset` is at work on this tracker. After an error everything is
                as it was before the call.
        """
        with self._gate:
            return self._update(images, timestamp)

    def _update(self, images: Sequence[Array | None], timestamp: float | Sequence[float]) -> Observation:
        start = time.perf_counter()
        checked = self._check(images, least=0)
        stamps = check_stamps(timestamp, [image is not None for image in checked])
        before = self._memory
        if before.latest is not None and stamps.latest == before.belief.timestamp:
            return before.latest
        belief, expected = before.belief.advance(stamps.latest)
        cameras, given, found = usable(before.cameras, checked)
        uses = tuple(found)
        lag = None
        if stamps.delays.any():
            velocity, spread = unknown_velocity()
            if expected is not None:
                velocity, spread = expected.velocity, expected.covariance[6:, 6:]
            lag = Lag(stamps.delays, velocity, spread)
        memory = before._replace(belief=belief, cameras=tuple(cameras))
        timing: dict[str, float] = {}
        outcome, memory = self._measure(given, expected, lag, memory, timing)
        pose = status = reason = None
        if isinstance(outcome, Status):
            reason = outcome
        else:
            agreement = memory.agreement.after(outcome, expected, lagging=lag is not None)
            belief, status = belief.see(outcome, expected, agreement.fitting)
            if status is not Status.COASTING:  # what is not believed teaches nothing
                memory = memory._replace(agreement=agreement)
            uses = after(uses, outcome, held_back(memory.cameras, given))
            pose = measured(outcome, agreement.fitting) if status is not Status.COASTING else None
            # It could be elsewhere: found, but not believed yet.
            reason = Status.AMBIGUOUS if pose is None else None
            if pose is not None and agreement.contradicts:
                status = Status.INCONSISTENT_VIEWS
        filtered = belief.estimate()
        if pose is None:
            status = Status.LOST if filtered is None else Status.COASTING
        assert status is not None
        timing["total"] = 1e3 * (time.perf_counter() - start)
        answer = Observation(pose, filtered, status, timing, reason, uses)
        self._memory = memory._replace(belief=belief._replace(unseen=pose is None), latest=answer)
        return answer

    def _measure(
        self,
        images: Sequence[Image | None],
        expected: MotionState | None,
        lag: Lag | None,
        memory: Memory,
        timing: dict[str, float],
    ) -> tuple[Fit | Status, Memory]:
        """The object in these images, near where it is expected or else anywhere, and what was learned."""
        if all(image is None for image in images):
            return Status.NO_OBJECT_COLORS, memory
        near = None
        if expected is not None:
            near, memory = self._follow(images, expected, memory, lag, timing)
            if near is not None:
                memory = memory._replace(cameras=heard(memory.cameras, near))
                if settled(near) and memory.belief.plausible(expected, near):
                    return near, memory
            # Who did not see what the others saw is not asked where else the object may be.
            unused = held_back(memory.cameras, images)
            images = [None if c in unused else image for c, image in enumerate(images)]
        found = self._estimator.find(images, timing, thorough=near is None, lag=lag)
        if near is None or expected is None or isinstance(found, Status):
            return found if near is None else near, memory
        lead = 0.0 if memory.belief.plausible(expected, found) else JUMP_LEAD
        return found if rank(found) > rank(near) + lead else near, memory

    def fit(self, images: Sequence[Array | None], timing: dict[str, float] | None = None) -> Fit | Status:
        """As `detect`, with all that supports the pose; `timing` gains the milliseconds of each stage."""
        return self._search(images, {} if timing is None else timing)[0]

    def _search(
        self, images: Sequence[Array | None], timing: dict[str, float]
    ) -> tuple[Fit | Status, tuple[CameraUse, ...]]:
        """The object anywhere, without memory, and what the pictures themselves are good for."""
        nothing = Memory.empty(len(self.rig)).cameras
        _, given, uses = usable(nothing, self._check(images))
        return self._estimator.find(given, timing), tuple(uses)

    def _check(self, images: Sequence[Array | None], least: int = 1) -> list[Image | None]:
        given: object = images
        if isinstance(given, np.ndarray) and given.ndim == 3:
            raise ImageError(
                f"images: one array of shape {given.shape} given; a sequence of images is needed"
            )
        if len(images) != len(self.rig):
            raise ImageError(
                f"images: {len(images)} given; {len(self.rig)} are needed, one for each of "
                f"{', '.join(self.rig.names)} (None where a camera gave none)"
            )
        checked: list[Image | None] = []
        for image, camera in zip(images, self.rig, strict=True):
            if image is None:
                checked.append(None)
                continue
            image = check_image(image, f"image of {camera.name}")
            if image.shape[:2] != (camera.height, camera.width):
                raise ImageError(
                    f"image of {camera.name}: {image.shape[1]}×{image.shape[0]} px, but its calibration is "
                    f"for {camera.width}×{camera.height}; CameraRig.resized makes one for another size"
                )
            image = np.ascontiguousarray(image)
            # Compiled code for arrays that cannot be written would be compiled once more.
            checked.append(image if image.flags.writeable else image.copy())
        if least and all(image is None for image in checked):
            raise ImageError(
                f"images: all are None; at least one of {', '.join(self.rig.names)} is needed "
                "(cv2.imread gives None for a file that it cannot read)"
            )
        return checked
