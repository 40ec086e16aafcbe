import functools
import os
import signal
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from tests.helpers.recording_stubs import write_log
from tracker.cli.terminal import ended_by_signals, exit_code


class Finalized:
    """Python drops what its finalizer raises, and an interrupt may come while that runs."""

    def __del__(self) -> None:
        raise KeyboardInterrupt


def drop_an_interrupt() -> None:
    Finalized()
    time.sleep(60)


def ask_to_end(*_: object, number: int = signal.SIGTERM) -> None:
    os.kill(os.getpid(), number)
    time.sleep(60)


CODES = {signal.SIGHUP: 129, signal.SIGINT: 130, signal.SIGTERM: 143}


@pytest.fixture(autouse=True)
def not_ignored():
    """A run in the background hands on that Ctrl-C is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_within_a_finalizer_is_not_lost():
    before = sys.unraisablehook
    with ended_by_signals(), pytest.raises(KeyboardInterrupt):
        drop_an_interrupt()
    assert sys.unraisablehook is before


@pytest.mark.parametrize("number", CODES)
def test_being_asked_to_end_is_an_interrupt(number):
    before = signal.getsignal(number)
    with ended_by_signals(), pytest.raises(KeyboardInterrupt) as stop:
        ask_to_end(number=number)
    assert signal.getsignal(number) is before
    assert exit_code(stop.value) == CODES[number]


def test_a_signal_that_is_dropped_comes_again_as_itself():
    def drop() -> None:
        try:
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(60)
        except KeyboardInterrupt as stop:
            sys.unraisablehook(SimpleNamespace(exc_value=stop))
        time.sleep(60)

    with ended_by_signals(), pytest.raises(KeyboardInterrupt) as stop:
        drop()
    assert exit_code(stop.value) == 129


def test_what_nohup_has_ignored_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_by_signals():
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(0.01)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_threads_other_than_the_main_one_are_left_as_they_are():
    hooks = []

    def work() -> None:
        with ended_by_signals():
            hooks.append(sys.unraisablehook)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert hooks == [sys.unraisablehook]


@pytest.mark.parametrize("number", CODES)
def test_a_command_that_is_asked_to_end_leaves_nothing_half_written(number, tmp_path, run_here, monkeypatch):
    log = write_log(tmp_path / "job", 3)
    (tmp_path / "out").mkdir()
    for name in ("cv2.imencode", "cv2.imwrite"):
        monkeypatch.setattr(name, functools.partial(ask_to_end, number=number))
    result = run_here("convert", log, "-o", tmp_path / "out" / "folder")
    assert (result.returncode, result.stdout, result.stderr) == (CODES[number], "", "tracker: interrupted\n")
    assert os.listdir(tmp_path / "out") == []
