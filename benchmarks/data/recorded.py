"""Recorded, hand-labelled images of the real platform."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import tracker
from tracker.segmentation.labelled import LabelledImage, read_labelled

POSED = ("cube_v1", "cube_v2", "cuboid_2x2x8_v2")
SEGMENTED = ("cube_v1", "cube_v2", "cube_v3", "cuboid_2x2x8_v2")
CORRECTED = "principal point corrected"
"""Group of a triplet whose files are read with that correction, beside the one without."""


def labelled_images(real: Path, name: str) -> list[LabelledImage]:
    """All labelled images of one object."""
    folders = [real / kind / name for kind in ("pose", "segmentation")]
    return [image for folder in folders if folder.is_dir() for image in read_labelled(folder)]


def triplet(real: Path, name: str, *, corrected: bool) -> tuple[tracker.ObjectTracker, list[LabelledImage]]:
    """A tracker for the object's triplet, and its images in the cameras' order."""
    folder = real / "pose" / name
    images = {int(i.name.split("camera")[1]): i for i in read_labelled(folder)}
    rig = tracker.CameraRig.load(folder, correct_halved_principal_point=corrected)
    return tracker.ObjectTracker(tracker.load_object(name), rig), [images[c] for c in (60, 180, 300)]


def triplets(real: Path) -> Iterator[tuple[str, str, tracker.ObjectTracker, list[LabelledImage]]]:
    """Every recorded triplet: object, group (CORRECTED or empty), a tracker for it, and its images."""
    for name in POSED:
        for corrected in (False, True) if name == "cuboid_2x2x8_v2" else (False,):
            yield name, CORRECTED if corrected else "", *triplet(real, name, corrected=corrected)
