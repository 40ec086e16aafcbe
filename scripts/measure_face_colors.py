"""Measure the colours of faces in the platform's labelled images, for rendering.

    python scripts/measure_face_colors.py REAL_FOLDER

REAL_FOLDER holds `pose/OBJECT`, `segmentation/OBJECT` and `dice`. Writes
synthetic/look/data/face_colors.json.
An object at rest shows one face from above, whose pixels are the highest in the image, and others from the
side, which get less light; the table states which it was.
"""

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fit_shipped_colors import dice_image

from benchmarks.data.recorded import SEGMENTED, labelled_images
from synthetic.camera.sensor import RESPONSE_GAMMA, linear
from tracker.color_learning.labelled import LabelledImage
from tracker.conventions import Array, FloatArray, Image
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation.light import TARGET_GREY, find_light

DATA = Path(__file__).resolve().parent.parent / "synthetic" / "look" / "data" / "face_colors.json"

MIN_PIXELS = 20
"""Smallest number of pixels of a mask without its rim; smaller masks keep their rim."""

BLOCK = 8
"""Side of the squares whose means average out noise, but not dirt [px]."""


def inner(mask: Array) -> Array:
    """Return a mask without its rim, where two surfaces mix; unchanged if too little would be left."""
    smaller = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return smaller if smaller.sum() >= MIN_PIXELS else mask


def dirt(image: Image, mask: Array) -> float | None:
    """Return the relative standard deviation of the strongest channel's light between squares, or None."""
    channel = int(np.argmax(np.median(image[mask], axis=0)))
    light = linear(image[..., channel])
    if np.median(image[mask][:, channel]) > 245:  # nothing varies where the sensor is saturated
        return None
    rows, columns = (n // BLOCK * BLOCK for n in mask.shape)
    shape = (rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
    whole = mask[:rows, :columns].reshape(shape).all(axis=(1, 3))
    means = light[:rows, :columns].reshape(shape).mean(axis=(1, 3))[whole]
    return float(means.std() / means.mean()) if len(means) >= 6 else None


def measure(images: list[LabelledImage]) -> dict[str, Any]:
    """Return the measurements of one object's colours."""
    seen: dict[str, list[tuple[FloatArray, bool, float | None]]] = {}
    for labelled in images:
        gains = find_light(labelled.image).gains
        present = [int(label) for label in np.unique(labelled.labels) if label]
        heights = [np.nonzero(labelled.labels == label)[0].mean() for label in present]
        for label, height in zip(present, heights, strict=True):
            mask = inner(labelled.labels == label)
            level = np.median(labelled.image[mask], axis=0) * gains
            entry = (level, height == min(heights), dirt(labelled.image, mask))
            seen.setdefault(COLOR_NAMES[label], []).append(entry)
    result = {}
    for color in sorted(seen, key=COLOR_NAMES.index):
        levels = np.array([entry[0] for entry in seen[color]])
        dirts = [entry[2] for entry in seen[color] if entry[2] is not None]
        result[color] = {
            "bgr": [round(v) for v in np.median(levels, axis=0).tolist()],
            "from_above": round(float(np.mean([entry[1] for entry in seen[color]])), 2),
            "images": len(levels),
            "spread": round(float(levels.max(axis=1).std() / levels.max(axis=1).mean()), 3),
            "dirt": round(float(np.median(dirts)), 3) if dirts else None,
        }
    return result


def main(real: Path) -> None:
    """Measure and write the table."""
    objects = {name: measure(labelled_images(real, name)) for name in SEGMENTED}
    objects["dice"] = measure([dice_image(real)])
    about = (
        "Medians of labelled images in which the scene's greys are brought to `grey`; `from_above`: share of "
        "the images in which it is the upper face; `spread`: relative standard deviation between images; "
        "`dirt`: relative standard deviation of light over a face."
    )
    table = {"about": about, "grey": TARGET_GREY, "gamma": RESPONSE_GAMMA, "objects": objects}
    DATA.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    for name, colors in objects.items():
        for color, entry in colors.items():
            print(name, color, *(f"{key} {value}" for key, value in entry.items()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
