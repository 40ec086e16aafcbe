"""A contact sheet: what every kind of scene looks like."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from synthetic.frames import FrameMaker, FrameOptions
from synthetic.scene import PlatformScene
from synthetic.world.platform import Platform
from synthetic.world.scenes import kinds_of, random_scene
from tracker.conventions import Image

MOTIONS = ("push", "tumble", "drop", "lift", "carry")
SINGLE = ("cube_v1", "cube_v2", "cube_v3", "cuboid_2x2x8_v2", "dice")

_MOTION_OBJECT = "cube_v2"
_MOMENTS = (0, 15, 30)
"""Frames of a motion that are shown, each by another camera."""


def contact_sheet(seed: int, quality: str) -> tuple[Image, list[str]]:
    """A picture with three cameras a cell, two cells a row, and the title of each cell, row by row."""
    cells, titles = [], []
    for name in SINGLE:
        with FrameMaker(FrameOptions(name, seed, quality)) as maker:
            for number, (title, scene) in enumerate(_single_scenes(name, seed)):
                frame = maker.of_scene(number, scene)
                cells.append(np.hstack(frame.images))
                titles.append(f"{name}: {title}")
    for kind in MOTIONS:
        options = FrameOptions(_MOTION_OBJECT, seed, quality, sequence=True, kind=kind)
        with FrameMaker(options) as maker:
            steps = list(itertools.islice(maker.chunk(0, frozenset(_MOMENTS)), len(_MOMENTS)))
        cells.append(np.hstack([frame.images[camera] for camera, frame in enumerate(steps)]))
        stamps = ", ".join(f"{frame.timestamp:.1f} s" for frame in steps)
        titles.append(f"{_MOTION_OBJECT}: motion {kind}, one camera each at {stamps}")
    if len(cells) % 2:
        cells.append(np.zeros_like(cells[0]))
    rows = [np.hstack(pair) for pair in zip(cells[::2], cells[1::2], strict=True)]
    sheet: Image = np.vstack([_numbered(row, 2 * number) for number, row in enumerate(rows)])
    return sheet, titles


def _single_scenes(name: str, seed: int) -> list[tuple[str, PlatformScene]]:
    result = []
    with Platform(name) as platform:
        for number, kind in enumerate(kinds_of(platform)):
            rng = np.random.default_rng([seed, number])
            result.append((kind, random_scene(platform, rng, kind=kind)))
        rng = np.random.default_rng([seed, 100])
        result.append(("no robot", random_scene(platform, rng, fingers="none")))
        result.append(("no object", random_scene(platform, rng, object_present=False)))
    return result


def _numbered(row: Image, first: int) -> Image:
    for number, left in ((first, 0), (first + 1, row.shape[1] // 2)):
        cv2.putText(row, str(number), (left + 4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1)
    return row
