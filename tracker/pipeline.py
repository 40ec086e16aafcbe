"""ObjectTracker: images in, poses out. It combines segmentation, pose estimation and tracking."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import of_kind, one_stamp, shown_in
from tracker.conventions import Image
from tracker.errors import TrackerError
from tracker.inputs import (
    Images,
    PathLike,
    Stamp,
    check_hidden,
    check_images,
    check_stamps,
    colors_of,
    object_of,
    rig_of,
)
from tracker.objects.model import Box, CuboidModel, load_object, object_names
from tracker.pose.agreement import CONTRADICTION, size, spread
from tracker.pose.estimate import PoseEstimator
from tracker.pose.fit import Fit
from tracker.pose.judge import apparent, fits, supporters
from tracker.pose.result import CameraUse, Forecast, Observation, Status
from tracker.segmentation.color_model import ColorModel
from tracker.tracking.belief import TrackingOptions, measured
from tracker.tracking.cameras import after, usable
from tracker.tracking.follow import Follower, Gate, Memory
from tracker.warm_up import load


class ObjectTracker:
    """Finds one object in the images of a rig of calibrated cameras.

    Args:
        model: the object, or its name or TOML file.
        rig: the cameras in the order of the images, or their calibration files, or the folder with them.
        colors: a colour model, or its name or file; None: the object's own.
        tracking: the limits for `update`; None: the defaults, which suit the platform.
        table_prior: whether to assume that the object often rests on the table (`rig.arena` gives the
            table's height and how well it is known).

    Raises:
        TrackerError: an argument has the wrong type, a name is unknown, or a file is malformed.
    """

    def __init__(
        self,
        model: CuboidModel | PathLike,
        rig: CameraRig | PathLike | Iterable[PathLike],
        colors: ColorModel | PathLike | None = None,
        tracking: TrackingOptions | None = None,
        *,
        table_prior: bool = True,
    ) -> None:
        if tracking is not None:
            of_kind(tracking, TrackingOptions, "tracking", TrackerError)
        of_kind(table_prior, bool, "table_prior", TrackerError)
        self.model, self.rig = object_of(model), rig_of(rig)
        self.colors = colors_of(colors, self.model)
        load()
        self._estimator = PoseEstimator(Box.of(self.model), self.rig, self.colors, table_prior)
        self._follow = Follower(self._estimator, self.rig.arena.table)
        self._memory = Memory.empty(len(self.rig), tracking)
        self._gate = Gate()

    def __repr__(self) -> str:
        seen = self._memory.belief
        memory = "" if seen.timestamp is None else f",\n    last update at {seen.timestamp:.3f} s"
        return f"ObjectTracker({self.model!r},\n    {self.rig!r},\n    {self.colors!r}{memory})"

    def __getstate__(self) -> dict[str, Any]:
        # A copy, shallow or deep, gets its own gate.
        return self.__dict__ | {"_gate": Gate()}

    def detect(self, images: Images, hidden: Images | None = None) -> Observation:
        """Estimate the object's pose from one set of images, without memory; bitwise reproducible.

        Args:
            images: one (H, W, 3) uint8 BGR image for each camera of the rig, in its order or as
                `{camera name: image}`; None for a missing image.
            hidden: for each camera a bool (H, W) mask of pixels to ignore, known to show a finger, or None.

        Raises:
            ImageError: wrong number, names, type, shape or size, or no image at all.
        """
        start = time.perf_counter()
        timing: dict[str, float] = {}
        fit, uses = self._search(images, timing, hidden)
        timing["total"] = 1e3 * (time.perf_counter() - start)
        if isinstance(fit, Status):
            return Observation(None, None, fit, timing, cameras=uses)
        off = size(fit.disagreement)
        wide = spread(off, supporters(fit)) if self._estimator.stated else 0.0
        pose = measured(fit, fits(fit), wide, self.model.size)
        reason = Status.INCONSISTENT_VIEWS if off > CONTRADICTION else None
        return Observation(pose, None, Status.FOUND, timing, reason, after(uses, fit))

    def reset(self) -> None:
        """Forget all previous images: the next ones start a new recording.

        Raises:
            TrackerError: `update` is running in another thread.
        """
        with self._gate.lock():
            self._memory = Memory.empty(len(self.rig), self._memory.belief.options)

    def predict(self, timestamp: float) -> Forecast | None:
        """Predict the pose at a later time from all images so far, without changing the tracker.

        Images arrive late: predict the pose for the time at which you act. `kinds` lists the possible motions
        (at rest, carried or pushed, thrown) with their poses and probabilities. Pose and covariance are those
        of the mixture of the likely ones (95 %), or of all while the object is unseen. Predictions never sink
        deeper into the table than the last pose did. The result is None if the object is lost, or unseen for
        more than `TrackingOptions.coast_seconds` by then.

        Args:
            timestamp: on the clock of `update`'s timestamps [s], not earlier than the last one.

        Raises:
            TrackerError: the timestamp is not in seconds, or earlier than that of the last images.
        """
        return self.forecast()(timestamp)

    def forecast(self) -> Callable[[float], Forecast | None]:
        """Return `predict` for the images so far: a function that later calls of `update` do not change."""
        belief, body = self._memory.belief, self._follow.body
        return lambda timestamp: belief.forecast(one_stamp(timestamp, "timestamp"), *body)

    def update(self, images: Images, timestamp: Stamp, hidden: Images | None = None) -> Observation:
        """Estimate the object's pose from the next set of images and the memory of the previous ones.

        The search starts at the predicted pose and widens if that fails. Measurements are fused over time:
        the filtered pose is smoother, has a velocity, and is predicted for a while
        (`TrackingOptions.coast_seconds`) if the object is not seen. A pose that jumps is accepted if it is
        certain, or if the next images confirm it.

        The same timestamp again gives the same answer. A black image, or one that is frozen while others
        change, counts as missing.

        Args:
            images: as for `detect`, but all may be None.
            timestamp: when the images were taken [s], not earlier than the last. If they were not taken at
                the same time, one per camera, in order or by name: the pose is that of the latest image, and
                the motion in between is estimated, too. Timestamps of missing and black images are ignored.
            hidden: as for `detect`.

        Raises:
            ImageError: wrong number, names, type, shape or size.
            TrackerError: wrong number of timestamps, one not in seconds, all earlier than the last ones, or
                `update` or `reset` is running in another thread. A call that raises changes nothing.
        """
        with self._gate.lock():
            start, before = time.perf_counter(), self._memory
            checked, masks = check_images(images, self.rig, least=0), check_hidden(hidden, self.rig)
            latest, delays = check_stamps(timestamp, shown_in(checked), self.rig.names)
            if before.latest is not None and latest == before.belief.timestamp:
                return before.latest
            answer, self._memory = self._follow(checked, latest, delays, before, masks)
            answer.timing_ms["total"] = 1e3 * (time.perf_counter() - start)
            return answer

    def fit(self, images: Images, timing: dict[str, float] | None = None) -> Fit | Status:
        """Like `detect`, but with the evidence for the pose; `timing` receives each stage's duration [ms]."""
        return self._search(images, {} if timing is None else timing)[0]

    def _search(
        self, images: Images, timing: dict[str, float], hidden: Images | None = None
    ) -> tuple[Fit | Status, tuple[CameraUse, ...]]:
        """Search everywhere, without memory; also return how each camera's image can be used."""
        given, uses = usable(check_images(images, self.rig))
        given = self._estimator.reader.unveiled(given, timing)
        return self._estimator.find(given, timing, hidden=check_hidden(hidden, self.rig)), uses


SAMPLE, RATHER = 7, 0.25
"""Number of sets of images used to recognise another object, and the gain in mean confidence required."""


def another_shown(tracker: ObjectTracker, sets: Sequence[Sequence[Image | None]]) -> str:
    """Return a remark if images show a built-in object of another size than the tracker's; empty if not.

    The sets of images are judged together, as if the calibration fitted.
    """
    size = np.sort(tracker.model.size)
    names = [name for name in object_names() if not np.allclose(np.sort(load_object(name).size), size)]
    trackers = [tracker, *(ObjectTracker(name, tracker.rig, table_prior=False) for name in names)]
    found = [[one.fit(images) for one in trackers] for images in sets]
    sure = [[apparent(fit) if isinstance(fit, Fit) else 0.0 for fit in row] for row in found]
    own, *theirs = np.mean(sure, axis=0) if sets else [0.0]
    rather = [name for name, mean in zip(names, theirs, strict=bool(sets)) if mean > own + RATHER]
    return f"the images show {' or '.join(rather)} rather than {tracker.model.name}" if rather else ""
