"""What tracking over time is worth: `update` on films with exact truth.

They are played whole, thinned, by single cameras, and with the object gone for a while.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tracker
from benchmarks.data.films import SEED, FilmFrame, FilmStore, vanishing_film, vanishing_frames
from benchmarks.data.scenes import OBJECTS, rig
from benchmarks.data.store import CACHE
from benchmarks.measure.playing import Played, play, pose_error
from benchmarks.measure.timing import one_thread
from benchmarks.score.films import camera_row, share_row, speed_row, vanished_row, whole_row
from tracker.conventions import FloatArray

STRIDES = (2, 4, 8)
"""Films are judged whole, and with every so many-th frame alone."""

WARM = 5
"""Frames for which a tracker runs before it is timed."""


@dataclass(frozen=True)
class FilmOptions:
    """How much is measured."""

    films: int = 2
    """For each object."""
    length: int = 600
    """Frames of each."""
    seed: int = SEED
    """Of the first object's films; another one for all but judging."""
    workers: int = 2
    """Processes that render."""
    cache: Path = CACHE
    """Folder of rendered films."""

    def store(self, object_name: str) -> FilmStore:
        """The films of an object."""
        return FilmStore(object_name, self.length, self.seed, self.workers, self.cache)


QUICK = FilmOptions(films=1, length=40)


def measure_films(
    options: FilmOptions, say: Callable[[str], None] = lambda line: None
) -> tuple[dict[str, Any], dict[str, Played]]:
    """Results as plain numbers, and the first film of each object as it was played.

    The results hold `about`; `whole`, `thinned`, `cameras`, `vanished`, `speed`: rows for each object; and
    `figures` by object: those few that are held against targets.

    Args:
        options: how much is measured.
        say: takes lines about the progress.
    """
    results: dict[str, Any] = {
        "about": {"seed": options.seed, "films": options.films, "frames": options.length}
    }
    shown: dict[str, Played] = {}
    for name in OBJECTS:
        store, films = options.store(name), range(options.films)
        say(f"films, {name}")
        store.prepare(films)
        own = tracker.ObjectTracker(tracker.load_object(name), rig())
        everything = range(options.length)
        with one_thread():
            _warm_up(own, store)
            whole = [play(own, store.frames(film, everything)) for film in films]
            single = np.concatenate([_single_shots(own, store.frames(film, everything)) for film in films])
            thinned = {
                stride: [play(own, store.frames(film, everything[::stride])) for film in films]
                for stride in STRIDES
            }
            alone = [
                [play(own, store.frames(film, everything), camera) for film in films]
                for camera in range(len(own.rig))
            ]
            acts = [
                play(own, vanishing_film(store, film, start, _positions(store, film)))
                for film in films
                for start in vanishing_frames(options.length)
            ]
        shown[name] = whole[0]
        rows: dict[str, list[dict[str, Any]]] = {
            "whole": [whole_row(whole, single)],
            "thinned": [{"stride": stride, **share_row(parts)} for stride, parts in thinned.items()],
            "cameras": [camera_row(parts, camera) for camera, parts in enumerate(alone)],
            "vanished": [vanished_row(acts)],
            "speed": [speed_row(whole)],
        }
        for key, part in rows.items():
            results.setdefault(key, []).extend({"object": name, **row} for row in part)
        results.setdefault("figures", {})[name] = _figures(rows)
    return results, shown


def _warm_up(object_tracker: tracker.ObjectTracker, store: FilmStore) -> None:
    frames = list(store.frames(0, range(min(WARM, store.length))))
    object_tracker.detect(frames[0].images)
    play(object_tracker, frames)


def _single_shots(object_tracker: tracker.ObjectTracker, frames: Iterable[FilmFrame]) -> FloatArray:
    """(N, 2) errors without memory [mm], [°]."""
    return np.array([pose_error(object_tracker.detect(frame.images).object_pose, frame) for frame in frames])


def _positions(store: FilmStore, film: int) -> FloatArray:
    return np.array([frame.position for frame in store.frames(film, range(store.length))])


def _figures(rows: dict[str, list[dict[str, Any]]]) -> dict[str, float]:
    whole, vanished, speed = rows["whole"][0], rows["vanished"][0], rows["speed"][0]
    keys = ("filtered", "flips", "nees")
    ratios = [f"{state}_ratio_{unit}" for state in ("rest", "moving") for unit in ("mm", "deg")]
    figures = {key: whole[key] for key in (*keys, *ratios)}
    for row in rows["thinned"]:
        figures |= {f"every_{row['stride']}_{key}": row[key] for key in ("filtered", "losses")}
    return figures | {
        "right_or_none": _least([row["right_or_none"] for row in rows["cameras"]]),
        **{key: vanished[key] for key in ("kept", "invented", "longest_wait")},
        **{key: speed[key] for key in ("ratio", "p99_over_median")},
    }


def _least(values: Sequence[float]) -> float:
    """Of those that are known: a camera may see too little throughout."""
    return min((value for value in values if np.isfinite(value)), default=np.nan)
