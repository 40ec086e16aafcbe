"""What tracking over time is worth: `update` on films with exact truth.

They are played whole, thinned, by single cameras, and with the object gone for a while.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tracker
from benchmarks.cache import CACHE
from benchmarks.films import ABSENT, SEED, FilmFrame, FilmStore, vanishing_film, vanishing_frames
from benchmarks.scenes import OBJECTS, rig
from benchmarks.summary import SURE, percent
from benchmarks.timing import RIGHT_DEG, RIGHT_MM, one_thread, reference_work
from tracker import Status
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.tracking import TrackingOptions

STRIDES = (2, 4, 8)
"""Films are judged whole, and with every so many-th frame alone."""

STILL_M, STILL_DEG = 1e-5, 0.01
"""An object that moved less since the frame before, and until the next one, is at rest [m], [°]."""

FLIPPED_DEG = 30.0
"""A rotation that is farther off is that of another face [°]."""

NEAR_MM = 20.0
"""One camera's pose counts as right within so much and RIGHT_DEG [mm]."""

SEEN, CLEAR, CLEAR_FRAMES = 0.5, 0.7, 3
"""Visible fractions from which one camera is judged, and from which on for so many frames it ought to find
what it had lost."""

COAST = TrackingOptions().coast_seconds
"""For so long the pose of an object that vanished may be predicted [s]."""

READ = 100
"""Frames that are read at once."""

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


@dataclass(frozen=True, eq=False)
class Played:
    """What `update` said of N frames, against the truth; nan where it said nothing, or there is none."""

    timestamp: FloatArray
    """(N,) [s]"""
    visible: FloatArray
    """(N, cameras)"""
    present: Array
    """(N,) whether there is an object."""
    measured: FloatArray
    """(N, 2) error of the measured pose [mm], [°]."""
    filtered: FloatArray
    """(N, 2) error of the filtered pose [mm], [°]."""
    given: Array
    """(N, 2) whether there was a measured, and a filtered pose."""
    confidence: FloatArray
    """(N,) of the filtered pose."""
    nees: FloatArray
    """(N,) of the filtered pose: squared error over its covariance, six degrees of freedom."""
    status: Array
    """(N,) names of `tracker.Status`."""
    times: FloatArray
    """(N, 2) of `update`, and of the reference work after it [ms]."""
    at_rest: Array
    """(N,) whether the object did not move since the frame before, nor until the next one."""

    def __len__(self) -> int:
        return len(self.timestamp)


def play(
    object_tracker: tracker.ObjectTracker, frames: Iterable[FilmFrame], camera: int | None = None
) -> Played:
    """Give a film to a tracker that begins anew, all cameras' pictures or those of one alone."""
    object_tracker.reset()
    rows: list[tuple[Any, ...]] = []
    poses: list[FloatArray] = []
    for frame in _read_ahead(frames):
        images = [
            image if camera is None or camera == number else None for number, image in enumerate(frame.images)
        ]
        start = time.perf_counter()
        said = object_tracker.update(images, frame.timestamp)
        middle = time.perf_counter()
        reference_work(images)
        times = 1e3 * (middle - start), 1e3 * (time.perf_counter() - middle)
        measured, filtered = said.object_pose, said.filtered_object_pose
        rows.append(
            (
                frame.timestamp,
                frame.visible_fraction,
                frame.position is not None,
                _error(measured, frame),
                _error(filtered, frame),
                (measured is not None, filtered is not None),
                np.nan if filtered is None else filtered.confidence,
                _nees(filtered, frame),
                said.status.name,
                times,
            )
        )
        poses.append(_true_pose(frame))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns.append(_at_rest(np.array(poses)))
    return Played(*columns)


def _read_ahead(frames: Iterable[FilmFrame]) -> Iterator[FilmFrame]:
    """The same, read from disk many at a time: what is timed follows upon its like, not upon unpacking."""
    rest = iter(frames)
    while block := list(itertools.islice(rest, READ)):
        yield from block


def _true_pose(frame: FilmFrame) -> FloatArray:
    if frame.position is None:
        return np.full((3, 4), np.nan)
    return np.column_stack([np.asarray(frame.rotation), frame.position])


def _error(pose: tracker.PoseEstimate | None, frame: FilmFrame) -> tuple[float, float]:
    if pose is None or frame.position is None or frame.rotation is None:
        return np.nan, np.nan
    shift = 1e3 * float(np.linalg.norm(pose.position - frame.position))
    return shift, float(np.degrees(so3.angle_between(pose.rotation, frame.rotation)))


def _nees(pose: tracker.PoseEstimate | None, frame: FilmFrame) -> float:
    if pose is None or frame.position is None or frame.rotation is None:
        return np.nan
    turn = so3.log(frame.rotation @ pose.rotation.T)
    error = np.concatenate([frame.position - pose.position, turn])
    return float(error @ np.linalg.solve(pose.covariance, error))


def _at_rest(poses: FloatArray) -> Array:
    """(N,) of true poses (N, 3, 4); the first and the last frame are not known to be."""
    shift = np.linalg.norm(np.diff(poses[:, :, 3], axis=0), axis=1)
    turn = np.degrees(
        [so3.angle_between(a, b) for a, b in zip(poses[:-1, :, :3], poses[1:, :, :3], strict=True)]
    )
    still = (shift < STILL_M) & (turn < STILL_DEG)
    return np.asarray(np.r_[False, still] & np.r_[still, False])


def within(errors: FloatArray, millimetres: float = RIGHT_MM, degrees: float = RIGHT_DEG) -> Array:
    """(N,) whether errors (N, 2) are within these; nan is not."""
    return np.asarray((errors < (millimetres, degrees)).all(axis=1))


def losses(status: Array) -> int:
    """How often an object was lost that had been found."""
    lost = status == Status.LOST.name
    return int(np.count_nonzero(lost[1:] & ~lost[:-1]))


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
    return np.array([_error(object_tracker.detect(frame.images).object_pose, frame) for frame in frames])


def _positions(store: FilmStore, film: int) -> FloatArray:
    return np.array([frame.position for frame in store.frames(film, range(store.length))])


def share_row(parts: Sequence[Played]) -> dict[str, Any]:
    """Right answers [%], losses and statuses of several films."""
    filtered, measured = (_joined(parts, key) for key in ("filtered", "measured"))
    flipped = (filtered[:, 1] > FLIPPED_DEG) & (_joined(parts, "confidence") > SURE)
    return {
        "frames": len(filtered),
        "filtered": percent(within(filtered)),
        "measured": percent(within(measured)),
        "flips": int(np.count_nonzero(flipped)),
        "losses": sum(losses(part.status) for part in parts),
        "statuses": {key: int(n) for key, n in sorted(Counter(_joined(parts, "status").tolist()).items())},
    }


def whole_row(parts: Sequence[Played], single: FloatArray) -> dict[str, Any]:
    """Figures of whole films, with the errors (N, 2) of the same frames without memory."""
    filtered, at_rest = _joined(parts, "filtered"), _joined(parts, "at_rest")
    row = share_row(parts) | {
        "single": percent(within(single)),
        "nees": _median(_joined(parts, "nees")),
    }
    for state, own in (("rest", at_rest), ("moving", ~at_rest)):
        row[f"{state}_frames"] = int(np.count_nonzero(own))
        for column, unit in enumerate(("mm", "deg")):
            now, once = (_median(errors[own, column]) for errors in (filtered, single))
            row |= {
                f"{state}_filtered_{unit}": now,
                f"{state}_single_{unit}": once,
                f"{state}_ratio_{unit}": now / once,
            }
    return row


def camera_row(parts: Sequence[Played], camera: int) -> dict[str, Any]:
    """What is measured by one camera alone, of frames in which it sees enough: shares in %."""
    own = _joined(parts, "visible")[:, camera] >= SEEN
    right = within(_joined(parts, "measured"), NEAR_MM)[own]
    none = ~_joined(parts, "given")[own, 0]
    return {
        "camera": camera,
        "frames": int(np.count_nonzero(own)),
        "right": percent(right),
        "none": percent(none),
        "wrong": percent(~right & ~none),
        "right_or_none": percent(right | none),
        "longest_wait": max(longest_wait(part.visible[:, camera], part.given[:, 0]) for part in parts),
    }


def longest_wait(visible: FloatArray, given: Array) -> int:
    """The most frames in a row without a pose, counted from the last of CLEAR_FRAMES clear ones on."""
    worst = clear = wait = 0
    for fraction, is_given in zip(visible, given, strict=True):
        clear = clear + 1 if fraction >= CLEAR else 0
        wait = wait + 1 if clear >= CLEAR_FRAMES and not is_given else 0
        worst = max(worst, wait)
    return worst


def vanished_row(acts: Sequence[Played]) -> dict[str, Any]:
    """What was said while the object was away, and when it was back."""
    late, kept, invented, waits, longest = 0, 0, 0, [], 0.0
    for act in acts:
        away = np.flatnonzero(~act.present)
        # It was there for the last time, at most, one frame before.
        absent = act.timestamp[away] - act.timestamp[away[0] - 1]
        late += int(np.count_nonzero(absent > COAST))
        is_kept = act.given[away, 1]
        kept += int(np.count_nonzero(is_kept & (absent > COAST)))
        longest = max([longest, *absent[is_kept].tolist()])
        invented += int(np.count_nonzero(act.given[away, 0]))
        found = np.flatnonzero(within(act.measured)[away[-1] + 1 :])
        # The frame of the return itself counts as one.
        waits.append(int(found[0]) + 1 if len(found) else len(act) - int(away[-1]))
    return {
        "times": len(acts),
        "absent_frames": ABSENT * len(acts),
        "late_frames": late,
        "kept": kept,
        "kept_seconds": longest,
        "invented": invented,
        "median_wait": float(np.median(waits)),
        "longest_wait": max(waits),
    }


def speed_row(parts: Sequence[Played]) -> dict[str, Any]:
    """What an update costs while the object is tracked."""
    own = _joined(parts, "status") == Status.TRACKING.name
    update, reference = _joined(parts, "times")[own].T
    if not len(update):
        update = reference = np.full(1, np.nan)
    median, p99 = float(np.median(update)), float(np.quantile(update, 0.99))
    return {
        "median_ms": median,
        "p99_ms": p99,
        "reference_ms": float(np.median(reference)),
        "ratio": float(np.median(update / reference)),
        "p99_over_median": p99 / median,
        "times": int(np.count_nonzero(own)),
    }


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


def _joined(parts: Sequence[Played], key: str) -> Array:
    return np.concatenate([getattr(part, key) for part in parts])


def _least(values: Sequence[float]) -> float:
    """Of those that are known: a camera may see too little throughout."""
    return min((value for value in values if np.isfinite(value)), default=np.nan)


def _median(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else np.nan
