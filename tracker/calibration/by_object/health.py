"""Measure the health of a rig in frames spread over a recording, instead of checking it by hand."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from tracker.calibration.by_object.check import (
    APART,
    LIMIT,
    LOOK_CONFIDENCE,
    CalibrationCheck,
    check_calibration,
    look_of,
)
from tracker.calibration.by_object.looks import CameraErrors, Look
from tracker.calibration.by_object.sightings import LEVEL, stays
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import CalibrationError
from tracker.geometry.arena import Arena
from tracker.logs.log import Log, evenly, picked
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import alone, apparent
from tracker.pose.result import MotionEstimate
from tracker.poses.poses import Poses
from tracker.segmentation.light import CLIPPED, find_light
from tracker.tracking.cameras import slow


def brightness(image: Image) -> float:
    """Return the median grey level of an image (H, W, 3); lamps or dark fingers in view hardly affect it."""
    return float(np.median(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)))


def clipped_share(image: Image) -> float:
    """Return the share of pixels of an image (H, W, 3) in which a channel is clipped [%]."""
    return 100.0 * float((image.max(axis=2) >= CLIPPED).mean())


MOST = 200
"""Largest number of frames to measure."""

OFTEN = 0.1
"""A quantity is reported if it is beyond its limits in more than this share of frames."""


class Quantity(NamedTuple):
    """A quantity measured for each camera in each frame."""

    title: str
    unit: str
    limits: tuple[float, float]
    """Range of good values."""
    advice: str
    """What to check if the value is outside the limits."""


QUANTITIES: Mapping[str, Quantity] = {
    "residual": Quantity(
        "Residual: edges of the object around the pose", "px, scaled to an object of 55 px", (0.0, 0.5),
        "a calibration that does not fit, an object of another size, or worn edges",
    ),
    "disagreement": Quantity(
        "Disagreement: by how much a camera misses what the others see, object at rest", "mrad",
        (0.0, 1e3 * LIMIT), "tracker calibrate check names the camera that moved",
    ),
    "brightness": Quantity(
        "Brightness of the image, median grey level", "levels", (30.0, 200.0),
        "exposure, the lights of the arena",
    ),
    "clipping": Quantity("Clipped pixels", "%", (0.0, 15.0), "exposure, reflections, a lamp in view"),
    "blur": Quantity(
        "Sharpness: blur of the object's edges", "% of the image's width", (0.0, 0.7),
        "focus, a dirty lens, exposure time where the object moves",
    ),
    "white balance": Quantity(
        "White balance: red over blue of the scene's greys", "%", (-45.0, 80.0),
        "start the cameras with a grey scene in view; a coloured table shifts it, too",
    ),
}  # fmt: skip
"""Quantities measured for each camera, by key; docs/health.md explains the limits.

Recordings of the platform have a brightness of 80 to 125 and a clipping of 0 to 6 %.
"""

HEIGHT = Quantity(
    "Table: lowest point of the object at rest, over the arena's table", "mm", (-3.0, 3.0),
    "tracker calibrate table finds the table",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Health:
    """Measurements on n frames of C cameras; NaN where nothing was measured."""

    index: Array
    """Numbers (n,) of the frames."""
    time: FloatArray
    """Times (n,) since the first frame of the recording [s]."""
    cameras: tuple[str, ...]
    values: Mapping[str, FloatArray]
    """Values (n, C) of each of QUANTITIES."""
    height: FloatArray
    """Values (n,) of HEIGHT."""
    check: CalibrationCheck | None
    """The calibration check; None if there is only one camera or the object was never seen at rest."""

    def beyond(self, key: str) -> FloatArray:
        """Return the share (C,) of frames in which a quantity is beyond its limits; NaN if not measured."""
        values, (low, high) = self.values[key], QUANTITIES[key].limits
        known = np.isfinite(values)
        beyond, count = known & ((values < low) | (values > high)), known.sum(axis=0)
        return np.where(count > 0, beyond.sum(axis=0) / np.maximum(count, 1), np.nan)

    def complaints(self) -> list[str]:
        """Return what is wrong with the rig, one line per fault."""
        result = []
        for key, quantity in QUANTITIES.items():
            for name, share in zip(self.cameras, self.beyond(key), strict=True):
                if share > OFTEN:
                    result.append(f"{name}: {key} beyond its limit in {100 * share:.0f} %: {quantity.advice}")
        heights = self.height[np.isfinite(self.height)]
        height = np.median(heights) if heights.size else 0.0
        if not HEIGHT.limits[0] <= height <= HEIGHT.limits[1]:
            result.append(f"the object rests {height:+.1f} mm off: {HEIGHT.advice}")
        if self.check is not None and not self.check.fits:
            result.append("the calibration does not fit: tracker calibrate check says which camera moved")
        return result

    def missing(self) -> str | None:
        """Return a line that says what was never measured and why; None if everything was."""
        measured = {**self.values, "table": self.height}
        names = [key for key, values in measured.items() if not np.isfinite(values).any()]
        if not names:
            return None
        seen = np.isfinite(self.values["residual"]).any()
        why = "the object was not seen at rest on a table" if seen else "the object was not surely found"
        if seen and len(self.cameras) == 1:
            why = "there is a single camera"
        return f"not measured: {', '.join(names)}; {why}"


def health(
    tracker: ObjectTracker, log: Log, poses: Poses, progress: Callable[[int], None] = lambda _: None
) -> Health:
    """Measure a tracked recording; `progress` receives the number of frames measured since the last call.

    LogError: the recording is damaged; ImageError: an image does not suit the tracker's cameras.
    """
    rows = evenly(range(len(poses)), MOST)
    count, rig = len(tracker.rig), tracker.rig
    values = {key: np.full((len(rows), count), np.nan) for key in QUANTITIES}
    height = np.full(len(rows), np.nan)
    looks: list[Look] = []
    last = -APART
    for n, frame in enumerate(picked(log, poses.index[rows].tolist())):
        row, seen = rows[n], poses.filtered
        still = stays(seen[row - 1 : row], seen[row : row + 1]) if row else len(poses) == 1
        found = sample(tracker, frame.images, still=still)
        for key, value in found.values.items():
            values[key][n] = value
        height[n] = found.height
        # Looks at the object in the same place add no information.
        if found.look is not None and frame.index >= last + APART:
            last = frame.index
            looks.append(found.look)
        else:
            values["disagreement"][n] = np.nan
        progress(1)
    check = None
    if looks and count > 1:
        with suppress(CalibrationError):  # no two cameras see the object in one place
            check = check_calibration(looks, rig.cameras)
    start = poses.timestamp[0] if len(poses) else 0.0
    return Health(poses.index[rows], poses.timestamp[rows] - start, tuple(rig.names), values, height, check)


class Sample(NamedTuple):
    """Measurements on the images of one moment; NaN where nothing was measured."""

    values: Mapping[str, FloatArray]
    """Values (C,) of each of QUANTITIES."""
    height: float
    """Value of HEIGHT."""
    look: Look | None
    """The poses in which the cameras separately see an object at rest, if at least one sees it."""


def surely_still(pose: MotionEstimate | None) -> bool:
    """Return whether an object is at rest, and its velocity known: that of a new track is 0 ± 0.4 m/s."""
    return pose is not None and slow(pose.velocity) and slow(np.sqrt(np.diag(pose.velocity_covariance)))


def sample(tracker: ObjectTracker, images: Sequence[Image | None], *, still: bool) -> Sample:
    """Measure the images (H, W, 3) uint8 BGR of one moment; the tracker's state is neither used nor changed.

    still: whether the object is at rest; if not, height and look are not measured. A single camera cannot
        measure the height.
    ImageError: an image does not suit the tracker's cameras.
    """
    values, height, look = of_pictures(images), float("nan"), None
    fit = tracker.fit(images) if any(image is not None for image in images) else None
    if isinstance(fit, Fit) and apparent(fit) >= LOOK_CONFIDENCE:
        for c, (camera, seen) in enumerate(zip(tracker.rig, fit.cameras, strict=True)):
            if seen["inliers"] >= 1.0:
                values["residual"][c] = np.sqrt(seen["squares"] / seen["inliers"])
                values["blur"][c] = 100.0 * seen["blur"] / camera.width
        if still:
            if not alone(fit):
                height = height_over_table(fit.position, fit.rotation, tracker.model, tracker.rig.arena)
            look = None if fit.own is None else look_of(fit, tracker.model.size)
    if look is not None and len(tracker.rig) > 1:
        problem = CameraErrors([look], tracker.rig.cameras)
        values["disagreement"] = 1e3 * np.linalg.norm(problem.misses()[0] / problem.focal, axis=1)
    return Sample(values, height, look)


def of_pictures(images: Sequence[Image | None]) -> dict[str, FloatArray]:
    """Return values (C,) of each of QUANTITIES, NaN except for brightness, clipping and white balance."""
    values = {key: np.full(len(images), np.nan) for key in QUANTITIES}
    for c, image in enumerate(images):
        if image is not None:
            light = find_light(image)
            values["brightness"][c] = brightness(image)
            values["clipping"][c] = clipped_share(image)
            if light.share > 0.0:
                values["white balance"][c] = 100.0 * (light.gains[0] / light.gains[2] - 1.0)
    return values


def height_over_table(position: FloatArray, rotation: FloatArray, model: CuboidModel, arena: Arena) -> float:
    """Return the lowest point's height over the table [mm]; NaN without a table or if no face is level."""
    down = np.abs(rotation[2])
    if arena.table is None or down.max() < np.cos(LEVEL):
        return float("nan")
    return float(1e3 * (position[2] - down @ (np.asarray(model.size) / 2) - arena.table))
