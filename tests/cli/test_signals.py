"""Being asked to end from outside."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

import pytest

from tests.helpers.recording_stubs import write_log
from tracker.cli.signals import ended_by_signals


class Finalized:
    """Python drops what its finalizer raises, and an interrupt may come while that runs."""

    def __del__(self) -> None:
        raise KeyboardInterrupt


def drop_an_interrupt() -> None:
    Finalized()
    time.sleep(60)


def ask_to_end(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60)


@pytest.fixture(autouse=True)
def heard():
    """A run in the background hands on that Ctrl-C is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_within_a_finalizer_is_not_lost():
    before = sys.unraisablehook
    with ended_by_signals(), pytest.raises(KeyboardInterrupt):
        drop_an_interrupt()
    assert sys.unraisablehook is before


def test_being_asked_to_end_is_an_interrupt():
    before = signal.getsignal(signal.SIGTERM)
    with ended_by_signals(), pytest.raises(KeyboardInterrupt):
        ask_to_end()
    assert signal.getsignal(signal.SIGTERM) is before


def test_threads_other_than_the_main_one_are_left_as_they_are():
    told = []

    def work() -> None:
        with ended_by_signals():
            told.append(sys.unraisablehook)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert told == [sys.unraisablehook]


def test_a_command_that_is_asked_to_end_leaves_nothing_half_written(tmp_path, run_here, monkeypatch):
    log = write_log(tmp_path / "job", 3)
    (tmp_path / "out").mkdir()
    monkeypatch.setattr("cv2.imencode", ask_to_end)
    monkeypatch.setattr("cv2.imwrite", ask_to_end)
    result = run_here("convert", log, "-o", tmp_path / "out" / "folder")
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "tracker: interrupted\n")
    assert os.listdir(tmp_path / "out") == []
