"""Remarks on what cameras show: why an object is not found, or seems to be off its table.

Pictures go to the wrong cameras, show something else, or are poor.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from tracker.calibration.board.sighting import photo_blur
from tracker.calibration.by_object.health import (
    HEIGHT,
    LEVELS,
    MOST_CLIPPED,
    brightness,
    clipped_share,
    height_over_table,
)
from tracker.conventions import Image
from tracker.errors import TrackerError
from tracker.geometry.arena import SURE as SURE_OF_TABLE
from tracker.geometry.arena import Arena
from tracker.logs import open_log
from tracker.objects.model import CuboidModel, object_names
from tracker.pipeline import ObjectTracker
from tracker.pose.result import CameraUse, Observation, PoseEstimate, Status
from tracker.poses.poses import Poses
from tracker.recordings.recipe import Job
from tracker.recordings.track import chosen, rig_for
from tracker.summaries.summary import camera_shares, to_look_at

SURE, UNSURE = 0.9, 0.75
"""Confidence from which pictures fit, and up to which they do not."""

_MOST_CAMERAS = 4  # for whose pictures all orders are tried, 24; with more only pairs are
_MOST_SETS = 7  # a motion that blurs them, or a finger, may spoil some
_AGREE = 2

_MEASURED = 0.8  # share of the frames with a measured pose below which a recording is looked at again


DOUBTFUL = (
    "the calibration is doubtful: the cameras contradict each other. One may have moved, or the files "
    "belong to other cameras; see tracker calibrate check"
)


def swapped(
    tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation | None = None
) -> tuple[int, ...] | None:
    """The one order in which pictures that do not fit the cameras do; None where none does, or several do.

    A rig that looks the same from each of its cameras leaves several: there the order stays unknown.

    Args:
        tracker: of the object and the cameras; `detect` is called.
        images: of the cameras, as they were given.
        answer: of `tracker.detect(images)`, if that is known.

    Returns:
        For each camera the number of the picture that fits it.
    """
    if sum(image is not None for image in images) < 2:
        return None
    if _confidence(answer or tracker.detect(images)) >= UNSURE:
        return None
    shapes = [None if image is None else image.shape for image in images]
    found = None
    for order in _orders(len(images)):
        if [shapes[k] for k in order] != shapes:
            continue
        confidence = _confidence(tracker.detect([images[k] for k in order]))
        if confidence < UNSURE:
            continue
        if confidence < SURE or found is not None:
            return None
        found = order
    return found


def mistaken(tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation) -> str | None:
    """What fits pictures that do not show the object: their channels swapped, or another shipped object."""
    if _confidence(answer) >= UNSURE:
        return None
    turned = [None if image is None else np.ascontiguousarray(image[..., ::-1]) for image in images]
    # A camera from which the object is hidden may seem to object: here that is no matter.
    pose = tracker.detect(turned).object_pose
    if pose is not None and pose.confidence >= UNSURE:
        return f"{tracker.model.name} is found if red and blue are swapped: images must be BGR"
    others = [name for name in object_names() if name != tracker.model.name]
    fitting = [
        name for name in others if _confidence(ObjectTracker(name, tracker.rig).detect(images)) >= SURE
    ]
    return f"the images show {' or '.join(fitting)} rather than {tracker.model.name}" if fitting else None


def likely_cause(tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation) -> str | None:
    """Why the object is not found, or not surely, in one line; None where it is, or nothing is wrong.

    What explains the pictures comes first, then what is wrong with them. Unless the pose is sure, this takes
    as long as several detections.

    Args:
        tracker: of the object and the cameras; `detect` is called.
        images: of the cameras.
        answer: of `tracker.detect(images)`.
    """
    order = swapped(tracker, images, answer)
    cause = mistaken(tracker, images, answer) if order is None else swap_message(order, tracker.rig.names)
    if cause is not None or _confidence(answer) >= UNSURE:
        return cause
    faults = []
    for name, image in zip(tracker.rig.names, images, strict=True):
        if image is not None:
            faults += [f"{name}: {fault}" for fault in PictureLook.of(image).faults()]
    more = f" ({len(faults) - 1} more such)" if len(faults) > 1 else ""
    return f"{faults[0]}{more}" if faults else None


def lastingly_swapped(
    tracker: ObjectTracker, sets: Iterable[Sequence[Image | None]]
) -> tuple[int, ...] | None:
    """The same of a recording, of which some sets of pictures are looked at: they have to agree."""
    orders = []
    for images in itertools.islice(sets, _MOST_SETS):
        answer = tracker.detect(images)
        if _confidence(answer) >= SURE:
            return None
        order = swapped(tracker, images, answer)
        if order is not None:
            orders.append(order)
            if len(orders) == _AGREE:
                break
    return orders[0] if len(orders) == _AGREE and len(set(orders)) == 1 else None


def remark_on_recording(job: Job, poses: Poses) -> str | None:
    """The `swap_message` of a tracked recording; looked at only if few poses came of it.

    None also where the recording cannot be read any more: its poses stay as they are.
    """
    if not len(poses) or not _is_odd(poses):
        return None
    try:
        with open_log(job.log, recover=True) as log:
            rig = rig_for(job, log)
            first, last = chosen(log, job)
            # Of a recording that has to be read through, the first frames.
            step = max(1, (last - first) // _MOST_SETS) if log.random_access else 1
            sets = (frame.images for frame in log[first:last:step])
            tracker = job.recipe.make_tracker(job.recipe.model, rig, job.recipe.colors)
            order = lastingly_swapped(tracker, sets)
    except (TrackerError, OSError):
        return None
    return None if order is None else swap_message(order, rig.names)


def swap_message(order: Sequence[int], names: Sequence[str]) -> str:
    """A warning of cameras in a wrong order, in one line."""
    moved = [name for k, name in enumerate(names) if order[k] != k]
    text = f"the images of {', '.join(moved[:-1])} and {moved[-1]} look swapped"
    if len(moved) == 2:
        return text
    return f"{text}: " + ", ".join(f"{names[k]}'s fits {names[c]}" for c, k in enumerate(order) if c != k)


def _is_odd(poses: Poses) -> bool:
    if np.mean(poses.measured.has_pose) < _MEASURED:
        return True
    cameras = to_look_at(camera_shares(poses) or {})
    return any(CameraUse.CONTRADICTING in uses for uses in cameras.values())


def _orders(count: int) -> Iterable[tuple[int, ...]]:
    straight = tuple(range(count))
    if count <= _MOST_CAMERAS:
        return (order for order in itertools.permutations(straight) if order != straight)
    return (tuple({a: b, b: a}.get(k, k) for k in straight) for a, b in itertools.combinations(straight, 2))


def _confidence(answer: Observation) -> float:
    """That of a pose to which no camera objects; 0 where there is none."""
    if answer.object_pose is None or answer.status is not Status.FOUND:
        return 0.0
    return 0.0 if CameraUse.CONTRADICTING in answer.cameras else answer.object_pose.confidence


TRUSTED = 0.5  # confidence from which a pose counts


def off_table(pose: PoseEstimate | None, model: CuboidModel, arena: Arena) -> str | None:
    """By how much an object is off the table on which it seems to rest, and the remedy, in one line.

    It seems to rest if a face is level, and no higher than the table may be. None if it is off by less than
    two standard deviations or the limit of HEIGHT, or nothing is known.
    """
    if pose is None or pose.confidence < TRUSTED:
        return None
    height = height_over_table(pose.position, pose.rotation, model, arena)
    std = 1e3 * math.sqrt(pose.covariance[2, 2])
    highest = SURE_OF_TABLE * 1e3 * math.hypot(arena.table_std[0], 1e-3 * std)
    if not max(2.0 * std, HEIGHT.limits[1]) < abs(height) <= highest:
        return None
    where = "floats {:.1f} mm above" if height > 0 else "sinks {:.1f} mm into"
    return (
        f"{model.name} {where.format(abs(height))} the table (± {std:.1f} mm): if it rests, "
        "`tracker calibrate table RECORDING -o DIR` corrects this"
    )


MOST_BLUR = 2.5  # standard deviation of the sharpest edges' blur [px]


class PictureLook(NamedTuple):
    """Exposure and sharpness of a picture, or their medians over several."""

    level: float
    """Median grey level."""
    clipped: float
    """Pixels with a clipped channel [%]."""
    blur: float
    """Of its strongest edges [px]; NaN where it shows none."""

    @classmethod
    def of(cls, image: Image) -> PictureLook:
        """Look at a picture (H, W, 3), which takes some milliseconds."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        return cls(brightness(image), 100 * clipped_share(image), photo_blur(grey))

    def faults(self) -> list[str]:
        """What is wrong, and what may help."""
        found = []
        if self.level < LEVELS[0]:
            found.append(f"dark, median grey level {self.level:.0f}: expose longer; is the lens covered?")
        if self.level > LEVELS[1] or self.clipped > 100 * MOST_CLIPPED:
            found.append(
                f"over-exposed, median grey level {self.level:.0f}, {self.clipped:.0f} % of its pixels are "
                "clipped: expose less"
            )
        if self.blur > MOST_BLUR:
            found.append(f"blurred by {self.blur:.1f} px: check the focus; does the camera shake?")
        return found
