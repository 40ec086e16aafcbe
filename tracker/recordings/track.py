"""Tracks a recording from its first frame to its last, and writes the file of poses."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass

from tracker.errors import LogError
from tracker.logs import Log, open_log
from tracker.logs.poses import Poses, concatenate
from tracker.logs.poses_builder import PosesBuilder
from tracker.logs.poses_file import write_poses
from tracker.recordings.fingerprint import fingerprint
from tracker.recordings.job import Job
from tracker.recordings.parts import Part, cut, runs
from tracker.recordings.pool import Progress, Workers
from tracker.recordings.store import PartStore
from tracker.warm_up import warm_up


@dataclass(frozen=True, eq=False)
class Tracked:
    """A tracked recording."""

    poses: Poses
    """Of all frames, as they are in the file."""
    expected: int
    """Number of frames that should have been there; more than there are in a damaged recording."""
    fault: str | None
    """What is wrong with the recording; None: nothing."""
    new: int
    """Number of frames that were tracked now, not by an earlier run that was broken off."""
    seconds: float
    """Time that these took [s]."""


def track(job: Job, workers: Workers | None = None, progress: Progress | None = None) -> Tracked:
    """Track a recording and write its file of poses, whole or not at all.

    Finished parts are kept in a hidden folder beside the file until it is written; what an earlier call
    left there is used, if it was for the same recording, object, colours, cameras and version.

    Args:
        job: what to do.
        workers: who does it; None: this process.
        progress: is told how many more frames are done, first of those that an earlier call did.

    Raises:
        LogError: the recording is damaged and not to be recovered, or something cannot be written.
        TrackerError: the tracker does not take the images.
        OSError: something cannot be read or written.
    """
    workers = workers or Workers()
    progress = progress or (lambda _: None)
    with open_log(job.log, recover=job.recover) as log:
        first, last = chosen(log, job)
        parts, sequential, fault = cut(first, last, log.episode_starts), not log.random_access, log.fault
    job = dataclasses.replace(job, colors=dataclasses.replace(job.colors))  # without tables made from it
    store = PartStore(job.parts_folder)
    store.prepare(fingerprint(job))
    missing = store.missing(parts)
    new = sum(part.stop - part.start for part in missing)
    progress(last - first - new)
    began = time.perf_counter()
    if missing:
        warm_up()
    workers.track(job, runs(missing, count=workers.count, sequential=sequential), progress)
    seconds = time.perf_counter() - began
    poses, later_fault = _joined(job, store, parts, sequential)
    write_poses(job.output, poses)
    store.remove()
    return Tracked(poses, last - first, fault or later_fault, min(new, len(poses)), seconds)


def chosen(log: Log, job: Job) -> tuple[int, int]:
    """Number of the first frame to track, and that after the last; LogError where there is none."""
    count = len(log)
    last = count if job.last is None else min(job.last, count)
    if job.first and job.first >= count:
        raise LogError(f"{job.log}: found {count} frames, expected the first one wanted, {job.first}, below")
    if job.first > last:
        raise LogError(f"{job.log}: found frames from {job.first} to {last} wanted, expected some")
    return job.first, last


def _joined(job: Job, store: PartStore, parts: Sequence[Part], sequential: bool) -> tuple[Poses, str | None]:
    """The poses of all parts, and what is wrong with the first faulty one."""
    found: list[Poses] = []
    fault: str | None = None
    for part in parts:
        poses, its_fault = store.read(part)
        found.append(poses)
        fault = fault or its_fault
        if sequential and len(poses) < part.stop - part.start:
            # Read in one go such a recording ends at its first fault; a worker that began later skipped it.
            break
    return concatenate(found) if found else PosesBuilder(job.about).build(), fault
