"""Remarks on images: why an object is not found, or seems to be off the table.

Likely causes are swapped cameras, images of something else, and poor exposure or focus.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from tracker.calibration.board.sighting import grey, photo_blur
from tracker.calibration.by_object import health
from tracker.calibration.rig import CameraRig
from tracker.checks import shows
from tracker.conventions import Image
from tracker.errors import TrackerError
from tracker.geometry.arena import SLACK, Arena
from tracker.logs import open_log
from tracker.objects.model import CuboidModel, object_names
from tracker.pipeline import ObjectTracker
from tracker.pose.result import CameraUse, Observation, PoseEstimate, Status
from tracker.poses.poses import Poses
from tracker.recordings.track import Job, chosen, rig_for
from tracker.segmentation.light import find_light
from tracker.summaries.summary import SURE, camera_shares, to_look_at

UNSURE = 0.75
"""Confidence below which images do not fit the cameras; from SURE on they do."""

TRUSTED = 0.5
"""Confidence from which a pose is the object's, even if a camera contradicts it."""

_MOST_CAMERAS = 4  # up to this number of cameras all orders (24) are tried, above it only swapped pairs
_MOST_SETS = 7  # sets of images to check: motion blur or a finger may spoil some
_LEAST_RADIUS = 10.0  # of an arena in some image [px]
_MEASURED = 0.8  # a recording is checked if a smaller share of its frames has a measured pose

DOUBTFUL = (
    "the calibration is doubtful: the cameras contradict each other. One may have moved, or the files "
    "belong to other cameras; see tracker calibrate check"
)

OUT_OF_VIEW = (
    "the calibration shows the arena in few or no images, too small, or from below: tf_world_to_camera must "
    "be in metres, from world, z up, to camera, not back, z forward, y down; arena.toml in that world"
)


GREY = "the images have no colours: raw Bayer images must be demosaicked first, see docs/troubleshooting.md"

COLOURED = (
    "the background is coloured, so the faces seem to have other hues: "
    "learn them in this light, see tracker colors adapt"
)

_MOST_COLOUR = 1.6
"""Ratio of the background's channels above which it is coloured: wood has 2.2, recorded platforms 1.26."""


def swapped(
    tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation | None = None
) -> str | None:
    """Return a remark on the only order in which images fit the cameras, if it is not the given one.

    Also None if no order fits, or several do, as in a symmetric rig: the right one is then unknown. `answer`
    is the result of `tracker.detect(images)`, if known.
    """
    few = sum(image is not None for image in images) < 2
    if few or _confidence(answer or tracker.detect(images)) >= UNSURE:
        return None
    shapes = [None if image is None else image.shape for image in images]
    fitting = []
    for order in _orders(len(images)):
        if [shapes[k] for k in order] == shapes:
            confidence = _confidence(tracker.detect([images[k] for k in order]))
            fitting += [order] if confidence >= UNSURE else []
            if len(fitting) > 1 or UNSURE <= confidence < SURE:
                return None
    return swap_message(fitting[0], tracker.rig.names) if fitting else None


def mistaken(tracker: ObjectTracker, images: Sequence[Image | None]) -> str | None:
    """Return a remark if images fit with swapped channels, another built-in object or its own colours."""
    turned = [None if image is None else np.ascontiguousarray(image[..., ::-1]) for image in images]
    # Accept a contradicting camera, unlike `_confidence`: the object may be hidden from it.
    pose = tracker.detect(turned).object_pose
    rgb, name = 0.0 if pose is None else pose.confidence, tracker.model.name
    others = {other: type(tracker)(other, tracker.rig) for other in object_names()}
    if name in others and others[name].colors is tracker.colors:
        del others[name]
    fitting = [other for other, one in others.items() if _confidence(one.detect(images)) >= max(SURE, rgb)]
    if name in fitting:
        own = others[name].colors.name
        return f"{name} is found with the colour model {own}, not with {tracker.colors.name}"
    if fitting:
        return f"the images show {' or '.join(fitting)} rather than {name}"
    return f"{name} is found if red and blue are swapped: images must be BGR" if rgb >= UNSURE else None


def in_view(rig: CameraRig) -> bool:
    """Whether half of the images or more show the arena's centre from above its table, and large enough."""
    arena, count = rig.arena, 0
    places = np.add([*arena.center, arena.ground], arena.radius * np.eye(4, 3, k=-1))
    for camera in rig:
        centre, *ends = camera.project_in_view(places)
        above = arena.table is None or camera.position[2] > arena.table
        inside = (centre > -0.5).all() and (centre < [camera.width - 0.5, camera.height - 0.5]).all()
        # NaN: far out of the image
        count += bool(above and inside and not np.max(np.abs(ends - centre)) < _LEAST_RADIUS)
    return 2 * count >= len(rig)


def misplaced(tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation) -> str | None:
    """Return a remark on cameras out of view, swapped or moved, the background, or what is `mistaken`."""
    if not in_view(tracker.rig):
        return OUT_OF_VIEW  # even of a certain pose: the cameras left may be sure of a wrong one
    if _confidence(answer) >= UNSURE:
        return None
    lit = [image for image in images if shows(image)]
    if lit and not any(np.ptp(image, axis=2).any() for image in lit):
        return GREY
    remark, own = swapped(tracker, images, answer), answer.object_pose
    sure = own is not None and own.confidence >= TRUSTED
    moved = DOUBTFUL if sure and CameraUse.CONTRADICTING in answer.cameras else None
    gains = [find_light(image).gains for image in lit if tracker.colors.normalise]
    tinted = bool(gains) and np.median(np.max(gains, axis=1) / np.min(gains, axis=1)) > _MOST_COLOUR
    # The table's pixels in faces' colours contradict a pose, too.
    return remark or (COLOURED if tinted else moved or mistaken(tracker, images))


def likely_cause(tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation) -> str | None:
    """Return in one line why no certain pose is found; None if one is found, or no cause is known.

    A calibration out of view is reported even if one is. Swapped cameras, swapped channels and other objects
    are tried next; then exposure and sharpness, without which cameras contradict each other, too. Unless the
    pose is certain, this takes as long as several detections. `answer` is that of `tracker.detect(images)`.
    """
    cause = misplaced(tracker, images, answer)
    if cause not in (None, DOUBTFUL) or _confidence(answer) >= UNSURE:
        return cause
    given = [(name, one) for name, one in zip(tracker.rig.names, images, strict=True) if one is not None]
    faults = [f"{name}: {fault}" for name, image in given for fault in PictureLook.of(image).faults()]
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{faults[0]}{more}" if faults else cause


def lasting_remark(tracker: ObjectTracker, sets: Iterable[Sequence[Image | None]]) -> str | None:
    """Like `likely_cause` for a recording, without exposure and sharpness: two sets of images must agree."""
    found: list[str | None] = []
    # A driver error leaves a frame without images; black ones show nothing.
    some = (images for images in sets if any(map(shows, images)))
    for images in itertools.islice(some, _MOST_SETS):
        answer = tracker.detect(images)
        if _confidence(answer) >= SURE:
            return None
        found.append(misplaced(tracker, images, answer))
        if found[-1] in found[:-1] and found[-1] is not None:
            return found[-1]
    return None


def remark_on_recording(job: Job, poses: Poses) -> str | None:
    """Return the `lasting_remark` on a recording that was tracked badly, if there is one.

    Also None if the recording can no longer be read: its poses remain valid.
    """
    if not len(poses) or not _is_odd(poses):
        return None
    with suppress(TrackerError, OSError), open_log(job.log, recover=True) as log:
        rig = rig_for(job, log)
        frames = chosen(job.log, len(log), job.recipe.start, job.recipe.stop)
        # Without random access, use the first frames.
        step = max(1, len(frames) // _MOST_SETS) if log.random_access else 1
        sets = (frame.images for frame in log[frames.start : frames.stop : step])
        tracker = job.recipe.make_tracker(job.recipe.model, rig, job.recipe.colors)
        return lasting_remark(tracker, sets)
    return None


def swap_message(order: Sequence[int], names: Sequence[str]) -> str:
    """Return a one-line warning about cameras in the wrong order: for each, the number of its image."""
    moved = [name for k, name in enumerate(names) if order[k] != k]
    text = f"the images of {', '.join(moved[:-1])} and {moved[-1]} look swapped"
    if len(moved) == 2:
        return text
    return f"{text}: " + ", ".join(f"{names[k]}'s fits {names[c]}" for c, k in enumerate(order) if c != k)


def _is_odd(poses: Poses) -> bool:
    found = poses.measured.has_pose
    if np.mean(found) < _MEASURED or np.median(poses.measured.confidence[found]) < UNSURE:
        return True
    cameras = to_look_at(camera_shares(poses) or {})
    return any(CameraUse.CONTRADICTING in uses for uses in cameras.values())


def _orders(count: int) -> Iterable[tuple[int, ...]]:
    straight = tuple(range(count))
    if count <= _MOST_CAMERAS:
        return (order for order in itertools.permutations(straight) if order != straight)
    return (tuple({a: b, b: a}.get(k, k) for k in straight) for a, b in itertools.combinations(straight, 2))


def _confidence(answer: Observation) -> float:
    """Return the confidence of a pose that no camera contradicts; 0 if there is none."""
    if answer.object_pose is None or answer.status is not Status.FOUND:
        return 0.0
    return 0.0 if CameraUse.CONTRADICTING in answer.cameras else answer.object_pose.confidence


def off_table(pose: PoseEstimate | None, model: CuboidModel, arena: Arena) -> str | None:
    """Return in one line how far an object that seems to rest is off the table, and the remedy.

    It seems to rest if a face is level, and within the uncertainty of the table's height. None if the
    pose is doubtful, or off by less than two standard deviations or HEIGHT's limit, or its height is unknown.
    """
    if pose is None or pose.confidence < TRUSTED:
        return None
    height = health.height_over_table(pose.position, pose.rotation, model, arena)
    std = 1e3 * math.sqrt(pose.covariance[2, 2])
    highest = SLACK * 1e3 * math.hypot(arena.table_std[0], 1e-3 * std)
    if not max(2.0 * std, health.HEIGHT.limits[1]) < abs(height) <= highest:
        return None
    where = "floats {:.1f} mm above" if height > 0 else "sinks {:.1f} mm into"
    return (
        f"{model.name} {where.format(abs(height))} the table (± {std:.1f} mm): if it rests, "
        "`tracker calibrate table RECORDING --object OBJECT -o DIR` corrects this"
    )


MOST_BLUR = 2.5
"""Largest standard deviation [px] of the blur; above it, an image is called blurred."""


class PictureLook(NamedTuple):
    """Exposure and sharpness of an image, or their medians over several."""

    level: float
    """Median grey level."""
    clipped: float
    """Share of pixels with a clipped channel [%]."""
    blur: float
    """Blur of the strongest edges [px]; NaN if there are none."""

    @classmethod
    def of(cls, image: Image) -> PictureLook:
        """Measure an image (H, W, 3); takes a few milliseconds."""
        return cls(health.brightness(image), health.clipped_share(image), photo_blur(grey(image)))

    def faults(self) -> list[str]:
        """Return the faults with possible remedies."""
        found = []
        dark, bright = health.QUANTITIES["brightness"].limits
        if self.level < dark:
            found.append(f"dark, median grey level {self.level:.0f}: expose longer; is the lens covered?")
        if self.level > bright or self.clipped > health.QUANTITIES["clipping"].limits[1]:
            found.append(
                f"over-exposed, median grey level {self.level:.0f}, {self.clipped:.0f} % of its pixels are "
                "clipped: expose less"
            )
        if self.blur > MOST_BLUR:
            found.append(f"blurred by {self.blur:.1f} px: check the focus; does the camera shake?")
        return found
