"""Colours of faces, measured on labelled images of the real platform.

`scripts/measure_face_colors.py` writes the table: medians, with the scene's greys scaled to level 115.
"""

import functools
import json
from importlib import resources
from typing import Any

import numpy as np

from synthetic.camera.sensor import BLACK, linear
from tracker.conventions import FloatArray
from tracker.objects.labels import COLOR_NAMES

TYPICAL_COLORS_BGR = np.array(
    [
        [0, 0, 0],
        [40, 50, 190],
        [60, 150, 70],
        [110, 50, 20],
        [150, 140, 60],
        [150, 60, 150],
        [50, 220, 220],
    ]
)
"""(7, 3) typical BGR value of each label's colour in an 8-bit image; label 0 is not a face."""
TYPICAL_COLORS_BGR.flags.writeable = False

SIDE_LIGHT = 0.4
"""Light on a side of an object at rest, relative to its upper face: in images, whose levels are about the
square root of light, paints seen on both are 1.4 to 1.9 times as bright on upper faces."""

DARKEST = 0.002
"""Smallest reflectance: dark channels of pure colours are 0 in images, yet no paint is black."""

_SUBSTITUTE = "cube_v2"
"""Object whose colours replace any that no labelled image shows: the cuboid's yellow is the same paint."""


@functools.cache
def _table() -> dict[str, Any]:
    text = (resources.files("synthetic.look") / "data" / "face_colors.json").read_text(encoding="utf-8")
    table: dict[str, Any] = json.loads(text)
    return table


def reflectances(colors: str) -> FloatArray:
    """Return (7, 3) linear BGR reflectance by label of the object with the colour model `colors`.

    In light of irradiance 1, a face has the level measured on upper faces in an image of exposure 1, whose
    greys are at level 115. Colours measured only on sides are scaled to the light on an upper face.
    """
    gamma, objects = float(_table()["gamma"]), _table()["objects"]
    entries = {**objects[_SUBSTITUTE], **objects[colors]} if colors in objects else {}
    result: FloatArray = (TYPICAL_COLORS_BGR / 255.0) ** gamma
    for color, entry in entries.items():
        light = 1.0 if entry["from_above"] > 0 else SIDE_LIGHT
        # The black level is subtracted in images; without adding it, dark channels would lose it twice.
        result[COLOR_NAMES.index(color)] = (linear(np.array(entry["bgr"]), gamma) + BLACK) / light
    result[1:] = np.clip(result[1:], DARKEST, 0.98)
    return result
