import errno
import os
import resource
import signal
from pathlib import Path

import pytest

import tracker
from tests.helpers import make_camera
from tracker.calibration.rig import CameraRig
from tracker.color_learning.labelled import read_image
from tracker.errors import CalibrationError, TrackerError
from tracker.files import open_regular, read_bounded
from tracker.files.hdf5 import Disk, check_stated_end, open_file
from tracker.files.stores import LmdbFile
from tracker.logs.native import NativeSource
from tracker.poses.file import is_poses_file, read_fingerprint, read_poses


@pytest.fixture(autouse=True)
def soon():
    """A read that waits fails after five seconds."""

    def late(*_: object) -> None:
        raise TimeoutError("a read waits for ever")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(5)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("read", [open_regular, lambda path: read_bounded(path, 100)])
def test_what_is_no_regular_file_is_refused_without_waiting(read, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for path in (tmp_path / "pipe", tmp_path / "link", Path("/dev/zero")):
        with pytest.raises(OSError, match="expected a regular file"):
            read(path)
    with pytest.raises(IsADirectoryError):
        read(tmp_path)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none")


def test_files_and_links_to_files_are_read_up_to_their_bound(tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_bounded(tmp_path / "link", 5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_bounded(tmp_path / "file", 4)


@pytest.mark.parametrize("name", ["camera60.yml", "arena.toml"])
def test_a_pipe_in_the_place_of_a_calibration_is_an_error(name, tmp_path):
    CameraRig((make_camera(60),)).save(tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(CalibrationError, match=r"expected a (regular )?file"):
        CameraRig.load(tmp_path)
    with pytest.raises(CalibrationError, match="regular file"):
        CameraRig.load([tmp_path / name, tmp_path / "camera60.yml"])


def frames_of(path: Path) -> list:
    with tracker.open_log(path) as log:
        return list(log)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("camera_data.dat", frames_of),
        ("camera_data.dat", lambda path: NativeSource(path, recover=True)),
        ("camera_data.h5", check_stated_end),
        ("camera60.mp4", lambda path: frames_of(path.parent)),
        ("camera60.png", lambda path: frames_of(path.parent)),
        ("data.mdb", LmdbFile),
        ("poses.h5", read_poses),
        ("object.toml", tracker.load_object),
        ("colors.npz", tracker.load_colors),
        ("image.png", read_image),
    ],
)
def test_a_pipe_in_the_place_of_any_file_is_an_error(name, read, tmp_path):
    os.mkfifo(tmp_path / name)
    with pytest.raises(TrackerError, match=rf"{name}: .*(regular file|expected a file|no such file)"):
        read(tmp_path / name)


def test_a_pipe_is_no_file_of_poses(tmp_path):
    os.mkfifo(tmp_path / "poses.h5")
    assert not is_poses_file(tmp_path / "poses.h5")
    assert read_fingerprint(tmp_path / "poses.h5") == ""
    with pytest.raises(OSError, match="regular file"):
        open_file(tmp_path / "poses.h5")


def test_what_the_disk_refuses_can_be_read_back_from_memory(tmp_path, rng):
    limits, mirror = resource.getrlimit(resource.RLIMIT_FSIZE), bytearray()
    with Disk(tmp_path / "file") as disk:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        try:
            for size in rng.integers(1, 500, 60).tolist():
                at, data = int(rng.integers(len(mirror) + 1)), rng.bytes(size)
                mirror[at : at + size] = data
                disk.seek(at)
                assert disk.write(data) == size
                back, place = bytearray(700), int(rng.integers(len(mirror)))
                disk.seek(place)
                assert back[: disk.readinto(back)] == mirror[place : place + 700]
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert disk.seek(0, os.SEEK_END) == len(mirror) > 1000
        assert disk.fault.errno == errno.EFBIG


@pytest.mark.parametrize("count", [0, 1, 300])
def test_all_that_an_lmdb_database_holds_is_found(tmp_path, rng, count):
    lmdb = pytest.importorskip("lmdb", reason="datasets: no module lmdb")
    values = {f"images/{k}": rng.bytes(int(rng.integers(0, 6000))) for k in rng.permutation(count)}
    with lmdb.open(str(tmp_path), map_size=1 << 24) as environment:
        for _ in range(2):  # twice, so that pages are freed and used again
            with environment.begin(write=True) as transaction:
                for key, value in values.items():
                    transaction.put(key.encode(), value)
                transaction.delete(b"images/0")
    values.pop("images/0", None)
    store = LmdbFile(tmp_path / "data.mdb")
    assert store.entries == len(values)
    for key, value in values.items():
        assert store.get(key, 1 << 20) == value
    for key in ("", "images/0", "images/00", "zzz"):
        assert store.get(key, 1 << 20) is None
    store.close()
