"""Files damaged at random from a seed, read in a process with limits of memory and time.

A crash of a compiled library, a loop without end and a memory that fills are seen as answers; another
process goes on after each.
"""

import contextlib
import resource
import signal
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import tracker
from tracker.batch import workers
from tracker.calibration.rig import read_arena
from tracker.color_learning.labelled import read_image
from tracker.files.hdf5 import text_of
from tracker.poses.file import is_poses_file, read_poses
from tracker.tasks.job_goal import read_job_goal
from tracker.tasks.rearrange_dice import read_goal

SECONDS = 10
"""Of the processor, for one file."""

BYTES = 3 << 30
"""Address space of the process, of which its libraries take a third."""

HOSTILE = (
    *(b"1e999", b"-1", b"nan", b".inf", b"99999999999999999999", b"9" * 5000, b"0x7fffffff", b"true"),
    *(b"null", b"[" * 5000, b"{" * 3000, b'"' * 3, b"a: &a [*a, *a]\n"),
    *(b"!!python/object/apply:os.getcwd []", b"<<: *b", b"\xff\xfe", b"\0", b"\\ud800", b"\xed\xa0\x80"),
    *(b"2001-99-99", b"!!bool 2", b"- " * 2000, b"a = " * 9),
)
"""Pieces of text that parsers stumble over."""

TEXTS = (".toml", ".csv", ".json", ".yml")


@dataclass(frozen=True)
class Sample:
    """A file that is whole, and how it is read."""

    name: str
    content: bytes
    reader: str
    """A key of READERS."""
    path: Path
    """Where it is read from; there may be other files beside it that are not damaged."""
    heads: tuple[tuple[int, int], ...] = ()
    """Parts [start, end) in which lengths and kinds stand."""


def damaged(sample: Sample, seed: int) -> bytes:
    """One of many kinds of damage, always the same for a seed."""
    rng = np.random.default_rng(seed)
    data, result = sample.content, bytearray(sample.content)
    heads = sample.heads or ((0, len(data)),)
    kinds = ("cut", "flip", "flip head", "overwrite", "overwrite head", "double", "leave out", "zeros")
    kind = kinds[seed % 8]
    if sample.path.suffix in TEXTS and seed % 2:
        at, cut = int(rng.integers(len(data))), int(rng.integers(9))
        return data[:at] + HOSTILE[int(rng.integers(len(HOSTILE)))] + data[at + cut :]
    start, end = heads[int(rng.integers(len(heads)))] if "head" in kind else (0, len(data))
    at = int(rng.integers(start, end))
    if kind == "cut":
        return data[:at]
    if kind.startswith("flip"):
        for place in (at, *rng.integers(start, end, size=int(rng.integers(4)))):
            result[int(place)] ^= 1 << int(rng.integers(8))
    elif kind.startswith("overwrite"):
        value = (0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)[int(rng.integers(6))]
        size = int(rng.choice([1, 2, 4, 8]))
        result[at : at + size] = value.to_bytes(8, "little")[:size]
    elif kind == "double":
        result[at:at] = data[at : at + int(rng.integers(1, 5000))]
    elif kind == "leave out":
        del result[at : at + int(rng.integers(1, 5000))]
    else:
        result[at : at + 512] = bytes(len(result[at : at + 512]))
    return bytes(result)


def frames_of(path: Path, recover: bool) -> tuple[str | None, list[tuple[int, list[int]]]]:
    """The fault, and of each frame its number and checksums of the images."""
    frames, fault = [], None
    try:
        with tracker.open_log(path, recover=recover) as log:
            for frame in log:
                images = [zlib.crc32(image) for image in frame.images if image is not None]
                frames.append((frame.index, images))
                for pose in (frame.recorded_pose, frame.recorded_filtered_pose):
                    assert pose is None or np.isfinite([*pose.position, *pose.orientation]).all()
            fault = log.fault
            with contextlib.suppress(tracker.TrackerError):
                _ = log.rig
    except tracker.TrackerError as error:
        fault = _one_line(error)
    return fault, frames


def _log(path: Path) -> Any:
    return [frames_of(path, recover) for recover in (False, True)]


def _poses(path: Path) -> None:
    is_poses_file(path)
    text_of(path, "fingerprint")
    read_poses(path)


READERS = {
    "log": _log,
    "log around": lambda path: _log(path.parent),
    "log of frames": lambda path: _log(path.parent.parent),
    "poses": _poses,
    "picture": read_image,
    "object": tracker.load_object,
    "arena": lambda path: read_arena(path.parent),
    "job goal": read_job_goal,
    "dice goal": read_goal,
    "calibration": lambda path: tracker.CameraRig.load([path]),
}
"""What reads a sample; a TrackerError is an answer, too."""


def answers_to(samples: Sequence[Sample], variants: int) -> dict[str, list[Any]]:
    """Of each sample, seed by seed, what its reader gave; or an Exception, a WorkerError of a crash."""
    found: dict[str, list[Any]] = {sample.name: [] for sample in samples}
    tasks = [(sample, seed) for sample in samples for seed in range(variants)]
    with mock.patch.object(workers, "ATTEMPTS", 1), workers.processes(1) as each:
        for (sample, _), answer in each(_answer, tasks):
            found[sample.name].append(answer)
    return found


def _answer(task: tuple[Sample, int]) -> Any:
    sample, seed = task
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    sample.path.write_bytes(damaged(sample, seed))
    signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends the process
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        found = READERS[sample.reader](sample.path)
        return found if "log" in sample.reader else None
    except tracker.TrackerError as error:
        return _one_line(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _one_line(error: Exception) -> str:
    assert "\n" not in str(error), f"several lines: {error}"
    return str(error)
