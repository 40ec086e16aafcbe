"""ObjectTracker: the only place where segmentation and pose estimation meet."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.errors import ImageError
from tracker.geometry import so3
from tracker.objects.model import CuboidModel
from tracker.pose.acceptance import confidence, refusal
from tracker.pose.contour import refine
from tracker.pose.estimate import PoseEstimator
from tracker.pose.fit import Fit
from tracker.pose.result import Observation, PoseEstimate, Status
from tracker.pose.views import Box, Evidence, reduced_size
from tracker.segmentation.color_model import ColorModel, load_colors
from tracker.segmentation.denoise import calmed
from tracker.segmentation.labels import check_image, look_up
from tracker.segmentation.normalise import evened, find_light, grey_world_gains

_LOG = logging.getLogger(__name__)

SURE = 0.9
"""Confidence below which the light is judged a second time, by the grey world."""


class _Seen(NamedTuple):
    """An image in even light."""

    image: Image
    """(H, W, 3) BGR."""
    small: Image
    """(h, w, 3), reduced for labels."""
    gains: FloatArray
    """(3,) that make its greys grey."""


class ObjectTracker:
    """Finds one object in the images of a rig of calibrated cameras.

    Args:
        model: the object.
        rig: the cameras; images come in their order.
        colors: a colour model; None takes the object's own.
    """

    def __init__(self, model: CuboidModel, rig: CameraRig, colors: ColorModel | None = None) -> None:
        if not kernels_are_cached():
            # A warning reaches standard error without any set-up of logging.
            _LOG.warning("compiling kernels, once per machine (about 20 s) ...")
        self.model, self.rig = model, rig
        self.colors = colors if colors is not None else load_colors(model.colors)
        box = Box(np.asarray(model.size) / 2, np.asarray(model.face_labels, dtype=np.uint8))
        self._estimator = PoseEstimator(box, rig.cameras, self.colors.label_table)

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

    def fit(self, images: Sequence[Image | None], timing: dict[str, float] | None = None) -> Fit | Status:
        """As `detect`, with all that supports the pose; `timing` gains the milliseconds of each stage.

        The light is judged by the scene's most frequent chromaticity; where that gives no sure answer,
        by the grey world as well, and the surer answer counts.
        """
        timing = {} if timing is None else timing
        lap = time.perf_counter()
        seen = [None if image is None else self._see(image) for image in self._check(images)]
        timing["light"] = 1e3 * (time.perf_counter() - lap)
        best: tuple[Fit, float] | None = None
        status: Status | None = None
        for grey_world in (False, True) if self.colors.normalise else (False,):
            lap = time.perf_counter()
            views = [None if one is None else self._evidence(one, grey_world) for one in seen]
            split = time.perf_counter()
            outcome = self._estimator.estimate(views)
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

    def _see(self, image: Image) -> _Seen:
        small = _reduce(calmed(image))
        if not self.colors.normalise:
            return _Seen(image, small, np.ones(3))
        light = find_light(small)
        return _Seen(evened(image, light), evened(small, light), light.gains)

    def _evidence(self, seen: _Seen, grey_world: bool) -> Evidence:
        gains = grey_world_gains(seen.small) if grey_world else seen.gains
        channels = self.colors.channel_tables(gains)
        labels = np.empty(seen.small.shape[:2], np.uint8)
        look_up(seen.small, channels, self.colors.label_table, gains, labels)
        return Evidence(seen.image, labels, channels)

    def _check(self, images: Sequence[Image | None]) -> list[Image | None]:
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
            checked.append(np.ascontiguousarray(image))
        if all(image is None for image in checked):
            raise ImageError(f"images: all are None; at least one of {', '.join(self.rig.names)} is needed")
        return checked


def _reduce(image: Image) -> Image:
    height, width = image.shape[:2]
    size = reduced_size(width, height)
    if size == (width, height):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def kernels_are_cached() -> bool:
    """Whether compiled kernels lie on disk, so that the first detection starts at once (best effort)."""
    folder = Path(str(refine.stats.cache_path))
    return any(folder.glob("contour.refine*.nbi"))
