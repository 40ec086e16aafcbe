"""What is remembered of each camera: whether its picture is new, its light, its noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, Image
from tracker.pose.result import CameraUse
from tracker.segmentation.noise import noise_level

EVERY = 5
"""Pictures of a camera after which its light and noise are looked at again."""

ROWS = 12
"""Rows of pixels that tell whether a picture has changed."""

NOISELESS = 0.5
"""Standard deviation of a picture's noise [levels] up to which it may stay the same."""

BLACK = 12
"""Level that some pixel of a picture must exceed [levels]."""


class CameraMemory(NamedTuple):
    """What is remembered of one camera."""

    sample: Array | None = None
    """Some rows of its last picture."""
    age: int | None = None
    """Pictures since its light was last looked at; None: it never was."""
    doubt: int = 0
    """How often of late it did not see what the others see; see `doubt`."""


def usable(
    memories: Sequence[CameraMemory], images: Sequence[Image | None]
) -> tuple[list[CameraMemory], list[Image | None], list[CameraUse]]:
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
    return remembered, result, uses


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
