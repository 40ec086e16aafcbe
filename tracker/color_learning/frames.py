"""Frames of recordings from which colours are learned, and others by which what was learned is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.logs.log import Log, evenly, picked
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import confidence
from tracker.segmentation.color_model import ColorModel

Images = tuple[Image | None, ...]
"""(H, W, 3) BGR of each camera of a rig, None where it gave none."""


LEAST = 3
"""Frames below which nothing is learned."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of one recording."""

    rig: CameraRig
    """Its cameras."""
    learned: tuple[Images, ...]
    """Frames that teach."""
    held_out: tuple[Images, ...]
    """Frames that judge."""


def frames_of(log: Log, rig: CameraRig, count: int) -> Frames:
    """Up to `count` frames spread evenly over a recording: every other one teaches, the rest judge.

    Raises:
        LogError: the recording is damaged.
    """
    frames = [frame.images for frame in picked(log, evenly(len(log), count))]
    frames = [images for images in frames if any(image is not None for image in images)]
    return Frames(rig, tuple(frames[::2]), tuple(frames[1::2]))


def shares(lengths: Sequence[int], count: int) -> list[int]:
    """How many of `count` frames each of several recordings gives: as many each, as far as they reach."""
    result, left = [0] * len(lengths), count
    order = sorted(range(len(lengths)), key=lambda k: lengths[k])
    for place, k in enumerate(order):
        result[k] = min(lengths[k], max(2, left // (len(order) - place)))
        left -= result[k]
    return result


SURE = 0.5
"""Confidence from which a frame counts as posed."""


@dataclass(frozen=True)
class Judgement:
    """What held-out frames say of a colour model."""

    explained: float
    """Mean over the frames, from 0 to 1, of the confidence times the overlap (intersection over union) of the
    face colours that are found with those that the pose predicts; 0 for a frame without a pose."""
    posed: float
    """Share of the frames with a pose of a confidence above SURE."""
    frames: int
    """Number of frames."""

    def __str__(self) -> str:
        """For people to read."""
        return f"{self.explained:.1%} explained, {self.posed:.1%} posed"


def judge(model: CuboidModel, footage: Sequence[Frames], colors: ColorModel) -> Judgement:
    """Judge a colour model by the frames that are held out."""
    explained, posed = [], []
    for one in footage:
        tracker = ObjectTracker(model, one.rig, colors)
        for images in one.held_out:
            fit = tracker.fit(images)
            if isinstance(fit, Fit):
                explained.append(confidence(fit) * overlap(fit))
                posed.append(confidence(fit) > SURE)
            else:
                explained.append(0.0)
                posed.append(False)
    return Judgement(float(np.mean(explained)), float(np.mean(posed)), len(posed))


def overlap(fit: Fit) -> float:
    """Intersection over union of the face colours that are found with those that a fit predicts."""
    union = fit.total("predicted") + fit.total("extra") + fit.total("elsewhere")
    return fit.total("agree") / max(union, 1.0)
