"""Accuracy of tracking over time: `update` on films with ground truth.

They are played whole, subsampled, with single cameras, and with the object absent for a while.
"""

import functools
import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import click
import numpy as np
import pandas as pd

import tracker
from benchmarks.data.films import FilmFrame, FilmStore, vanishing_film, vanishing_frames
from benchmarks.data.plan import Plan
from benchmarks.data.scenes import OBJECTS, rig
from benchmarks.measure.timing import ROUNDS, Times, in_turn, one_thread, shortest
from benchmarks.score.errors import pose_errors, true_pose
from benchmarks.score.films import at_rest
from synthetic.scene import drawn
from tracker.pose.result import Observation

STRIDES = (2, 4, 8)
"""Strides at which films are subsampled, in addition to whole films."""

FILMS = {"realistic": 2, "world": 8}
"""Number of films for each object, by style. In `world` each film has its own cameras, so there are more
films, and they are shorter."""

SHORTEST = 40
"""Smallest number of frames of a film."""


def measure_films(plan: Plan) -> pd.DataFrame:
    """Return a row for each frame and mode: `group`, `object`, and the columns of `play`."""
    parts = []
    for name, (style, count) in itertools.product(OBJECTS, FILMS.items()):
        length = max(SHORTEST, plan.count("film") * FILMS["realistic"] // count)
        store = FilmStore(name, style, length, plan)
        click.echo(f"films, {style}, {name}", err=True)
        store.prepare(range(count), vanishing=style == "realistic")
        with one_thread():
            play_films = _realistic if style == "realistic" else _world
            played = play_films(name, store, count)
            parts += [part.assign(object=name) for part in played]
    return pd.concat(parts, ignore_index=True)


def _realistic(name: str, store: FilmStore, count: int) -> Iterator[pd.DataFrame]:
    own = tracker.ObjectTracker(drawn(name), rig())
    everything = range(store.length)
    films = [list(store.frames(film, everything)) for film in range(count)]
    yield _films(own, films, "all").join(_single_shots(own, films))
    for stride in STRIDES:
        yield _films(own, [film[::stride] for film in films], f"every {stride}. frame")
    for camera in range(len(own.rig)):
        yield _films(own, films, f"camera {camera + 1}", camera)
    positions = [np.array([frame.position for frame in film]) for film in films]
    acts = [
        vanishing_film(store, film, start, positions[film])
        for film in range(count)
        for start in vanishing_frames(store.length)
    ]
    yield _films(own, acts, "vanished")


def _world(name: str, store: FilmStore, count: int) -> Iterator[pd.DataFrame]:
    """Play films with all cameras and with each one alone, using the calibration given to a user."""
    films = [list(store.frames(film, range(store.length))) for film in range(count)]
    model = tracker.load_object(name)
    trackers = [tracker.ObjectTracker(model, film[0].rigs(rig())[1]) for film in films]
    for camera in (None, *range(len(trackers[0].rig))):
        group = "world" if camera is None else f"world, camera {camera + 1}"
        for number, (own, film) in enumerate(zip(trackers, films, strict=True)):
            yield play(own, film, camera).assign(group=group, film=number)


def _films(
    own: tracker.ObjectTracker, films: Iterable[Iterable[FilmFrame]], group: str, camera: int | None = None
) -> pd.DataFrame:
    parts = [play(own, film, camera).assign(group=group, film=number) for number, film in enumerate(films)]
    return pd.concat(parts, ignore_index=True)


def play(own: tracker.ObjectTracker, frames: Iterable[FilmFrame], camera: int | None = None) -> pd.DataFrame:
    """Play a film to a reset tracker: the images of all cameras, or of one, at whose timestamps it is judged.

    Returns:
        A row for each frame: `timestamp`, `present`, `status`, `visible` (mean over the given cameras),
        `at_rest`; whether there is a filtered pose (`found`), its `confidence` and errors; `measured_given`
        and the errors of the measured pose as `measured_…`; and the shortest times of several rounds.
    """
    film = list(frames)
    rounds = [_played(own, film, camera) for _ in range(ROUNDS)]
    rows, poses = [], []
    for frame, *same in zip(film, *rounds, strict=True):
        answer = same[0][0]
        measured, filtered = answer.object_pose, answer.filtered_object_pose
        seen = frame.visible_fraction if camera is None else frame.visible_fraction[camera]
        true = true_pose(*frame.shown(camera))
        row: dict[str, Any] = {
            "timestamp": frame.timestamp,
            "present": frame.position is not None,
            "status": answer.status.value,
            "visible": float(np.mean(seen)),
            "found": filtered is not None,
            "confidence": np.nan if filtered is None else float(filtered.confidence),
            "measured_given": measured is not None,
        }
        for prefix, pose in (("", filtered), ("measured_", measured)):
            row |= pose_errors(pose, true, prefix)
        rows.append(row | shortest([times for _, times in same]))
        poses.append(true)
    return pd.DataFrame(rows).assign(at_rest=at_rest(np.array(poses)))


def _played(
    own: tracker.ObjectTracker, film: list[FilmFrame], camera: int | None
) -> list[tuple[Observation, Times]]:
    """Play a film once; return the answer to each frame, and its times."""
    own.reset()
    played = []
    for frame in film:
        images = [image if camera in (None, k) else None for k, image in enumerate(frame.images)]
        stamps = frame.stamps if camera is None else float(frame.stamps[camera])
        played.append(in_turn(functools.partial(own.update, images, stamps), images))
    return played


def _single_shots(own: tracker.ObjectTracker, films: list[list[FilmFrame]]) -> pd.DataFrame:
    """Return the errors of `detect`, which has no memory: a row for each frame of all films."""
    rows = []
    for frame in itertools.chain.from_iterable(films):
        true = true_pose(frame.position, frame.rotation)
        rows.append(pose_errors(own.detect(frame.images).object_pose, true, "single_"))
    return pd.DataFrame(rows)
