"""The health of a rig over a recording: what people look for by hand, measured on frames spread over it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from tracker.calibration.by_object.check import (
    APART,
    LIMIT,
    SURE,
    CalibrationCheck,
    check_calibration,
    look_of,
)
from tracker.calibration.by_object.looks import CameraErrors, Look
from tracker.calibration.by_object.sightings import slow
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.arena import Arena
from tracker.logs.log import Log, evenly, picked
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import apparent
from tracker.poses.poses import Poses
from tracker.segmentation.light import CLIPPED, find_light

LEVELS = (30.0, 200.0)
"""Between which a picture's brightness should be; recordings of the platform have 80 to 125."""

MOST_CLIPPED = 0.15
"""Largest share of clipped pixels in a good picture; recordings of the platform have 0 to 0.06."""


def brightness(image: Image) -> float:
    """Median grey level of a picture (H, W, 3); a lamp in view or a dark finger hardly changes it."""
    return float(np.median(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)))


def clipped_share(image: Image) -> float:
    """Share of the pixels of a picture (H, W, 3) with a channel that is clipped."""
    return float((image.max(axis=2) >= CLIPPED).mean())


MOST = 200
"""Frames that are looked at."""

LEVEL = float(np.cos(np.radians(3.0)))
"""Of the angle between a face and z = 0, up to which an object rests on it."""

OFTEN = 0.1
"""Share of the frames beyond a limit, from which on it is named."""


class Quantity(NamedTuple):
    """Something that is measured of each camera in each frame."""

    title: str
    unit: str
    limits: tuple[float, float]
    """Within which it is well."""
    advice: str
    """Where to look if it is not."""


QUANTITIES: Mapping[str, Quantity] = {
    "residual": Quantity(
        "Residual: edges of the object around the pose", "px of an object of 55 px", (0.0, 0.5),
        "a calibration that does not fit, an object of another size, or worn edges",
    ),
    "disagreement": Quantity(
        "Disagreement: by how much a camera misses what the others see, object at rest", "mrad",
        (0.0, 1e3 * LIMIT), "tracker calibrate check names the camera that moved",
    ),
    "brightness": Quantity(
        "Brightness of the picture, median grey level", "levels", LEVELS, "exposure, the lights of the arena"
    ),
    "clipping": Quantity(
        "Clipped pixels", "%", (0.0, 100.0 * MOST_CLIPPED), "exposure, reflections, a lamp in view"
    ),
    "blur": Quantity(
        "Sharpness: blur of the object's edges", "% of the picture's width", (0.0, 0.7),
        "focus, a dirty lens, exposure time where the object moves",
    ),
    "white balance": Quantity(
        "White balance: red over blue of the scene's greys", "%", (-45.0, 80.0),
        "the white balance is set at every start: start again with a grey scene in view",
    ),
}  # fmt: skip
"""What is measured of each camera, by its key; docs/health.md says why these limits."""

HEIGHT = Quantity(
    "Table: lowest point of the object at rest, over the arena's table", "mm", (-3.0, 3.0),
    "tracker calibrate table finds the table",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Health:
    """What was measured on n frames of C cameras; NaN where there is nothing."""

    index: Array
    """(n,) numbers of the frames."""
    time: FloatArray
    """(n,) since the first frame of the recording [s]."""
    cameras: tuple[str, ...]
    values: Mapping[str, FloatArray]
    """(n, C) of each of QUANTITIES."""
    height: FloatArray
    """(n,) as of HEIGHT."""
    check: CalibrationCheck | None
    """Whether the calibration fits; None: the object never rested in view of two cameras."""

    def beyond(self, key: str) -> FloatArray:
        """(C,) share of the frames in which a quantity is beyond its limits; NaN where not measured."""
        return np.array([_beyond(column, QUANTITIES[key]) for column in self.values[key].T])

    def complaints(self) -> list[str]:
        """What is not well, a line each."""
        result = []
        for key, quantity in QUANTITIES.items():
            for name, share in zip(self.cameras, self.beyond(key), strict=True):
                if share > OFTEN:
                    result.append(f"{name}: {key} beyond its limit in {share:.0%}: {quantity.advice}")
        if _beyond(self.height, HEIGHT) > 0.5:
            result.append(f"the object rests {np.nanmedian(self.height):+.1f} mm off: {HEIGHT.advice}")
        if self.check is not None and not self.check.fits:
            result.append("the calibration does not fit: tracker calibrate check says which camera moved")
        return result

    def missing(self) -> str | None:
        """What was never measured, and why, in one line; None where all was."""
        measured = {**self.values, "table": self.height}
        names = [key for key, values in measured.items() if not np.isfinite(values).any()]
        if not names:
            return None
        seen = np.isfinite(self.values["residual"]).any()
        why = "the object was not seen at rest" if seen else "the object was not surely found"
        return f"not measured: {', '.join(names)}; {why}"


def _beyond(values: FloatArray, quantity: Quantity) -> float:
    known = values[np.isfinite(values)]
    low, high = quantity.limits
    return float(np.mean((known < low) | (known > high))) if known.size else float("nan")


def health(
    tracker: ObjectTracker, log: Log, poses: Poses, progress: Callable[[int], None] = lambda _: None
) -> Health:
    """Measure a recording that was tracked; `progress` takes how many more frames were looked at.

    LogError: the recording is damaged; ImageError: a picture is not what the tracker's cameras give.
    """
    rows = evenly(len(poses), MOST)
    count, rig, filtered = len(tracker.rig), tracker.rig, poses.filtered
    values = {key: np.full((len(rows), count), np.nan) for key in QUANTITIES}
    height = np.full(len(rows), np.nan)
    looks: list[Look] = []
    looked: list[int] = []
    last = -APART
    for n, frame in enumerate(picked(log, poses.index[rows].tolist())):
        row = rows[n]
        still = slow(filtered.velocity[row]) if filtered.has_pose[row] else len(poses) == 1
        found = sample(tracker, frame.images, still=still)
        for key, value in found.values.items():
            values[key][n] = value
        height[n] = found.height
        # Pictures of one place say the same again, and nothing more.
        if found.look is not None and frame.index >= last + APART:
            last = frame.index
            looks.append(found.look)
            looked.append(n)
        progress(1)
    check = None
    if looks and count > 1:
        values["disagreement"][looked] = disagreement(looks, rig)
        check = check_calibration(looks, rig.cameras)
    start = poses.timestamp[0] if len(poses) else 0.0
    return Health(poses.index[rows], poses.timestamp[rows] - start, tuple(rig.names), values, height, check)


class Sample(NamedTuple):
    """What the pictures of one moment tell; NaN where there is nothing."""

    values: Mapping[str, FloatArray]
    """(C,) of each of QUANTITIES but the disagreement."""
    height: float
    """As of HEIGHT."""
    look: Look | None
    """Where each camera sees an object at rest, if it is seen by one or more."""


def sample(tracker: ObjectTracker, images: Sequence[Image | None], *, still: bool) -> Sample:
    """Measure the pictures (H, W, 3) uint8 BGR of one moment; the tracker's memory is not used or changed.

    still: whether the object does not move: else table and disagreement stay unknown.
    ImageError: a picture is not what the tracker's cameras give.
    """
    values = {key: np.full(len(tracker.rig), np.nan) for key in QUANTITIES if key != "disagreement"}
    height, look = float("nan"), None
    for c, image in enumerate(images):
        if image is not None:
            for key, value in of_picture(image).items():
                values[key][c] = value
    if any(image is not None for image in images):
        fit = tracker.fit(images)
        if isinstance(fit, Fit) and apparent(fit) >= SURE:
            for c, (camera, seen) in enumerate(zip(tracker.rig, fit.cameras, strict=True)):
                if seen["inliers"] >= 1.0:
                    values["residual"][c] = np.sqrt(seen["squares"] / seen["inliers"])
                    values["blur"][c] = 100.0 * seen["blur"] / camera.width
            if still:
                height = height_over_table(fit.position, fit.rotation, tracker.model, tracker.rig.arena)
                look = None if fit.own is None else look_of(fit, tracker.model.size)
    return Sample(values, height, look)


def disagreement(looks: Sequence[Look], rig: CameraRig) -> FloatArray:
    """(looks, C) by which each camera misses what the others see [mrad]; NaN: not known."""
    angles = [camera.matrix[[0, 1], [0, 1]] for camera in rig]
    misses: FloatArray = 1e3 * np.linalg.norm(CameraErrors(looks, rig.cameras).misses() / angles, axis=2)
    return misses


def of_picture(image: Image) -> dict[str, float]:
    """Brightness, clipping and white balance of a picture (H, W, 3)."""
    light = find_light(image)
    balance = 100.0 * (light.gains[0] / light.gains[2] - 1.0) if light.share > 0.0 else float("nan")
    return {
        "brightness": brightness(image),
        "clipping": 100.0 * clipped_share(image),
        "white balance": float(balance),
    }


def height_over_table(position: FloatArray, rotation: FloatArray, model: CuboidModel, arena: Arena) -> float:
    """Height of the lowest point over the table [mm]; NaN without a table, or unless a face is level."""
    down = np.abs(rotation[2])
    if arena.table is None or down.max() < LEVEL:
        return float("nan")
    return float(1e3 * (position[2] - down @ (np.asarray(model.size) / 2) - arena.table))
