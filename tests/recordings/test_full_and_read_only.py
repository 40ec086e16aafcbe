"""Places that really take nothing (files may not grow, folders not be written), and inputs that grow."""

from __future__ import annotations

import contextlib
import os
import resource
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.log_writers import make_content, write_native
from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import NoiseTracker, tiny_rig, write_log
from tracker.batch.run import Batch, run_batch
from tracker.batch.tables import state
from tracker.batch.workers import here
from tracker.calibration.files.platform import write_camera
from tracker.errors import TrackerError
from tracker.logs import open_log
from tracker.logs.convert import write_folder, write_hdf5
from tracker.poses.exports import write_bop, write_csv, write_parquet, write_tum
from tracker.poses.file import read_poses, write_poses
from tracker.recordings import Options


@contextlib.contextmanager
def no_file_longer_than(size: int) -> Iterator[None]:
    """As on a disk that is full: a write beyond is refused."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.fixture
def read_only(tmp_path) -> Path:
    folder = tmp_path / "read_only"
    folder.mkdir(mode=0o555)
    # Who may do everything needs a folder of the kernel's own.
    return Path("/sys") if os.access(folder, os.W_OK) else folder


def test_what_the_disk_has_no_room_for_is_named_and_all_else_is_done(tmp_path):
    for name, frames in (("a", 5), ("b", 300), ("c", 6)):
        write_log(tmp_path / "in" / name, frames)
    options = Options("cube_v2", make_tracker=NoiseTracker)
    one, results = Batch.of([f"{tmp_path}/in/*"], tmp_path / "out", options), []
    with no_file_longer_than(30_000):
        run_batch(one, lambda: contextlib.nullcontext(here), results.append)
    assert [result["failure"] and result["failure"].split(": ", 1)[1] for result in results] == [
        None,
        "cannot be written: File too large",
        None,
    ]
    found = state(one)
    assert (len(found.lines), len(found.failures)) == (2, 1)
    assert len(read_poses(one.folder / one.pairs[2][1])) == 6
    assert not list((tmp_path / "out").rglob("*.tmp"))
    results.clear()
    run_batch(one, lambda: contextlib.nullcontext(here), results.append)
    assert [result and result["failure"] for result in results] == [None] * 3
    assert len(state(one).lines) == 3


WRITERS = {
    "poses.h5": lambda path, poses, log: write_poses(path, poses),
    "poses.csv": lambda path, poses, log: write_csv(path, poses),
    "poses.tum": lambda path, poses, log: write_tum(path, poses),
    "bop.csv": lambda path, poses, log: write_bop(path, poses, poses.about.rig[0]),
    "poses.parquet": lambda path, poses, log: write_parquet(path, poses),
    "camera60.yml": lambda path, poses, log: write_camera(poses.about.rig[0], path),
    "log.h5": lambda path, poses, log: write_hdf5(path, log, tiny_rig(), lambda count: None),
    "folder": lambda path, poses, log: write_folder(path, log, tiny_rig(), lambda count: None),
}
NEW = "log.h5", "folder"
"""Written only where nothing is yet."""


@pytest.fixture
def whole(tmp_path, name) -> tuple:
    if name == "poses.parquet":
        pytest.importorskip("pyarrow", reason="Parquet: no module pyarrow")
    log = open_log(write_native(tmp_path / "log", make_content(4)))
    yield random_poses(np.random.default_rng(0), 400), log
    log.close()


@pytest.mark.parametrize("name", WRITERS)
def test_a_place_that_cannot_be_written_is_reported_in_one_line(name, read_only, whole, tmp_path):
    for folder in (read_only, tmp_path / "none"):
        with pytest.raises(TrackerError) as raised:
            WRITERS[name](folder / name, *whole)
        assert str(raised.value).startswith(f"{folder / name}: cannot be written: ")
        assert "\n" not in str(raised.value)
        assert not (folder / name).exists()


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_reported_in_one_line_and_leaves_what_was_there(name, tmp_path, whole):
    (tmp_path / "out").mkdir()
    target = tmp_path / "out" / name
    if name not in NEW:
        target.write_text("old")
    with no_file_longer_than(700), pytest.raises(TrackerError) as raised:
        WRITERS[name](target, *whole)
    assert "cannot be written" in str(raised.value)
    assert "File too large" in str(raised.value)
    assert "\n" not in str(raised.value)
    assert [path.read_text() for path in target.parent.iterdir()] == ([] if name in NEW else ["old"])


@pytest.mark.parametrize("name", NEW)
def test_a_recording_that_grows_while_it_is_converted_is_reported(name, tmp_path, whole):
    poses, log = whole
    with (tmp_path / "log").open("ab") as file:
        file.write(b"more")
    (tmp_path / "out").mkdir()
    with pytest.raises(TrackerError, match="found bytes after record 3"):
        WRITERS[name](tmp_path / "out" / name, poses, log)
    assert os.listdir(tmp_path / "out") == []
