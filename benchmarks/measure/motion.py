"""Loss of accuracy due to skewed cameras while an object moves fast, and accuracy of predicted poses."""

from collections.abc import Callable, Iterable
from typing import Any

import click
import pandas as pd

import tracker
from benchmarks.data.motion import AHEAD, FRAMES, MotionFrame, motion_store, rig
from benchmarks.data.plan import Plan
from benchmarks.data.scenes import OBJECTS
from benchmarks.measure.timing import one_thread
from benchmarks.score.errors import pose_errors
from synthetic.scene import drawn
from tracker.conventions import Image

Given = tuple[tuple[Image, ...], float | list[float]]
"""Images, and the timestamp or timestamps [s] given with them."""

GIVEN: dict[str, Callable[[MotionFrame], Given]] = {
    "together": lambda frame: (frame.together, frame.timestamp),
    "skewed, a stamp for each camera": lambda frame: (frame.skewed, frame.stamps.tolist()),
    "skewed, one stamp": lambda frame: (frame.skewed, frame.timestamp),
}
"""Ways to give a frame to the tracker: images taken at once; skewed images with a timestamp each; skewed
images with only the latest timestamp."""

FILMS = 2
"""Number of films for each object."""


def measure_motion(plan: Plan) -> pd.DataFrame:
    """Return a row for each frame, object and way of GIVEN, with the columns of `play`."""
    parts = []
    length = min(FRAMES, max(12, plan.count("motion")))
    for name in OBJECTS:
        store = motion_store(name, plan)
        numbers = [range(film * FRAMES, film * FRAMES + length) for film in range(FILMS)]
        click.echo(f"motion, {name}", err=True)
        store.prepare([number for film in numbers for number in film])
        own = tracker.ObjectTracker(drawn(name), rig())
        with one_thread():
            parts += [
                play(own, store.scenes(film), given).assign(object=name, group=way)
                for way, given in GIVEN.items()
                for film in numbers
            ]
    return pd.concat(parts, ignore_index=True)


def play(
    own: tracker.ObjectTracker, frames: Iterable[MotionFrame], given: Callable[[MotionFrame], Given]
) -> pd.DataFrame:
    """Play a film to a reset tracker.

    Returns:
        A row for each frame: `moving`, and mm, deg, nees of the measured and the filtered pose, and of the
        pose predicted AHEAD of it.
    """
    own.reset()
    rows = []
    for frame in frames:
        answer = own.update(*given(frame))
        poses = (
            ("measured_", answer.object_pose, frame.latest),
            ("filtered_", answer.filtered_object_pose, frame.latest),
            ("predicted_", own.predict(frame.timestamp + AHEAD), frame.ahead),
        )
        row: dict[str, Any] = {"moving": frame.moving}
        for prefix, pose, true in poses:
            row |= pose_errors(pose, true, prefix)
        rows.append(row)
    return pd.DataFrame(rows)
