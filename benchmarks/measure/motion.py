"""What skewed cameras cost while an object moves fast, and how well its pose is predicted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

import tracker
from benchmarks.data.motion import AHEAD, FRAMES, MotionFrame, motion_store, rig
from benchmarks.data.scenes import OBJECTS
from benchmarks.data.sets import Plan
from benchmarks.measure.timing import one_thread
from benchmarks.score.errors import pose_errors
from benchmarks.score.shares import median
from tracker.conventions import Image

TOGETHER, OWN_STAMPS, ONE_STAMP = "together", "skewed, a stamp for each camera", "skewed, one stamp"
"""Ways to give a frame: pictures taken at once; skewed ones with the stamp of each; skewed ones with the
latest stamp alone."""

Given = tuple[tuple[Image, ...], float | list[float]]
"""Pictures, and the stamp or stamps [s] to say of them."""

GIVEN: dict[str, Callable[[MotionFrame], Given]] = {
    TOGETHER: lambda frame: (frame.together, frame.timestamp),
    OWN_STAMPS: lambda frame: (frame.skewed, frame.stamps.tolist()),
    ONE_STAMP: lambda frame: (frame.skewed, frame.timestamp),
}

FILMS = 2
"""For each object."""

UNITS = ("mm", "deg", "nees")


def film_length(plan: Plan) -> int:
    """Frames of each film that are played."""
    return min(FRAMES, max(12, round(plan.scenes / 4)))


def measure_motion(
    plan: Plan, say: Callable[[str], None] = lambda line: None, ways: Sequence[str] = tuple(GIVEN)
) -> list[dict[str, Any]]:
    """Rows of the part `motion`, for each object and way.

    Args:
        plan: which films.
        say: takes lines about the progress.
        ways: keys of GIVEN.
    """
    rows = []
    for name in OBJECTS:
        store = motion_store(name, plan.seed, plan.workers, plan.cache)
        length = film_length(plan)
        numbers = [range(film * FRAMES, film * FRAMES + length) for film in range(FILMS)]
        say(f"motion, {name}")
        store.prepare([number for film in numbers for number in film])
        own = tracker.ObjectTracker(tracker.load_object(name), rig())
        exact: dict[str, Any] = {}
        with one_thread():
            for way in ways:
                # Each film begins anew.
                played = pd.concat([play(own, store.scenes(film), GIVEN[way]) for film in numbers])
                row = {"part": "motion", "object": name, "group": way, **motion_row(played)}
                exact = row if way == TOGETHER else exact
                rows.append(row | _ratios(row, exact))
    return rows


def play(
    own: tracker.ObjectTracker, frames: Iterable[MotionFrame], given: Callable[[MotionFrame], Given]
) -> pd.DataFrame:
    """Give a film to a tracker that begins anew.

    Returns:
        A row for each frame: `moving`, `steady`, and mm, deg, nees of the measured and the filtered pose and
        of that predicted AHEAD, right after the frame.
    """
    own.reset()
    rows = []
    for frame in frames:
        said = own.update(*given(frame))
        poses = (
            ("measured", said.object_pose, frame.latest),
            ("filtered", said.filtered_object_pose, frame.latest),
            ("predicted", own.predict(frame.timestamp + AHEAD), frame.ahead),
        )
        row: dict[str, Any] = {"moving": frame.moving, "steady": frame.steady}
        for name, pose, true in poses:
            row |= {f"{name}_{u}": x for u, x in zip(UNITS, pose_errors(pose, true), strict=True)}
        rows.append(row)
    return pd.DataFrame(rows)


def motion_row(frames: pd.DataFrame) -> dict[str, Any]:
    """Medians while the object moves; `steady` ones while it moves steadily."""
    moving, steady = frames[frames.moving], frames[frames.steady]
    row: dict[str, Any] = {"n": len(frames), "moving": len(moving), "steady": len(steady)}
    for key in ("measured", "filtered", "predicted"):
        row[f"{key}_frames"] = int(np.isfinite(moving[f"{key}_mm"]).sum())
        for unit in UNITS:
            row[f"{key}_{unit}"] = median(moving[f"{key}_{unit}"])
            row[f"steady_{key}_{unit}"] = median(steady[f"{key}_{unit}"])
    return row


def _ratios(row: dict[str, Any], exact: dict[str, Any]) -> dict[str, float]:
    """The measured pose's errors over those of pictures taken together."""
    keys = {unit: f"measured_{unit}" for unit in ("mm", "deg")}
    return {f"ratio_{unit}": row[key] / exact[key] for unit, key in keys.items() if exact.get(key)}
