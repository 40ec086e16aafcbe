"""What tracking over time is worth: `update` on films with exact truth.

They are played whole, thinned, by single cameras, and with the object gone for a while.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd

import tracker
from benchmarks.data.films import FilmFrame, FilmStore, vanishing_film, vanishing_frames
from benchmarks.data.scenes import OBJECTS, rig
from benchmarks.data.sets import Plan
from benchmarks.measure.timing import in_turn, one_thread
from benchmarks.score.errors import pose_errors
from benchmarks.score.films import (
    at_rest,
    camera_row,
    right,
    share_row,
    speed_row,
    state_rows,
    status_row,
    vanished_row,
)
from benchmarks.score.shares import percent
from tracker.conventions import FloatArray

STRIDES = (2, 4, 8)
"""Films are judged whole, and with every so many-th frame alone."""

FILMS = 2
"""For each object."""

FRAMES_OVER_SCENES = 1.5
"""Length of a film over the number of realistic scenes."""

WARM = 5
"""Frames for which a tracker runs before it is timed."""

READ = 100
"""Frames that are read at once."""

Rows = list[dict[str, Any]]


def film_length(plan: Plan) -> int:
    """Frames of each film."""
    return max(40, round(FRAMES_OVER_SCENES * plan.scenes))


def measure_films(
    plan: Plan, say: Callable[[str], None] = lambda line: None
) -> tuple[Rows, dict[str, pd.DataFrame]]:
    """Rows of the parts `films…`, and the first film of each object as it was played.

    Args:
        plan: which films.
        say: takes lines about the progress.
    """
    rows: Rows = []
    shown: dict[str, pd.DataFrame] = {}
    for name in OBJECTS:
        store = FilmStore(name, film_length(plan), plan.seed, plan.workers, plan.cache)
        say(f"films, {name}")
        store.store.prepare(store.prepared(range(FILMS)))
        with one_thread():
            own, shown[name] = _of_object(tracker.ObjectTracker(tracker.load_object(name), rig()), store)
        rows += [{"object": name, **row} for row in own]
    return rows, shown


def _of_object(own: tracker.ObjectTracker, store: FilmStore) -> tuple[Rows, pd.DataFrame]:
    everything = range(store.length)

    def played(stride: int = 1, camera: int | None = None) -> pd.DataFrame:
        parts = [play(own, store.frames(film, everything[::stride]), camera) for film in range(FILMS)]
        return pd.concat([part.assign(film=film) for film, part in enumerate(parts)], ignore_index=True)

    first = list(store.frames(0, everything[:WARM]))
    own.detect(first[0].images)
    play(own, first)
    whole = played()
    single = _single_shots(own, store)
    thinned = {f"every {stride}. frame": played(stride) for stride in STRIDES}
    acts = [
        play(own, vanishing_film(store, film, start, _positions(store, film)))
        for film in range(FILMS)
        for start in vanishing_frames(store.length)
    ]
    vanished = pd.concat([act.assign(film=k) for k, act in enumerate(acts)], ignore_index=True)
    once = {"single": percent(right(single.add_prefix("single_"), "single"))}
    given = {"all": whole, **thinned}
    rows = [
        *(
            {"part": "films", "group": group, **share_row(part), **(once if group == "all" else {})}
            for group, part in given.items()
        ),
        *({"part": "films, errors", **row} for row in state_rows(whole, single)),
        *({"part": "films, status", "group": group, **status_row(part)} for group, part in given.items()),
        *(
            {"part": "films, one camera", **camera_row(played(camera=camera), camera)}
            for camera in range(len(own.rig))
        ),
        {"part": "films, vanished", "group": "", **vanished_row(vanished)},
        {"part": "films, time", "group": "update", **speed_row(whole)},
    ]
    return rows, whole[whole.film == 0]


def play(
    object_tracker: tracker.ObjectTracker, frames: Iterable[FilmFrame], camera: int | None = None
) -> pd.DataFrame:
    """Give a film to a tracker that begins anew, all cameras' pictures or those of one alone.

    Returns:
        A row for each frame, see `benchmarks.score.films.COLUMNS`, but for the film.
    """
    object_tracker.reset()
    rows, poses = [], []
    for frame in _read_ahead(frames):
        images = [
            image if camera is None or camera == number else None for number, image in enumerate(frame.images)
        ]
        update = functools.partial(object_tracker.update, images, frame.timestamp)
        said, own_ms, reference_ms = in_turn(update, images)
        measured, filtered = said.object_pose, said.filtered_object_pose
        row = {
            "timestamp": frame.timestamp,
            "present": frame.position is not None,
            "status": said.status.name,
            "confidence": np.nan if filtered is None else filtered.confidence,
            "update_ms": own_ms,
            "reference_ms": reference_ms,
        }
        row |= {f"visible_{k}": float(share) for k, share in enumerate(frame.visible_fraction)}
        for name, pose in (("measured", measured), ("filtered", filtered)):
            row |= {f"{name}_given": pose is not None, **_errors(name, pose, frame)}
        rows.append(row)
        poses.append(_true_pose(frame))
    return pd.DataFrame(rows).assign(at_rest=at_rest(np.array(poses)))


def _read_ahead(frames: Iterable[FilmFrame]) -> Iterator[FilmFrame]:
    """The same, read from disk many at a time: what is timed follows upon its like, not upon unpacking."""
    rest = iter(frames)
    while block := list(itertools.islice(rest, READ)):
        yield from block


def _true_pose(frame: FilmFrame) -> FloatArray:
    if frame.position is None:
        return np.full((3, 4), np.nan)
    return np.column_stack([np.asarray(frame.rotation), frame.position])


def _errors(name: str, pose: tracker.PoseEstimate | None, frame: FilmFrame) -> dict[str, float]:
    units = ("mm", "deg", "nees")
    return dict(zip((f"{name}_{unit}" for unit in units), pose_errors(pose, _true_pose(frame)), strict=True))


def _single_shots(object_tracker: tracker.ObjectTracker, store: FilmStore) -> pd.DataFrame:
    """Errors without memory: columns mm, deg, nees, a row for each frame of all films."""
    return pd.DataFrame(
        [
            pose_errors(object_tracker.detect(frame.images).object_pose, _true_pose(frame))
            for film in range(FILMS)
            for frame in store.frames(film, range(store.length))
        ],
        columns=["mm", "deg", "nees"],
    )


def _positions(store: FilmStore, film: int) -> FloatArray:
    return np.array([frame.position for frame in store.frames(film, range(store.length))])
