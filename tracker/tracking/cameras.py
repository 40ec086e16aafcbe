"""State of the cameras between frames: changes of their images, measurements of light, their agreement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.checks import is_black, sampled
from tracker.conventions import FloatArray, Image
from tracker.pose.agreement import CONTRADICTION, probably_fits, size
from tracker.pose.fit import Fit
from tracker.pose.judge import contradicting, fits, supporters
from tracker.pose.result import CameraUse
from tracker.segmentation.sensor import noise_level
from tracker.tracking.motion import MotionState

EVERY = 5
"""Number of frames between two measurements of a camera's light, and between two checks of agreement."""

NOISELESS = 0.5
"""Standard deviation of an image's noise up to which an unchanged image does not count as frozen [levels]."""

FADING = 0.8
"""Factor on the evidence of earlier checks at each new one, as cameras may move: about five count."""

MOST = 6.0
"""Largest log likelihood of one check against a scale of errors: one in a hundred mistakes another object,
or the object's first motion, for a camera that is far off, and must not outweigh all others."""

LOOKS = round(1 / (1 - FADING))
"""Number of checks before a contradiction counts as lasting: as many as count."""

SLOW = 0.005, math.radians(5)
"""Speeds below which an object may be at rest [m/s, rad/s]: cameras that are read one after the other see a
moving object in different places."""

RESTS = 0.9
"""Smallest probability of rest at which images that were taken one after another are used for the check: if
the velocity is not known yet, they show the motion instead."""

READ = 0.012
"""Cameras that are read within this time [s], as the platform's are, are checked as if they were read at the
same time: an object hardly moves meanwhile."""


class CameraMemory(NamedTuple):
    """The state of one camera between frames."""

    sample: bytes | None = None
    """Some rows of its last image."""
    age: int | None = None
    """Number of images since its light was last measured; None: never."""


def usable(images: Sequence[Image | None]) -> tuple[list[Image | None], tuple[CameraUse, ...]]:
    """Drop black images; also return the use of each image."""
    missing, dark = CameraUse.NO_IMAGE, CameraUse.BLACK
    uses = tuple(missing if one is None else dark if is_black(one) else CameraUse.USED for one in images)
    return [one if use is CameraUse.USED else None for one, use in zip(images, uses, strict=True)], uses


def unfrozen(
    memories: Sequence[CameraMemory], images: Sequence[Image | None], uses: Sequence[CameraUse]
) -> tuple[tuple[CameraMemory, ...], list[Image | None], tuple[CameraUse, ...]]:
    """Drop frozen images: unchanged, noise and all, while other cameras' images change."""
    remembered, result, marked, unchanged = list(memories), list(images), list(uses), []
    others_change = False
    for c, image in enumerate(images):
        if image is None:
            continue
        remembered[c] = memories[c]._replace(sample=sampled(image).tobytes())
        if remembered[c].sample == memories[c].sample:
            unchanged.append((c, image))
        else:
            others_change = True
    for c, image in unchanged if others_change else ():
        # Rendered images have no noise: they stay identical if nothing moves.
        if noise_level(image) > NOISELESS:
            result[c], marked[c] = None, CameraUse.FROZEN
    return tuple(remembered), result, tuple(marked)


def looked_at(
    memories: Sequence[CameraMemory], images: Sequence[Image | None]
) -> tuple[tuple[CameraMemory, ...], list[bool]]:
    """Return the new memories, and for each camera whether to measure its light: every EVERY-th image.

    Cameras that begin together take turns from then on.
    """
    result, fresh = [], []
    for c, (memory, image) in enumerate(zip(memories, images, strict=True)):
        new = image is not None and (memory.age is None or memory.age + 1 >= EVERY)
        age = memory.age if image is None else c % EVERY if memory.age is None else (memory.age + 1) % EVERY
        result.append(CameraMemory(memory.sample, age))
        fresh.append(new)
    return tuple(result), fresh


def after(uses: Sequence[CameraUse], fit: Fit) -> tuple[CameraUse, ...]:
    """Return the use of each image after a fit, given the use before: mark those that contradict the fit.

    An image that was left out contradicts if it shows the object; otherwise the object is only hidden.
    """
    against = contradicting(fit)
    left_out = [c in fit.left_out and one.shows > 0.5 for c, one in enumerate(fit.counts)]
    return tuple(
        CameraUse.CONTRADICTING if use is CameraUse.USED and (against[c] or left_out[c]) else use
        for c, use in enumerate(uses)
    )


class Agreement(NamedTuple):
    """Running estimate of the calibration's errors, from checks of how well the cameras agree."""

    disagreement: FloatArray | None = None
    """(S,) log likelihoods of `pose.agreement.SCALES`, faded; None before the first check."""
    fitting: float = 1.0
    """Probability that the calibration leaves poses within 5 mm of the truth."""
    size: float = 0.0
    """How far the cameras disagree [m]."""
    looks: int = 0
    age: int = EVERY
    """Number of frames since the last check."""

    def due(self, expected: MotionState) -> bool:
        """Whether to check the cameras again, given the predicted state of the object."""
        return self.age + 1 >= EVERY and slow(expected.velocity)

    def after(self, fit: Fit, expected: MotionState | None, *, lagging: bool = False) -> Agreement:
        """Return the estimate after a fit, given the predicted state; moving objects do not count.

        lagging: whether the images were taken one after another, more than READ apart.
        """
        if fit.disagreement is None:
            return self._replace(age=self.age + 1)
        if expected is None or not slow(expected.velocity) or (lagging and expected.at_rest < RESTS):
            # In the first frame nothing better is known. With lagging images, motion looks like disagreement.
            if self.disagreement is None and not lagging:
                return self._replace(fitting=fits(fit), size=size(fit.disagreement), age=self.age + 1)
            return self._replace(age=self.age + 1)
        total = np.maximum(fit.disagreement - fit.disagreement.max(), -MOST)
        if self.disagreement is not None:
            total += FADING * self.disagreement
        return Agreement(total, probably_fits(total, supporters(fit)), size(total), self.looks + 1, 0)

    @property
    def contradicts(self) -> bool:
        """Whether the cameras persistently contradict each other: the calibration is not theirs."""
        return self.looks >= LOOKS and self.size > CONTRADICTION


def slow(velocity: FloatArray) -> bool:
    """Whether an object with a velocity (6,) [m/s, rad/s] may be at rest."""
    return math.hypot(*velocity[:3]) < SLOW[0] and math.hypot(*velocity[3:]) < SLOW[1]
