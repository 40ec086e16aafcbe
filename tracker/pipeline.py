"""ObjectTracker: the only place where segmentation and pose estimation meet."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.errors import ImageError
from tracker.geometry import so3
from tracker.objects.model import CuboidModel
from tracker.pose.acceptance import confidence, refusal
from tracker.pose.estimate import Fit, PoseEstimator
from tracker.pose.result import Observation, PoseEstimate, Status
from tracker.pose.views import Box, Evidence, reduced_size
from tracker.segmentation.color_model import ColorModel, load_colors
from tracker.segmentation.labels import check_image, look_up
from tracker.segmentation.normalise import grey_world_gains, neutral_gains

SURE = 0.9
"""Confidence below which the light is judged a second time, by the grey world."""


class ObjectTracker:
    """Finds one object in the images of a rig of calibrated cameras.

    Args:
        model: the object.
        rig: the cameras; images come in their order.
        colors: a colour model; None takes the object's own.
    """

    def __init__(self, model: CuboidModel, rig: CameraRig, colors: ColorModel | None = None) -> None:
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
        checked = self._check(images)
        timing: dict[str, float] = {}
        small = [None if im is None else _reduce(im) for im in checked]
        best: tuple[float, Fit] | None = None
        status = Status.NO_OBJECT_COLORS
        for attempt in range(2 if self.colors.normalise else 1):
            lap = time.perf_counter()
            views = [
                None if im is None or r is None else self._evidence(im, r, attempt)
                for im, r in zip(checked, small, strict=True)
            ]
            split = time.perf_counter()
            outcome = self._estimator.estimate(views)
            timing["segmentation"] = timing.get("segmentation", 0.0) + 1e3 * (split - lap)
            timing["pose"] = timing.get("pose", 0.0) + 1e3 * (time.perf_counter() - split)
            refused = outcome if isinstance(outcome, Status) else refusal(outcome)
            if refused is None and isinstance(outcome, Fit):
                sure = confidence(outcome)
                if best is None or sure > best[0]:
                    best = (sure, outcome)
                if sure > SURE:
                    break
            elif attempt == 0 and refused is not None:
                status = refused
        timing["total"] = 1e3 * (time.perf_counter() - start)
        if best is None:
            return Observation(None, None, status, timing)
        return Observation(_pose(*best), None, Status.FOUND, timing)

    def _evidence(self, image: Image, small: Image, attempt: int) -> Evidence:
        gains = np.ones(3)
        if self.colors.normalise:
            gains = grey_world_gains(small) if attempt else neutral_gains(small)[0]
        channels = self.colors.channel_tables(gains)
        labels = np.empty(small.shape[:2], np.uint8)
        look_up(small, channels, self.colors.label_table, labels)
        return Evidence(image, labels, channels)

    def _check(self, images: Sequence[Image | None]) -> list[Image | None]:
        if isinstance(images, np.ndarray) and images.ndim == 3:
            raise ImageError(f"images: one array of shape {images.shape} given; a sequence of images is needed")
        if len(images) != len(self.rig):
            raise ImageError(
                f"images: {len(images)} given; {len(self.rig)} are needed, one for each of "
                f"{', '.join(self.rig.names)} (None where a camera gave none)"
            )
        checked = []
        for image, camera in zip(images, self.rig, strict=True):
            if image is None:
                checked.append(None)
                continue
            image = check_image(image, f"image of {camera.name}")
            if image.shape[:2] != (camera.height, camera.width):
                raise ImageError(
                    f"image of {camera.name}: {image.shape[1]}×{image.shape[0]} px, but its calibration is for "
                    f"{camera.width}×{camera.height}; CameraRig.resized makes one for another size"
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


def _pose(sure: float, fit: Fit) -> PoseEstimate:
    return PoseEstimate(fit.position, so3.quaternion_from_matrix(fit.rotation), fit.covariance, sure)


def kernels_are_cached() -> bool:
    """Whether compiled kernels lie on disk, so that the first detection starts at once."""
    folder = Path(__file__).parent / "pose" / "__pycache__"
    return folder.is_dir() and any(folder.glob("contour.refine_view*.nbi"))
