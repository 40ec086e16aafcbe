import contextlib
import errno
import io
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import tracker
from tests.helpers import make_camera
from tests.helpers.full_disk import no_file_longer_than
from tests.helpers.reading import frames_of
from tracker.calibration.rig import CameraRig
from tracker.color_learning.labelled import read_image
from tracker.errors import TrackerError
from tracker.files import claimed, lock_of, open_regular, read_bounded, whole_file, write_whole
from tracker.files.hdf5 import Disk, check_stated_end, open_file, text_of
from tracker.files.stores import LmdbFile
from tracker.logs.native import NativeSource
from tracker.objects.model import object_names
from tracker.poses.file import is_poses_file, read_poses
from tracker.segmentation.color_model import color_model_names

pytestmark = pytest.mark.timeout(5)  # a read that waits fails soon


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


def test_an_interrupt_while_a_file_is_opened_is_not_taken_for_a_fault_of_it(tmp_path, monkeypatch):
    """The interrupt comes when the file object exists, which is forgotten, and so closed."""
    (tmp_path / "file").write_bytes(b"12345")

    def interrupted(*given: Any, opened: Callable[..., Any] = io.open, **options: Any) -> None:
        opened(*given, **options).close()
        raise KeyboardInterrupt

    monkeypatch.setattr(io, "open", interrupted)
    monkeypatch.setattr("tracker.files.open", interrupted, raising=False)
    with pytest.raises(KeyboardInterrupt):
        open_regular(tmp_path / "file")


def test_hidden_files_are_neither_objects_nor_colours(tmp_path, monkeypatch):
    monkeypatch.setattr("tracker.objects.model._DATA", tmp_path)
    monkeypatch.setattr("tracker.segmentation.color_model._DATA", tmp_path)
    for name in ("a.toml", "._a.toml", "b.npz", "._b.npz"):  # of a file system for Macs
        (tmp_path / name).touch()
    assert (object_names(), color_model_names()) == (("a",), ("b",))


def test_files_and_links_to_files_are_read_up_to_their_bound(tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_bounded(tmp_path / "link", 5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_bounded(tmp_path / "file", 4)


CALIBRATION = "camera60.yml", "arena.toml"


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("camera_data.dat", frames_of),
        ("camera_data.dat", NativeSource),
        ("camera_data.h5", check_stated_end),
        ("camera60.mp4", lambda path: frames_of(path.parent)),
        ("camera60.png", lambda path: frames_of(path.parent)),
        ("data.mdb", LmdbFile),
        ("poses.h5", read_poses),
        ("object.toml", tracker.load_object),
        ("colors.npz", tracker.load_colors),
        ("image.png", read_image),
        *[(name, lambda path: CameraRig.load(path.parent)) for name in CALIBRATION],
        *[(name, lambda path: CameraRig.load([path, path.parent / "camera60.yml"])) for name in CALIBRATION],
    ],
)
def test_a_pipe_in_the_place_of_any_file_is_an_error(name, read, tmp_path):
    CameraRig((make_camera(60),)).save(tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    message = rf"{name}: .*(regular file|expected a file|no such file)|expected a file like {name}"
    with pytest.raises(TrackerError, match=message):
        read(tmp_path / name)


def test_a_pipe_is_no_file_of_poses(tmp_path):
    os.mkfifo(tmp_path / "poses.h5")
    assert not is_poses_file(tmp_path / "poses.h5")
    assert text_of(tmp_path / "poses.h5", "fingerprint") is None
    with pytest.raises(OSError, match="regular file"):
        open_file(tmp_path / "poses.h5")


def test_what_the_disk_refuses_can_be_read_back_from_memory(tmp_path, rng):
    mirror = bytearray()
    with Disk(tmp_path / "file") as disk, no_file_longer_than(1000):
        for size in rng.integers(1, 500, 60).tolist():
            at, data = int(rng.integers(len(mirror) + 1)), rng.bytes(size)
            mirror[at : at + size] = data
            disk.seek(at)
            assert disk.write(data) == size
            back, place = bytearray(700), int(rng.integers(len(mirror)))
            disk.seek(place)
            assert back[: disk.readinto(back)] == mirror[place : place + 700]
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
    for key in ("images/0", "images/00", "zzz"):
        assert store.get(key, 1 << 20) is None
    store.close()


def test_content_arrives_with_the_permissions_of_any_other_file_and_nothing_else_stays(tmp_path):
    write_whole(tmp_path / "a.txt", "ä\n")
    write_whole(tmp_path / "b.bin", b"\x00\xff")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "ä\n"
    assert (tmp_path / "b.bin").read_bytes() == b"\x00\xff"
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "b.bin"]
    (tmp_path / "plain.txt").write_text("x")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain.txt").stat().st_mode


def test_what_was_there_stays_if_writing_fails_and_the_file_is_named(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_whole(path, "old")

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_whole(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]
    with pytest.raises(FileNotFoundError) as raised:
        write_whole(tmp_path / "no" / "a.txt", "x")
    assert raised.value.filename == str(tmp_path / "no" / "a.txt")


def test_a_pipe_or_a_device_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="found a pipe or a device, expected a regular file"):
        write_whole(tmp_path / "pipe", "content")
    assert (tmp_path / "pipe").is_fifo()


def test_a_link_stays_one_and_what_it_means_is_written(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "near.txt").symlink_to(tmp_path / "far" / "a.txt")
    for content in ("new", "newer"):
        write_whole(tmp_path / "near.txt", content)
        assert (tmp_path / "near.txt").is_symlink()
        assert (tmp_path / "far" / "a.txt").read_text() == content
    assert os.listdir(tmp_path / "far") == ["a.txt"]


@pytest.mark.skipif(sys.platform != "linux", reason="system: names of open files")
def test_content_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    done = []
    replace = os.replace
    monkeypatch.setattr(os, "fsync", lambda number: done.append(os.readlink(f"/proc/self/fd/{number}")))
    monkeypatch.setattr(os, "replace", lambda old, new: (done.append("named"), replace(old, new)))
    write_whole(tmp_path / "a.txt", "x")
    assert [Path(one).name for one in done] == ["a.txt", "named", tmp_path.name]


@pytest.mark.parametrize("name", ["a" * 255, "é" * 127, "录" * 85, "\udcff" * 255])
def test_a_name_may_be_as_long_as_file_systems_allow(name, tmp_path):
    other = f"{name[:-1]}1"
    with claimed(tmp_path / name), claimed(tmp_path / other):
        write_whole(tmp_path / name, "content")
        assert os.path.exists(lock_of(tmp_path / name))
        assert lock_of(tmp_path / name) != lock_of(tmp_path / other)
    assert os.listdir(tmp_path) == [name]


def test_two_writers_do_not_share_a_temporary_file(tmp_path):
    with whole_file(tmp_path / "a.txt") as one, whole_file(tmp_path / "a.txt") as two:
        one.write_text("one")
        two.write_text("two")
    assert (tmp_path / "a.txt").read_text() == "one"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_claimed_file_is_refused_to_others_until_it_is_free(tmp_path):
    path = tmp_path / "a.txt"
    lock_of(path).touch()  # as a process that was killed leaves it
    (tmp_path / "link.txt").symlink_to(path)
    with claimed(path):
        for same in (path, tmp_path / "link.txt"):
            with pytest.raises(BlockingIOError, match="another run"), claimed(same):
                pass
        with claimed(tmp_path / "b.txt"):
            pass
    with claimed(path):
        pass
    assert os.listdir(tmp_path) == ["link.txt"]


def test_of_many_that_claim_and_free_a_file_one_has_it_at_a_time(tmp_path):
    alone, held = threading.Lock(), []

    def work(_: int) -> None:
        for _ in range(100):
            with contextlib.suppress(BlockingIOError), claimed(tmp_path / "a.txt"):
                held.append(alone.acquire(blocking=False))
                alone.release()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    assert held
    assert all(held)
