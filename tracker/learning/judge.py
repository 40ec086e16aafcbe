"""How well a colour model explains frames that it was not learned from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tracker.learning.footage import Footage
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import confidence
from tracker.segmentation.color_model import ColorModel

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
        """As people are told of it."""
        return f"{self.explained:.1%} explained, {self.posed:.1%} posed"


def judge(model: CuboidModel, footage: Sequence[Footage], colors: ColorModel) -> Judgement:
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
