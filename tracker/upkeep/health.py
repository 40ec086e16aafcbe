"""How a rig fares over a recording: what people look for by hand, measured on frames spread over it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.calibration.check import LIMIT, CalibrationCheck, check_calibration, misses_of
from tracker.calibration.looks import Look
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.logs import Log
from tracker.logs.poses import Poses
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import apparent
from tracker.segmentation.light import find_light
from tracker.upkeep.check import APART, SLOW, SURE, look_of

MOST = 200
"""Frames that are looked at."""

CLIPPED = 250
"""Level from which a channel is clipped."""

LEVEL = float(np.cos(np.radians(3.0)))
"""Of the angle between a face and z = 0, up to which an object rests on it."""

OFTEN = 0.1
"""Share of the frames beyond a limit, from which on it is said."""


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
        "Brightness of the picture, mean", "levels", (30.0, 200.0), "exposure, the lights of the arena"
    ),
    "clipping": Quantity("Clipped pixels", "%", (0.0, 3.0), "exposure, reflections, a lamp in view"),
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


def _beyond(values: FloatArray, quantity: Quantity) -> float:
    known = values[np.isfinite(values)]
    low, high = quantity.limits
    return float(np.mean((known < low) | (known > high))) if known.size else float("nan")


def health(
    tracker: ObjectTracker, log: Log, poses: Poses, progress: Callable[[int], None] = lambda _: None
) -> Health:
    """Measure a recording that was tracked.

    Args:
        tracker: of its object and cameras.
        log: the recording.
        poses: of its frames.
        progress: is told how many more frames were looked at.

    Raises:
        LogError: the recording is damaged.
        ImageError: a picture is not what the tracker's cameras give.
    """
    rows = np.unique(np.linspace(0, len(poses) - 1, MOST).astype(int)) if len(poses) else np.zeros(0, int)
    wanted = dict(zip(poses.index[rows].tolist(), rows.tolist(), strict=True))
    count, rig = len(tracker.rig), tracker.rig
    values = {key: np.full((len(rows), count), np.nan) for key in QUANTITIES}
    height = np.full(len(rows), np.nan)
    looks: list[Look] = []
    looked: list[int] = []
    last = -APART
    for n, frame in enumerate(frame for frame in log if frame.index in wanted):
        for c, image in enumerate(frame.images):
            if image is not None:
                for key, value in of_picture(image).items():
                    values[key][n, c] = value
        if any(image is not None for image in frame.images):
            fit = tracker.fit(frame.images)
            if isinstance(fit, Fit) and apparent(fit) >= SURE:
                _of_fit(fit, rig, n, values)
                if _still(poses, wanted[frame.index]):
                    height[n] = _height(fit, tracker)
                    # Pictures of one place say the same again, and nothing more.
                    if fit.own is not None and frame.index >= last + APART:
                        last = frame.index
                        looks.append(look_of(fit))
                        looked.append(n)
        progress(1)
    check = None
    if looks and count > 1:
        angles = [camera.matrix[[0, 1], [0, 1]] for camera in rig]
        values["disagreement"][looked] = 1e3 * np.linalg.norm(misses_of(looks, rig.cameras) / angles, axis=2)
        check = check_calibration(looks, rig.cameras)
    start = poses.timestamp[0] if len(poses) else 0.0
    return Health(poses.index[rows], poses.timestamp[rows] - start, tuple(rig.names), values, height, check)


def of_picture(image: Image) -> dict[str, float]:
    """Brightness, clipping and white balance of a picture (H, W, 3)."""
    light = find_light(image)
    balance = 100.0 * (light.gains[0] / light.gains[2] - 1.0) if light.share > 0.0 else float("nan")
    return {
        "brightness": float(image.mean()),
        "clipping": 100.0 * float((image.max(axis=2) >= CLIPPED).mean()),
        "white balance": float(balance),
    }


def _of_fit(fit: Fit, rig: CameraRig, n: int, values: Mapping[str, FloatArray]) -> None:
    """Residual and blur of each camera that sees the object."""
    for c, (camera, seen) in enumerate(zip(rig, fit.cameras, strict=True)):
        if seen["inliers"] >= 1.0:
            values["residual"][n, c] = np.sqrt(seen["squares"] / seen["inliers"])
            values["blur"][n, c] = 100.0 * seen["blur"] / camera.width


def _still(poses: Poses, row: int) -> bool:
    """Whether the object did not move in a frame."""
    columns = poses.filtered
    if not columns.has_pose[row]:
        return len(poses) == 1
    speeds = np.linalg.norm(columns.velocity[row].reshape(2, 3), axis=1)
    return bool((speeds < SLOW).all())


def _height(fit: Fit, tracker: ObjectTracker) -> float:
    """Height of a lowest point over the table [mm]; NaN without a table, or unless a face is level."""
    down, table = np.abs(fit.rotation[2]), tracker.rig.arena.table
    if table is None or down.max() < LEVEL:
        return float("nan")
    lowest = fit.position[2] - down @ (np.asarray(tracker.model.size) / 2)
    return float(1e3 * (lowest - table))
