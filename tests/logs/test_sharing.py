import _thread
import contextlib
import gzip
import os
import struct
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers import run_python
from tests.helpers.log_writers import make_content, native_bytes, write_hdf5, write_native, write_store
from tests.helpers.reading import peak_memory
from tracker.errors import LogError

COUNT = 24


def store(path: Path, content=None, **options: int) -> Path:
    for module in ("lmdb", "numcodecs"):
        pytest.importorskip(module, reason=f"datasets: no module {module}")
    return write_store(path, content or make_content(COUNT), **options)


def film(path: Path) -> Path:
    pytest.importorskip("av", reason="video: no module av")
    path = path.with_suffix(".mp4")
    shades = (np.full((32, 32, 3), 10 * k, np.uint8) for k in range(COUNT))
    tracker.viz.write_film(path, shades, 10.0)
    return path


WRITERS = {
    "native": lambda path: write_native(path, make_content(COUNT)),
    "packed": lambda path: write_native(path, make_content(COUNT), packed=True),
    "hdf5": lambda path: write_hdf5(path, make_content(COUNT), chunk=4),
    "store": store,
    "film": film,
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_threads_share_a_log(write, tmp_path):
    numbers = np.random.default_rng(1).integers(0, COUNT, 200).tolist()
    interval = sys.getswitchinterval()
    with tracker.open_log(write(tmp_path / "log")) as log, ThreadPoolExecutor(4) as pool:
        expected = [log.frame(k).images for k in range(COUNT)]
        sys.setswitchinterval(1e-6)
        try:
            found = list(pool.map(log.frame, numbers))
        finally:
            sys.setswitchinterval(interval)
    for number, frame in zip(numbers, found, strict=True):
        assert frame.index == number
        np.testing.assert_array_equal(frame.images, expected[number])


@pytest.mark.parametrize("lost", [100, 5000])
@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_log_that_shrinks_while_it_is_open_gives_the_same_images_or_an_error(write, lost, tmp_path):
    path = write(tmp_path / "log")
    with tracker.open_log(path) as log:
        expected = [frame.images for frame in log]
        file = path / "data.mdb" if path.is_dir() else path
        os.truncate(file, max(file.stat().st_size - lost, 0))
        for number, images in enumerate(expected):
            with contextlib.suppress(LogError):
                np.testing.assert_array_equal(log.frame(number).images, images)


# Python reports an interrupt that falls into a callback, and goes on.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_log_is_read_on_after_ctrl_c(write, tmp_path, rng):
    with tracker.open_log(write(tmp_path / "log")) as log:
        expected = [frame.images for frame in log]
        for wait in rng.uniform(0, 0.02, 50):
            with contextlib.suppress(KeyboardInterrupt):
                timer = threading.Timer(wait, _thread.interrupt_main)
                timer.start()
                for number in [*range(COUNT)] * 4:
                    log.frame(number)
                timer.join()
            for number in rng.integers(COUNT, size=2):
                np.testing.assert_array_equal(log.frame(number).images, expected[number])


FORKED = """
import hashlib, multiprocessing, sys, tracker
def look(number):
    try:
        return hashlib.sha256(log.frame(number).images[0].tobytes()).hexdigest()
    except tracker.TrackerError as error:
        return str(error)
for path in sys.argv[1:]:
    log = tracker.open_log(path)
    numbers = [7 * k % len(log) for k in range(200)]
    expected = [look(number) for number in numbers]
    with multiprocessing.get_context("fork").Pool(3) as pool:
        found = pool.map(look, numbers, chunksize=1)
    print(found == expected, {text[-11:] for text in found if "was opened in another process" in text})
"""


def test_forked_processes_read_right_images_or_none(tmp_path):
    done = run_python(["-c", FORKED, *(write(tmp_path / name) for name, write in WRITERS.items())])
    assert (done.returncode, done.stderr) == (0, "")
    shared, refused = "True set()", "False {'in this one'}"
    assert done.stdout.splitlines() == [shared, refused, shared, refused, refused]


def long_native(path: Path, count: int) -> Path:
    record = native_bytes(make_content(1, size=120))[12:]
    with gzip.open(path, "wb", 1) if path.suffix == ".gz" else path.open("wb") as file:
        file.write(struct.pack("<IQ", 1, count))
        file.writelines([record] * count)  # stamps may repeat but not go back
    return path


@pytest.mark.parametrize(
    ("write", "suffix", "few", "many"),
    [
        (long_native, ".dat", 20, 200),
        (long_native, ".gz", 20, 100),
        (lambda p, n: write_hdf5(p, make_content(n, size=120)), ".h5", 10, 60),
        (lambda p, n: store(p, make_content(2, size=140), length=3 * n, map_size=1 << 27), ".zarr", 10, 60),
    ],
)
def test_memory_does_not_grow_with_the_length(write, suffix, few, many, tmp_path):
    def peak(count: int) -> int:
        path = write(tmp_path / f"{count}{suffix}", count)
        with peak_memory() as used, tracker.open_log(path) as log:
            assert sum(1 for _ in log) == count
        return used[0]

    peak(2)
    assert peak(many) < 1.2 * peak(few)
