"""Damaged recordings: an error that is a LogError, fewer frames, or the same frames.

Each of the recorded samples is damaged in 200 ways from a seed: cut off, bits flipped anywhere or in the
first bytes (where the lengths stand), numbers overwritten, pieces doubled or left out. Readers run in
processes of their own, with limited memory and time, so that a crash of a compiled library is seen as one.

What no reader can notice, and these tests therefore allow:
- In a plain native log nothing protects pixels; a flipped bit there gives another image. Nor small changes
  of stamps that stay in order, nor of a pose that stays one. The flag `continuous` carries nothing.
- In a gzipped log the checksum is at the end: frames given before are in doubt when it disagrees, and that is
  said then.
- In an HDF5 log images are protected by gzip's checksum; stamps, poses and calibration are not, as above.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import signal
import zlib
from collections.abc import Iterator
from multiprocessing.connection import wait
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.logs.test_hdf5 import SAMPLES as HDF5
from tests.logs.test_native import SAMPLES as NATIVE

VARIANTS = 200
SECONDS = 10
BYTES = 3 << 30
HEAD = {"camera_data": 33, "tricamera_log": 6000}
"""The first bytes, in which lengths stand."""


def damaged(data: bytes, head: int, seed: int) -> bytes:
    """One of many kinds of damage, always the same for a seed."""
    rng = np.random.default_rng(seed)
    result = bytearray(data)
    kind = ("cut", "flip", "flip head", "overwrite", "overwrite head", "double", "leave out", "zeros")[
        seed % 8
    ]
    reach = min(head, len(data)) if "head" in kind else len(data)
    at = int(rng.integers(reach))
    if kind == "cut":
        return data[:at]
    if kind.startswith("flip"):
        for place in (at, *rng.integers(reach, size=int(rng.integers(4)))):
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


def frames_of(path: str, recover: bool) -> tuple[str | None, list[tuple[int, list[int]]]]:
    """What is said to be wrong, and of each frame number and checksums of the images."""
    frames = []
    fault = None
    try:
        with tracker.open_log(path, recover=recover) as log:
            for frame in log:
                frames.append((frame.index, [zlib.crc32(image) for image in frame.images]))
                for pose in (frame.recorded_pose, frame.recorded_filtered_pose):
                    assert pose is None or np.isfinite([*pose.position, *pose.orientation]).all()
            fault = log.fault
            with contextlib.suppress(tracker.TrackerError):
                _ = log.rig
    except tracker.TrackerError as error:
        fault = str(error)
    assert fault is None or "\n" not in fault
    return fault, frames


def in_process(paths: list[str], answers) -> None:
    """Read files as they come, telling before each which it is."""
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process
    for path in paths:
        answers.send(("reads", path, None))
        signal.alarm(SECONDS)
        try:
            answers.send(("read", path, [frames_of(path, recover) for recover in (False, True)]))
        except BaseException as error:
            answers.send(("raised", path, repr(error)))
    signal.alarm(0)
    answers.close()


def read_all(paths: list[str]) -> Iterator[tuple[str, str, object]]:
    """Answers of two processes that share the files; one that dies is an answer too."""
    context = multiprocessing.get_context("spawn")
    running, at = {}, {}
    for part in (paths[::2], paths[1::2]):
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=in_process, args=(part, sender))
        process.start()
        sender.close()
        running[receiver] = process
    while running:
        # Whichever has something to say: one that waits to be heard runs out of its time.
        for receiver in wait(list(running)):
            try:
                kind, at[receiver], answer = receiver.recv()
                if kind != "reads":
                    yield kind, at[receiver], answer
            except EOFError:
                process = running.pop(receiver)
                process.join()
                if process.exitcode:
                    yield f"died with {process.exitcode}", at[receiver], None


@pytest.fixture(scope="module")
def answers(real: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[str, str, object]]]:
    """What became of each damaged file, by the sample that it was."""
    folder = tmp_path_factory.mktemp("damaged")
    paths = []
    for name in (*NATIVE, *HDF5):
        data = (real / "logs" / name).read_bytes()
        head = next(size for prefix, size in HEAD.items() if name.startswith(prefix))
        (folder / name).mkdir()
        for seed in range(VARIANTS):
            path = folder / name / f"{seed}"
            path.write_bytes(damaged(data, head, seed))
            paths.append(str(path))
    found: dict[str, list[tuple[str, str, object]]] = {name: [] for name in (*NATIVE, *HDF5)}
    for answer in read_all(paths):
        found[Path(answer[1]).parent.name].append(answer)
    return found


@pytest.mark.parametrize("name", [*NATIVE, *HDF5])
def test_damage_gives_errors_or_frames_that_are_whole(real: Path, answers, name):
    _, whole = frames_of(str(real / "logs" / name), recover=False)
    answered, noticed, recovered = 0, 0, 0
    for kind, path, answer in answers[name]:
        assert kind == "read", f"{path}: {kind} {answer}"
        answered += 1
        (fault, frames), (said, given) = answer
        assert (fault is None) <= (said is None), path
        if name != NATIVE[0] and name != NATIVE[1] and fault is None:
            # Checksums: without notice images are those of the whole recording.
            assert frames == whole, path
        assert fault is not None or [number for number, _ in frames] == [number for number, _ in whole], path
        assert len(given) >= len(frames), path
        if name in HDF5:
            assert all(frame in whole for frame in given), path
        noticed += fault is not None
        recovered += bool(given) and said is not None
    assert answered == VARIANTS
    assert noticed > 0.4 * VARIANTS
    assert recovered > 0.05 * VARIANTS
