"""What skewed cameras cost while an object moves fast, and how well its pose is predicted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

import tracker
from benchmarks.data.motion import AHEAD, FRAMES, SEED, MotionFrame, motion_store, rig
from benchmarks.data.scenes import OBJECTS
from benchmarks.data.store import CACHE
from benchmarks.measure.timing import one_thread
from benchmarks.score import errors as metrics
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3

TOGETHER, OWN_STAMPS, ONE_STAMP = "together", "own stamps", "one stamp"
"""Ways to give a frame: pictures taken at once; skewed ones with the stamp of each; skewed ones with the
latest stamp alone."""

Given = tuple[tuple[Image, ...], float | list[float]]
"""Pictures, and the stamp or stamps [s] to say of them."""

GIVEN: dict[str, Callable[[MotionFrame], Given]] = {
    TOGETHER: lambda frame: (frame.together, frame.timestamp),
    OWN_STAMPS: lambda frame: (frame.skewed, frame.stamps.tolist()),
    ONE_STAMP: lambda frame: (frame.skewed, frame.timestamp),
}


class Pose(Protocol):
    """What is compared with the truth."""

    @property
    def position(self) -> FloatArray:
        """(3,) [m]."""
        ...

    @property
    def orientation(self) -> FloatArray:
        """(4,) unit quaternion x, y, z, w of world from object."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) [m, rad]."""
        ...


class Tracker(Protocol):
    """What is measured: `tracker.ObjectTracker`."""

    def update(self, images: Sequence[Image | None], timestamp: Any) -> tracker.Observation:
        """The pose at the latest of the stamps [s], or at the one for all."""
        ...

    def predict(self, timestamp: float) -> Any:
        """The pose expected at a time [s], None if there is none."""
        ...

    def reset(self) -> None:
        """Forget everything."""
        ...


@dataclass(frozen=True)
class MotionOptions:
    """How much is measured."""

    films: int = 2
    """For each object."""
    length: int = FRAMES
    """Frames of each, from the first on."""
    seed: int = SEED
    """Of the first object's films; another one for all but judging."""
    workers: int = 2
    """Processes that render."""
    cache: Path = CACHE
    """Folder of rendered films."""


QUICK = MotionOptions(films=1, length=12)


@dataclass(frozen=True, eq=False)
class Played:
    """What was said of N frames, each as (distance [mm], angle [°], NEES [1]); nan where nothing was said."""

    measured: FloatArray
    """(N, 3) of the measured pose."""
    filtered: FloatArray
    """(N, 3) of the filtered pose."""
    predicted: FloatArray
    """(N, 3) of the pose AHEAD, as predicted right after the frame."""
    moving: Array
    """(N,) see `MotionFrame`."""
    steady: Array
    """(N,) see `MotionFrame`."""


def measure_motion(
    options: MotionOptions,
    say: Callable[[str], None] = lambda line: None,
    ways: Sequence[str] = tuple(GIVEN),
    make: Callable[[tracker.CuboidModel, tracker.CameraRig], Any] = tracker.ObjectTracker,
) -> dict[str, Any]:
    """Results as plain numbers: `about`; `rows` for each object and way; `figures` by object.

    Args:
        options: how much is measured.
        say: takes lines about the progress.
        ways: keys of GIVEN.
        make: makes the `Tracker` of an object and cameras.
    """
    results: dict[str, Any] = {
        "about": {"seed": options.seed, "films": options.films, "frames": options.length},
        "rows": [],
        "figures": {},
    }
    for name in OBJECTS:
        store = motion_store(name, options.seed, options.workers, options.cache)
        numbers = [range(film * FRAMES, film * FRAMES + options.length) for film in range(options.films)]
        say(f"motion, {name}")
        store.prepare([number for film in numbers for number in film])
        own = make(tracker.load_object(name), rig())
        with one_thread():
            # Way after way by its own memory: each film begins anew.
            rows = [
                {"object": name, "given": way}
                | motion_row([play(own, store.scenes(film), GIVEN[way]) for film in numbers])
                for way in ways
            ]
        results["rows"] += rows
        results["figures"][name] = motion_figures(rows)
    return results


def play(own: Tracker, frames: Iterable[MotionFrame], given: Callable[[MotionFrame], Given]) -> Played:
    """Give a film to a tracker that begins anew."""
    own.reset()
    rows = []
    for frame in frames:
        said = own.update(*given(frame))
        rows.append(
            (
                compared(said.object_pose, frame.latest),
                compared(said.filtered_object_pose, frame.latest),
                compared(own.predict(frame.timestamp + AHEAD), frame.ahead),
                frame.moving,
                frame.steady,
            )
        )
    return Played(*(np.array(column) for column in zip(*rows, strict=True)))


def compared(pose: Pose | None, true: FloatArray) -> tuple[float, float, float]:
    """Distance [mm], angle [°] and NEES [1] of a pose from the true one (3, 4); nan without a pose."""
    if pose is None:
        return np.nan, np.nan, np.nan
    exact, found = (true[:, 3], true[:, :3]), (pose.position, so3.matrix_from_quaternion(pose.orientation))
    return (
        1e3 * float(metrics.position_error(exact[0], found[0])),
        float(np.degrees(metrics.rotation_error(exact[1], found[1]))),
        float(metrics.nees(exact, found, pose.covariance)),
    )


def motion_row(parts: Sequence[Played]) -> dict[str, Any]:
    """Medians of several films, while the object moves; `steady` ones while it moves steadily."""
    moving, steady = (np.concatenate([getattr(part, key) for part in parts]) for key in ("moving", "steady"))
    row: dict[str, Any] = {
        "frames": len(moving),
        "moving": int(np.count_nonzero(moving)),
        "steady": int(np.count_nonzero(steady)),
    }
    for key in ("measured", "filtered", "predicted"):
        errors = np.concatenate([getattr(part, key) for part in parts])
        row[f"{key}_frames"] = int(np.count_nonzero(np.isfinite(errors[moving, 0])))
        for prefix, own in (("", moving), ("steady_", steady)):
            for column, unit in enumerate(("mm", "deg", "nees")):
                row[f"{prefix}{key}_{unit}"] = _median(errors[own, column])
    return row


def motion_figures(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """What is held against targets, of the rows of one object; only what was measured."""
    by_way = {row["given"]: row for row in rows}
    figures: dict[str, float] = {}
    exact = by_way.get(TOGETHER)
    for way, prefix in ((OWN_STAMPS, "skewed"), (ONE_STAMP, "unstamped")):
        if way not in by_way:
            continue
        own = by_way[way]
        figures |= {f"{prefix}_{unit}": own[f"measured_{unit}"] for unit in ("mm", "deg", "nees")}
        if exact is not None:
            figures |= {
                f"{prefix}_ratio_{unit}": ratio(own[f"measured_{unit}"], exact[f"measured_{unit}"])
                for unit in ("mm", "deg")
            }
    if exact is not None:
        keys = [f"{steady}predicted_{unit}" for steady in ("", "steady_") for unit in ("mm", "deg", "nees")]
        figures |= {key: exact[key] for key in keys}
    return figures


def ratio(error: float, exact: float) -> float:
    """One over the other [1]; nan where nothing is left to compare with."""
    return error / exact if exact else np.nan


def _median(values: FloatArray) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else np.nan
