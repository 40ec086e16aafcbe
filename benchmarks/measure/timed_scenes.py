"""The pictures on which the tracker is timed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tracker
from benchmarks.data.recorded import triplet
from synthetic.camera.rigs import default_cameras, sized, standard_rig
from synthetic.camera.sensor import Sensor
from synthetic.frames import frames
from synthetic.stills import scene_with_fingers, take
from tracker.conventions import FloatArray, Image

OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")
SEED = 31
"""Of the timed scenes; other than the one that accuracy is judged on."""

MIN_FACE_PX = 20
"""Visible pixels from which on a face counts as in view."""


@dataclass(frozen=True, eq=False)
class TimedScene:
    """One picture of each camera, and the truth where it is known."""

    images: Sequence[Image | None]
    """(H, W, 3) uint8 BGR of each camera of the rig, None where the camera gives none."""
    position: FloatArray | None = None
    """(3,) the object's centre [m]."""
    rotation: FloatArray | None = None
    """(3, 3) world from object."""
    faces: int = 0
    """Faces in view, summed over the cameras: a face that two cameras see counts twice."""
    timestamp: float = 0.0
    """Of a film's frame [s]."""

    def seen_by(self, cameras: Iterable[int]) -> TimedScene:
        """The same scene with the images of these cameras only."""
        kept = set(cameras)
        images = [image if k in kept else None for k, image in enumerate(self.images)]
        return dataclasses.replace(self, images=images)


def platform_scenes(name: str, count: int, **more: Any) -> tuple[tracker.CameraRig, list[TimedScene]]:
    """Rig and scenes of the simulated platform with fingers and realistic cameras.

    Args:
        name: of the object.
        count: of scenes.
        more: fields of `FrameOptions`.
    """
    rig = sized(standard_rig(), 270)
    scenes = []
    for frame in frames(name, count, SEED, rig=rig, empty=0.0, **more):
        (state,) = frame.objects
        faces = _faces(frame.labels)
        scenes.append(TimedScene(frame.images, state.position, state.rotation, faces, frame.timestamp))
    return rig, scenes


def platform_film(name: str, count: int) -> tuple[tracker.CameraRig, list[TimedScene]]:
    """The same of a film at 10 Hz in which the fingers carry the object about."""
    return platform_scenes(name, count, sequence=True, kind="carry", dropped=0.0)


def sized_scenes(name: str, count: int, size: int) -> tuple[tracker.CameraRig, list[TimedScene]]:
    """Rig and scenes with fingers at any size [px]; scene k is the same at all sizes, and so is its light."""
    # Noise takes more draws of larger pictures: with drawn gains the light would depend on the size.
    sensor = dataclasses.replace(Sensor.realistic(), exposure=(1.0, 1.0), white_balance=0.0, ramp=0.0)
    model, rig = tracker.load_object(name), tracker.CameraRig(default_cameras(size))
    scenes = []
    for k in range(count):
        rng = np.random.default_rng([SEED, k])
        made = take(scene_with_fingers(model, rng), rig.cameras, sensor, rng)
        scenes.append(TimedScene(made.images, made.position, made.rotation, _faces(made.labels)))
    return rig, scenes


def recorded_scene(real: Path, name: str) -> tuple[tracker.ObjectTracker, TimedScene]:
    """The recorded triplet of an object, whose pose nobody knows, and the tracker for it."""
    detector, images = triplet(real, name, corrected=False)
    return detector, TimedScene([image.image for image in images], faces=_faces([i.labels for i in images]))


def _faces(labels: Iterable[Image]) -> int:
    counts = [np.bincount(image.ravel(), minlength=7)[1:7] for image in labels]
    return int(np.sum(np.array(counts) >= MIN_FACE_PX))
