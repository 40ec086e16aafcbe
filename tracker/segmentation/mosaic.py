"""Whether an image is an interpolated colour mosaic, so that each pixel measured one colour only.

Cameras with a Bayer filter see blue, green or red at a pixel, and the other two colours there are means of
the neighbours' (`cv2.cvtColor` with `COLOR_Bayer…2BGR`). Such an image obeys these means to the bit.
"""

from __future__ import annotations

from tracker.compiled import compiled

NONE = -1
"""No mosaic, or one that later changes have made unrecognisable."""

STEP = 5
"""Pixels are looked at in every so many-th row and column; odd, so that all places of the pattern occur."""

ENOUGH = 100
"""Pixels that differ from their neighbours, by which a mosaic is told."""


@compiled
def _obeys(image, j, i, red):  # type: ignore[no-untyped-def]
    """Whether a pixel's colours are means of what its neighbours measured."""
    has_red, in_column = (j & 1) == red >> 1, (i & 1) == (red & 1)
    if has_red == in_column:
        # It measured red or blue.
        other = 0 if has_red else 2
        cross = int(image[j, i - 1, 1]) + image[j, i + 1, 1] + image[j - 1, i, 1] + image[j + 1, i, 1]
        corners = int(image[j - 1, i - 1, other]) + image[j - 1, i + 1, other]
        corners += int(image[j + 1, i - 1, other]) + image[j + 1, i + 1, other]
        return image[j, i, 1] == (cross + 2) >> 2 and image[j, i, other] == (corners + 2) >> 2
    beside, above = (2, 0) if has_red else (0, 2)
    left_right = int(image[j, i - 1, beside]) + image[j, i + 1, beside]
    up_down = int(image[j - 1, i, above]) + image[j + 1, i, above]
    return image[j, i, beside] == (left_right + 1) >> 1 and image[j, i, above] == (up_down + 1) >> 1


@compiled
def find_mosaic(image):  # type: ignore[no-untyped-def]
    """Which pixels of a mosaic measured red: 2 · (their row is odd) + (their column is odd), or NONE.

    Green is where one of both differs, blue where both do.

    Args:
        image: (H, W, 3) uint8 BGR.
    """
    height, width = image.shape[0], image.shape[1]
    for red in range(4):
        told, fits = 0, True
        for j in range(2, height - 2, STEP):
            for i in range(2, width - 2, STEP):
                flat = True
                for k in range(3):
                    flat &= image[j, i, k] == image[j, i - 1, k] and image[j, i, k] == image[j, i + 1, k]
                    flat &= image[j, i, k] == image[j - 1, i, k] and image[j, i, k] == image[j + 1, i, k]
                if flat:
                    continue
                fits = _obeys(image, j, i, red)
                if not fits:
                    break
                told += 1
            if not fits or told >= ENOUGH:
                break
        if fits and told >= ENOUGH:
            return red
    return NONE
