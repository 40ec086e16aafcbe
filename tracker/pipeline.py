"""ObjectTracker: images in, poses out; where what is seen, estimated and remembered meets."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.errors import ImageError
from tracker.evidence import EvidenceReader
from tracker.geometry import so3
from tracker.objects.model import CuboidModel
from tracker.pose.acceptance import confidence, features, log_odds, rank, refusal
from tracker.pose.align import EXTRA, PREDICTED
from tracker.pose.contour import refine
from tracker.pose.estimate import PoseEstimator
from tracker.pose.fit import Fit
from tracker.pose.motion import MotionState
from tracker.pose.result import Observation, PoseEstimate, Status
from tracker.pose.views import Box, Evidence
from tracker.segmentation.color_model import ColorModel, load_colors
from tracker.segmentation.labels import check_image
from tracker.tracking import Track, TrackingOptions, alone, measured
from tracker.watch import Watch

_LOG = logging.getLogger(__name__)

SURE = 0.9
"""Confidence below which the light is judged a second time, by the grey world."""

TOGETHER, ALONE = (3.0, 1.2), (4.5, 0.7)
"""Least log odds, and roughest edges (the feature `rms`), of a fit near where the object was expected, with
which it is not looked for farther away: where several cameras see it, and one alone, to which wrong poses
look better."""

MOST_EXTRA = 0.08
"""Share of pixels in the object's colours beyond its outline up to which it is not: slid along an edge, it
fits too, but leaves part of itself."""

JUMP_LEAD = 3.0
"""Log odds by which a fit that takes a jump must lead over one where the object was expected."""


class ObjectTracker:
    """Finds one object in the images of a rig of calibrated cameras.

    Args:
        model: the object.
        rig: the cameras; images come in their order.
        colors: a colour model; None takes the object's own.
        tracking: what `update` believes; None for what suits the platform.
    """

    def __init__(
        self,
        model: CuboidModel,
        rig: CameraRig,
        colors: ColorModel | None = None,
        tracking: TrackingOptions | None = None,
    ) -> None:
        if not kernels_are_cached():
            # A warning reaches standard error without any set-up of logging.
            _LOG.warning("compiling kernels, once per machine (about 20 s) ...")
        self.model, self.rig = model, rig
        self.colors = colors if colors is not None else load_colors(model.colors)
        box = Box(np.asarray(model.size) / 2, np.asarray(model.face_labels, dtype=np.uint8))
        self._estimator = PoseEstimator(box, rig.cameras, self.colors.label_table)
        self._track, self._watch = Track(tracking), Watch(len(rig))
        self._reader = EvidenceReader(self.colors, len(rig))

    def detect(self, images: Sequence[Image | None]) -> Observation:
        """The object's pose in one set of images, without memory: same images, same answer to the bit.

        Args:
            images: one (H, W, 3) uint8 BGR image for each camera of the rig, None where there is none.

        Raises:
            ImageError: wrong count, type, shape or size, or no image at all.
        """
        start = time.perf_counter()
        timing: dict[str, float] = {}
        fit = self.fit(images, timing)
        timing["total"] = 1e3 * (time.perf_counter() - start)
        if isinstance(fit, Status):
            return Observation(None, None, fit, timing)
        pose = PoseEstimate(
            fit.position, so3.quaternion_from_matrix(fit.rotation), fit.covariance, confidence(fit)
        )
        return Observation(pose, None, Status.FOUND, timing)

    def reset(self) -> None:
        """Forget what `update` remembers: the next images are the first of another recording."""
        self._track = Track(self._track.options)
        self._watch = Watch(len(self.rig))
        self._estimator.forget()

    def update(self, images: Sequence[Image | None], timestamp: float) -> Observation:
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
            timestamp: when they were taken [s], not earlier than those before.

        Raises:
            ImageError: wrong count, type, shape or size.
            TrackerError: the stamp is not finite, or earlier than the one before.
        """
        start = time.perf_counter()
        checked = self._check(images, least=0)
        if self._track.latest is not None and timestamp == self._track.timestamp:
            return self._track.latest
        expected = self._track.advance(timestamp)
        timing: dict[str, float] = {}
        outcome = self._measure(self._watch.usable(checked), expected, timing)
        pose = status = reason = None
        if isinstance(outcome, Status):
            reason = outcome
        else:
            status = self._track.see(outcome, expected)
            pose = measured(outcome) if status is not Status.COASTING else None
            # It could be elsewhere: found, but not believed yet.
            reason = Status.AMBIGUOUS if pose is None else None
        filtered = self._track.estimate()
        if pose is None:
            status = Status.LOST if filtered is None else Status.COASTING
        assert status is not None
        timing["total"] = 1e3 * (time.perf_counter() - start)
        self._track.latest = Observation(pose, filtered, status, timing, reason)
        return self._track.latest

    def _measure(
        self, images: Sequence[Image | None], expected: MotionState | None, timing: dict[str, float]
    ) -> Fit | Status:
        """The object in these images: near where it is expected, or else anywhere."""
        if all(image is None for image in images):
            return Status.NO_OBJECT_COLORS
        near = None if expected is None else self._follow(images, expected, timing)
        if (
            near is not None
            and expected is not None
            and _settled(near)
            and self._track.plausible(expected, near)
        ):
            return near
        found = self.fit(images, timing, thorough=near is None)
        if near is None or expected is None or isinstance(found, Status):
            return found if near is None else near
        lead = 0.0 if self._track.plausible(expected, found) else JUMP_LEAD
        return found if rank(found) > rank(near) + lead else near

    def _follow(
        self, images: Sequence[Image | None], expected: MotionState, timing: dict[str, float]
    ) -> Fit | None:
        """The object where it is expected, or not far from there; None if it is not."""
        lap = time.perf_counter()
        views = [
            None if image is None else self._glance(c, image, expected.position)
            for c, image in enumerate(images)
        ]
        split = time.perf_counter()
        timing["segmentation"] = 1e3 * (split - lap)
        fit: Fit | None = self._estimator.follow(views, expected.rotation, expected.position)
        if not _settled(fit):
            hypotheses = [(expected.rotation, expected.position)]
            if self._track.last_pose is not None:
                hypotheses.append(self._track.last_pose)
            fit = self._estimator.follow_far(hypotheses)
        timing["pose"] = 1e3 * (time.perf_counter() - split)
        return fit if fit is not None and refusal(fit) is None else None

    def fit(
        self,
        images: Sequence[Image | None],
        timing: dict[str, float] | None = None,
        *,
        thorough: bool = True,
    ) -> Fit | Status:
        """As `detect`, with all that supports the pose; `timing` gains the milliseconds of each stage.

        The light is judged by the scene's most frequent chromaticity; where that gives no sure answer,
        by the grey world as well, and the surer answer counts; unless the search need not be thorough.
        """
        timing = {} if timing is None else timing
        lap = time.perf_counter()
        seen = [None if image is None else self._reader.see(image) for image in self._check(images)]
        timing["light"] = 1e3 * (time.perf_counter() - lap)
        best: tuple[Fit, float] | None = None
        status: Status | None = None
        for grey_world in (False, True) if self.colors.normalise and thorough else (False,):
            lap = time.perf_counter()
            views = [None if one is None else self._reader.read(one, grey_world) for one in seen]
            split = time.perf_counter()
            outcome = self._estimator.estimate(views, thorough=thorough)
            timing["segmentation"] = timing.get("segmentation", 0.0) + 1e3 * (split - lap)
            timing["pose"] = timing.get("pose", 0.0) + 1e3 * (time.perf_counter() - split)
            refused = outcome if isinstance(outcome, Status) else refusal(outcome)
            if isinstance(outcome, Fit) and refused is None:
                found = confidence(outcome)
                if best is None or found > best[1]:
                    best = outcome, found
                if best[1] > SURE:
                    break
            else:
                status = status or refused
        return best[0] if best else status or Status.INCONSISTENT_VIEWS

    def _glance(self, c: int, image: Image, position: FloatArray) -> Evidence:
        """What camera c's image shows around a position [m]."""
        light, loud = self._watch.light(c, image)
        return self._reader.glance(c, image, light, loud, self._estimator.window(c, position))

    def _check(self, images: Sequence[Image | None], least: int = 1) -> list[Image | None]:
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
            raise ImageError(f"images: all are None; at least one of {', '.join(self.rig.names)} is needed")
        return checked


def _settled(fit: Fit | None) -> bool:
    """Whether a fit is so sure that no other needs to be tried."""
    if fit is None or not fit.converged or refusal(fit) is not None:
        return False
    sure, rough = ALONE if alone(fit) else TOGETHER
    if log_odds(fit) < sure or features(fit)["rms"] > rough:
        return False
    counts = fit.counts.sum(axis=0)
    return bool(counts[EXTRA] <= MOST_EXTRA * counts[PREDICTED])


def kernels_are_cached() -> bool:
    """Whether compiled kernels lie on disk, so that the first detection starts at once (best effort)."""
    folder = Path(str(refine.stats.cache_path))
    return any(folder.glob("contour.refine*.nbi"))
