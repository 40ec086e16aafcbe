"""What is remembered of the cameras: whether their pictures are new, their light, whether they agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.pose.agreement import contradict, probably_fits, spread
from tracker.pose.fit import Fit
from tracker.pose.judge import contradicting, fits
from tracker.pose.result import CameraUse
from tracker.segmentation.sensor import noise_level
from tracker.tracking.motion import MotionState

EVERY = 5
"""Pictures after which a camera's light is looked at again, and cameras are asked whether they agree."""

ROWS = 12
"""Rows of pixels that tell whether a picture has changed."""

NOISELESS = 0.5
"""Standard deviation of a picture's noise [levels] up to which it may stay the same."""

BLACK = 12
"""Level that some pixel of a picture must exceed [levels]."""

SHARE = 0.2
"""Of each look in what is remembered: an object at rest looks the same in one picture after the other."""

LOOKS = 5
"""Looks that a lasting contradiction takes."""

STILL = 0.005, math.radians(5)
"""Speeds up to which an object is still [m/s, rad/s]: cameras that are grabbed one after the other see one
that moves in different places."""

RESTS = 0.9
"""Probability that an object rests from which pictures that were taken one after another count: of one whose
velocity is not known yet they show the motion."""


class CameraMemory(NamedTuple):
    """What is remembered of one camera."""

    sample: Array | None = None
    """Some rows of its last picture."""
    age: int | None = None
    """Pictures since its light was last looked at; None: it never was."""


def usable(
    memories: Sequence[CameraMemory], images: Sequence[Image | None]
) -> tuple[tuple[CameraMemory, ...], list[Image | None], tuple[CameraUse, ...]]:
    """The pictures but those that are black, or frozen: the same, noise and all, while others change."""
    remembered, result, unchanged = list(memories), list(images), []
    uses = [CameraUse.NO_IMAGE if image is None else CameraUse.USED for image in images]
    others_change = False
    for c, image in enumerate(images):
        if image is None:
            continue
        step = max(image.shape[0] // ROWS, 1)
        sample, before = image[step // 2 :: step].copy(), memories[c].sample
        remembered[c] = memories[c]._replace(sample=sample)
        if sample.max() < BLACK:
            result[c], uses[c] = None, CameraUse.BLACK
        elif before is not None and np.array_equal(before, sample):
            unchanged.append(c)
        else:
            others_change = True
    for c in unchanged if others_change else ():
        image = images[c]
        # Pictures of a simulation have no noise: where nothing moves in them they are the same.
        if image is not None and noise_level(image) > NOISELESS:
            result[c], uses[c] = None, CameraUse.FROZEN
    return tuple(remembered), result, tuple(uses)


def looked_at(
    memories: Sequence[CameraMemory], images: Sequence[Image | None]
) -> tuple[tuple[CameraMemory, ...], list[bool]]:
    """The memories once these pictures were read, and whose light is to be looked at: every EVERY-th.

    Cameras that begin together are looked at in turn from then on.
    """
    result, fresh = [], []
    for c, (memory, image) in enumerate(zip(memories, images, strict=True)):
        new = image is not None and (memory.age is None or memory.age + 1 >= EVERY)
        age = memory.age if image is None else c % EVERY if memory.age is None else (memory.age + 1) % EVERY
        result.append(memory._replace(age=age))
        fresh.append(new)
    return tuple(result), fresh


def after(uses: Sequence[CameraUse], fit: Fit) -> tuple[CameraUse, ...]:
    """What became of the pictures, of which so much was known before a pose was measured."""
    against = contradicting(fit)
    return tuple(
        CameraUse.CONTRADICTING if use is CameraUse.USED and (against[c] or c in fit.left_out) else use
        for c, use in enumerate(uses)
    )


class Agreement(NamedTuple):
    """What is remembered of how far the calibration is off."""

    disagreement: FloatArray | None = None
    """(S,) mean log likelihoods of `pose.agreement.SCALES`; None before the first look."""
    fitting: float = 1.0
    """Probability that the calibration leaves poses within 5 mm of the truth."""
    spread: float = 0.0
    """Variance [m²] along each axis of the errors that disagreement shows."""
    looks: int = 0
    age: int = EVERY
    """Pictures since the last look."""

    def due(self, expected: MotionState) -> bool:
        """Whether the cameras are to be asked again, about an object that is expected there."""
        return self.age + 1 >= EVERY and still(expected)

    def after(self, fit: Fit, expected: MotionState | None, *, lagging: bool = False) -> Agreement:
        """What is remembered after a pose of an object expected there; one that moves teaches nothing.

        lagging: whether the pictures were taken one after another.
        """
        if fit.disagreement is None:
            return self._replace(age=self.age + 1)
        if expected is None or not still(expected) or (lagging and expected.at_rest < RESTS):
            # It is all that is known of a first picture, unless what moved in between looks like it.
            if self.disagreement is None and not lagging:
                return self._replace(fitting=fits(fit), spread=spread(fit.disagreement), age=self.age + 1)
            return self._replace(age=self.age + 1)
        looked = fit.disagreement - fit.disagreement.max()
        before = looked if self.disagreement is None else self.disagreement
        mean = (1.0 - SHARE) * before + SHARE * looked
        return Agreement(mean, probably_fits(mean), spread(mean), self.looks + 1, 0)

    @property
    def contradicts(self) -> bool:
        """Whether the cameras contradict each other lastingly: the calibration is of others."""
        return self.looks >= LOOKS and contradict(self.disagreement)


def still(state: MotionState) -> bool:
    """Whether an object does not move so much that the cameras' moments matter."""
    return all(
        float(np.linalg.norm(part)) < limit
        for part, limit in zip((state.velocity[:3], state.velocity[3:]), STILL, strict=True)
    )
