import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers import ROOT, run_python
from tests.helpers.log_writers import make_content, write_hdf5, write_native, write_store

COUNT = 24


def native(path: Path) -> Path:
    return write_native(path, make_content(COUNT))


def packed(path: Path) -> Path:
    return write_native(path, make_content(COUNT), packed=True)


def hdf5(path: Path) -> Path:
    return write_hdf5(path, make_content(COUNT), chunk=4)


def store(path: Path) -> Path:
    for module in ("lmdb", "numcodecs"):
        pytest.importorskip(module, reason=f"datasets: no module {module}")
    return write_store(path, make_content(COUNT))


def film(path: Path) -> Path:
    pytest.importorskip("av", reason="video: no module av")
    path = path.with_suffix(".mp4")
    shades = (np.full((32, 32, 3), 10 * k, np.uint8) for k in range(COUNT))
    tracker.viz.write_film(path, shades, 10.0)
    return path


@pytest.mark.parametrize("write", [native, packed, hdf5, store, film])
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


FORKED = """
import hashlib, multiprocessing, sys, tracker
log = tracker.open_log(sys.argv[1])
def look(number):
    try:
        return hashlib.sha256(log.frame(number).images[0].tobytes()).hexdigest()
    except tracker.TrackerError as error:
        return str(error)
numbers = [7 * k % len(log) for k in range(200)]
expected = [look(number) for number in numbers]
with multiprocessing.get_context("fork").Pool(3) as pool:
    found = pool.map(look, numbers, chunksize=1)
print(found == expected, {text[-11:] for text in found if "was opened in another process" in text})
"""


@pytest.mark.parametrize(
    ("write", "shared"), [(native, True), (hdf5, True), (packed, False), (store, False), (film, False)]
)
def test_forked_processes_read_right_images_or_none(write, shared, tmp_path):
    done = run_python(["-c", FORKED, write(tmp_path / "log")], ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == ("True set()\n" if shared else "False {'in this one'}\n")
