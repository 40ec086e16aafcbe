import contextlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests.helpers import ROOT
from tracker.files import claimed, lock_of, whole_file, write_whole


def test_content_arrives_and_nothing_else_stays(tmp_path):
    write_whole(tmp_path / "a.txt", "ä\n")
    write_whole(tmp_path / "b.bin", b"\x00\xff")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "ä\n"
    assert (tmp_path / "b.bin").read_bytes() == b"\x00\xff"
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "b.bin"]


def test_what_was_there_stays_if_writing_fails(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_whole(path, "old")

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_whole(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_errors_name_the_file_that_was_asked_for(tmp_path):
    with pytest.raises(FileNotFoundError) as raised:
        write_whole(tmp_path / "no" / "a.txt", "x")
    assert raised.value.filename == str(tmp_path / "no" / "a.txt")


def test_a_link_stays_one_and_what_it_means_is_written(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "near.txt").symlink_to(tmp_path / "far" / "a.txt")
    for content in ("new", "newer"):
        write_whole(tmp_path / "near.txt", content)
        assert (tmp_path / "near.txt").is_symlink()
        assert (tmp_path / "far" / "a.txt").read_text() == content
    assert os.listdir(tmp_path / "far") == ["a.txt"]


def test_a_file_has_the_permissions_of_any_other(tmp_path):
    (tmp_path / "plain.txt").write_text("x")
    write_whole(tmp_path / "whole.txt", "x")
    assert (tmp_path / "whole.txt").stat().st_mode == (tmp_path / "plain.txt").stat().st_mode


@pytest.mark.skipif(sys.platform != "linux", reason="system: names of open files")
def test_content_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(
        os, "fsync", lambda descriptor: done.append(os.readlink(f"/proc/self/fd/{descriptor}"))
    )
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda old, new: (done.append("named"), replace(old, new)))
    write_whole(tmp_path / "a.txt", "x")
    assert [Path(one).name for one in done] == ["a.txt", "named", tmp_path.name]


@pytest.mark.parametrize("name", ["a" * 255, "é" * 127, "录" * 85, "\udcff" * 255])
def test_a_name_may_be_as_long_as_file_systems_allow(name, tmp_path):
    with claimed(tmp_path / name):
        write_whole(tmp_path / name, "content")
        assert os.path.exists(lock_of(tmp_path / name))
    assert os.listdir(tmp_path) == [name]


def test_two_writers_do_not_share_a_temporary_file(tmp_path):
    with whole_file(tmp_path / "a.txt") as one, whole_file(tmp_path / "a.txt") as two:
        one.write_text("one")
        two.write_text("two")
    assert (tmp_path / "a.txt").read_text() == "one"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_claimed_file_is_refused_to_others_until_it_is_free(tmp_path):
    path = tmp_path / "a.txt"
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


CLAIM = """
import sys, time
from tracker.files import claimed
with claimed(sys.argv[1]):
    print("claimed", flush=True)
    time.sleep(60)
"""


def test_the_claim_of_a_killed_process_is_void(tmp_path):
    path = tmp_path / "a.txt"
    process = subprocess.Popen([sys.executable, "-c", CLAIM, path], cwd=ROOT, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"claimed\n"
    with pytest.raises(BlockingIOError), claimed(path):
        pass
    process.kill()
    process.communicate()
    with claimed(path):
        pass
    assert os.listdir(tmp_path) == []


def test_of_many_that_claim_and_free_a_file_one_has_it_at_a_time(tmp_path):
    held, most, lock = 0, 0, threading.Lock()

    def work() -> None:
        nonlocal held, most
        for _ in range(100):
            with contextlib.suppress(BlockingIOError), claimed(tmp_path / "a.txt"):
                with lock:
                    held += 1
                    most = max(most, held)
                with lock:
                    held -= 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1
