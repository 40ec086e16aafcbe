"""By how much each camera misses what the others, or the corners of a board, tell it to see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.calibration.by_object.check import LIMIT, CalibrationCheck, CameraCheck
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.viz import paint

GOOD: paint.Color = (120, 200, 110)
BAD: paint.Color = (80, 110, 245)

_SIDE, _HEAD = 420, 76
"""Size of a camera's panel and height of the text above it [px]."""

_SHOWN = 4.0
"""Misses that a panel shows [limits]."""

_WIDTH = 1080
"""Of the picture of residuals [px]."""
_STRIP = 40
"""Height [px] of the line of text below."""

_LONG = 0.02
"""How long the RMS is drawn [picture's width]."""


def check_picture(found: CalibrationCheck, rig: CameraRig) -> Image:
    """A picture (H, W, 3) BGR: a panel for each camera, in it a dot for each look.

    A dot's distance from the middle is by how much the camera misses the object where the others have it,
    right and down as in its picture; the ring is the limit.
    """
    picture: Image = np.full((_SIDE + _HEAD, _SIDE * len(rig), 3), paint.BACKGROUND, np.uint8)
    for c, (camera, one) in enumerate(zip(rig, found.cameras, strict=True)):
        limit = LIMIT * float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        panel = picture[:, c * _SIDE : (c + 1) * _SIDE]
        bad = one.moved or found.is_lost(one)
        paint.put_text(panel, one.name, (16, 26), paint.BRIGHT, size=12)
        paint.put_text(panel, verdict(found, one), (16, 50), BAD if bad else GOOD, size=9)
        _dots(panel[_HEAD:], found.misses[:, c], limit, BAD if bad else GOOD)
        paint.put_text(panel, f"ring: {limit:.1f} px", (16, _HEAD + _SIDE - 12), paint.FAINT, size=9)
    return picture


def verdict(found: CalibrationCheck, one: CameraCheck) -> str:
    """What is said of a camera, in a line."""
    if one.moved:
        return f"moved: {1e3 * one.shift:.1f} mm, {np.degrees(one.turn):.2f}°"
    if found.is_lost(one):
        return "should see the object, and cannot use what it shows"
    return "not asked" if np.isnan(one.miss_px) else f"misses the others by {one.miss_px:.2f} px"


def _dots(panel: Image, misses: FloatArray, limit: float, color: paint.Color) -> None:
    middle, scale = np.array([_SIDE / 2, _SIDE / 2]), _SIDE / 2 / (_SHOWN * limit)
    cross = [
        middle + np.array([[-1, 0], [1, 0]]) * _SIDE / 2,
        middle + np.array([[0, -1], [0, 1]]) * _SIDE / 2,
    ]
    paint.stroke(panel, cross, paint.FAINT, 1.0, 0.4)
    paint.stroke(panel, [paint.circle(middle, limit * scale)], paint.FAINT, 1.5)
    for miss in misses[np.isfinite(misses).all(axis=1)]:
        at = middle + np.clip(miss * scale, -_SIDE / 2 + 6, _SIDE / 2 - 6)
        paint.fill(panel, paint.circle(at, 4.0), color, 0.8)


def residual_picture(
    title: str,
    size: tuple[int, int],
    photos: Sequence[tuple[FloatArray, FloatArray, bool]],
) -> Image:
    """A picture (H, W, 3) BGR of all photos of a camera, one over the other.

    Args:
        title: what stands below.
        size: width and height of the photos [px].
        photos: of each the corners (N, 2) [px], what is missed there (N, 2) [px], and whether the
            calibration rests on it; the lines of those on which it does not are red.
    """
    scale = _WIDTH / size[0]
    height = round(size[1] * scale)
    picture: Image = np.full((height + _STRIP, _WIDTH, 3), paint.BACKGROUND, np.uint8)
    used = [missed for _, missed, counts in photos if counts]
    rms = float(np.sqrt((np.concatenate(used) ** 2).sum(axis=1).mean())) if used else 0.0
    longer = _LONG * _WIDTH / max(rms, 1e-6)
    for pixels, missed, counts in photos:
        color = GOOD if counts else BAD
        starts = (pixels + 0.5) * scale - 0.5
        ends = starts + np.clip(missed * longer, -_WIDTH / 4, _WIDTH / 4)
        paint.stroke(picture[:height], list(np.stack([starts, ends], axis=1)), color, 1.5)
        paint.stroke(picture[:height], [paint.circle(start, 2.0) for start in starts], color, 1.0)
    left, bar = 16, longer * rms
    paint.stroke(picture, [np.array([[left, height + 20.0], [left + bar, height + 20.0]])], paint.BRIGHT, 2.0)
    at = (left + bar + 12, height + 25.0)
    paint.put_text(picture, f"{rms:.2f} px RMS   {title}", at, paint.BRIGHT, size=11)
    return picture
