"""Short rendered recordings of an object, with the label of every pixel."""

from pathlib import Path

import numpy as np

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers import RIG
from tests.helpers.kept_stills import take
from tests.helpers.log_writers import write_picture
from tests.helpers.stills import Still, scene_with_fingers
from tracker.color_learning.labelled import intersection_over_union
from tracker.color_learning.lessons import Frames


def shots(object_name: str, count: int, seed: int) -> list[Still]:
    """Pictures of scenes of their own."""
    model = tracker.load_object(object_name)
    result = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        result.append(take(scene_with_fingers(model, rng, near=0.3), RIG.cameras, Sensor.realistic(), rng))
    return result


def footage_of(film: list[Still]) -> Frames:
    frames = [tuple(shot.images) for shot in film]
    return Frames(RIG, tuple(frames[::2]), tuple(frames[1::2]))


def write_recording(folder: Path, film: list[Still]) -> Path:
    """A folder of pictures with its calibration."""
    for number, shot in enumerate(film):
        for camera, image in zip(RIG, shot.images, strict=True):
            write_picture(folder / f"{number:06d}" / f"{camera.name}.png", image)
    RIG.save(folder)
    return folder


def on_wood(image: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """The picture with a brown background."""
    return np.where(labels[..., None] > 0, image, image * np.array([0.42, 0.7, 1.0])).astype(np.uint8)


def overlap(film: list[Still], colors: tracker.ColorModel) -> float:
    """Mean intersection over union of the labels found and the true ones."""
    values = []
    for shot in film:
        for image, labels in zip(shot.images, shot.labels, strict=True):
            found = intersection_over_union(tracker.segment(image, colors), labels)
            values += [share for label, share in found.items() if np.count_nonzero(labels == label) >= 60]
    return float(np.mean(values))
