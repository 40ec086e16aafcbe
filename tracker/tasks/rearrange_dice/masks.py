"""Masks as callers have them: of 0 and 1, of 0 and 255, or bool."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from tracker.conventions import Image
from tracker.errors import TaskError


def as_mask(value: npt.ArrayLike, what: str, size: tuple[int, int] | None = None) -> Image:
    """The mask (H, W) as uint8, of 0 and 1 or of 0 and 255.

    Args:
        value: (H, W) of bool or whole numbers.
        what: its name, for errors.
        size: (H, W) that it must have.

    Raises:
        TaskError: it is of another shape or type, or not two-valued.
    """
    mask = np.ascontiguousarray(value)
    if mask.dtype == np.bool_:
        mask = mask.view(np.uint8)
    if mask.dtype.kind not in "ui":
        raise TaskError(f"{what}: found type {mask.dtype}, expected bool or whole numbers")
    if mask.ndim != 2 or mask.size == 0:
        raise TaskError(f"{what}: found shape {mask.shape}, expected (height, width)")
    if size is not None and mask.shape != size:
        raise TaskError(f"{what}: found shape {mask.shape}, expected {size}")
    if mask.dtype != np.uint8:
        if mask.min() < 0 or mask.max() > 255:
            raise _not_two_valued(mask, what)
        mask = mask.astype(np.uint8)
    highest = int(cv2.norm(mask, cv2.NORM_INF))
    if highest not in (0, 1, 255) or cv2.norm(mask, cv2.NORM_L1) != highest * cv2.countNonZero(mask):
        raise _not_two_valued(mask, what)
    return mask


def _not_two_valued(mask: npt.NDArray[np.integer], what: str) -> TaskError:
    found = np.unique(mask)
    few = ", ".join(str(value) for value in found[:4])
    more = ", …" if len(found) > 4 else ""
    return TaskError(f"{what}: found the values {few}{more}, expected only 0 and 255, or only 0 and 1")
