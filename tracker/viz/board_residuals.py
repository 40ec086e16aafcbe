"""Where corners of boards were seen in photos, and by how much a calibration misses them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.conventions import FloatArray, Image
from tracker.viz import paint

USED: paint.Color = (120, 200, 110)
REFUSED: paint.Color = (80, 110, 245)

_WIDTH = 1080
_STRIP = 40
"""Height [px] of the line of text below."""

_SHOWN = 0.02
"""How long the RMS is drawn [picture's width]."""


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
    longer = _SHOWN * _WIDTH / max(rms, 1e-6)
    for pixels, missed, counts in photos:
        color = USED if counts else REFUSED
        starts = (pixels + 0.5) * scale - 0.5
        ends = starts + np.clip(missed * longer, -_WIDTH / 4, _WIDTH / 4)
        paint.stroke(picture[:height], list(np.stack([starts, ends], axis=1)), color, 1.5)
        paint.stroke(picture[:height], [paint.circle(start, 2.0) for start in starts], color, 1.0)
    left, bar = 16, longer * rms
    paint.stroke(picture, [np.array([[left, height + 20.0], [left + bar, height + 20.0]])], paint.BRIGHT, 2.0)
    at = (left + bar + 12, height + 25.0)
    paint.put_text(picture, f"{rms:.2f} px RMS   {title}", at, paint.BRIGHT, size=11)
    return picture
