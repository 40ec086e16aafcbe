import functools
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.helpers import ROOT
from tests.helpers.command import Terminal, well
from tests.helpers.recording_stubs import write_log
from tracker import cli
from tracker.cli.terminal import bar
from tracker.processes import Ended, ended_by_signals, exit_code


@pytest.mark.parametrize(
    ("command", "words"),
    [
        *((name, ()) for name in ("", "track", "dice", "colors")),
        *((f"colors {name}", ()) for name in ("fit", "check", "adapt", "new")),
        ("detect", ("cube_v1, cube_v2, cube_v3, cuboid_2x2x8_v2, simulated_cube, simulated_cuboid, or a",)),
        ("detect", ("cuboid, or a TOML file", "dice, simulation, or a file (.npz)", "recording (.dat, .h5)")),
    ],
)
def test_every_command_explains_itself_and_names_what_can_be_named(command, words, run_here):
    result = run_here(*command.split(), "--help")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith(f"Usage: tracker {command}".rstrip())
    assert all(word in " ".join(result.stdout.split()) for word in words)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("ca", "plain,calibrate"),
        ("detect --object cuboid", "plain,cuboid_2x2x8_v2"),
        ("track --colors si", "plain,simulation"),
        ("detect --object my_", "file,my_"),
    ],
)
def test_a_shell_completes_commands_objects_and_colours(words, expected, monkeypatch, run_here):
    monkeypatch.setenv("_TRACKER_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"tracker {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    assert well(run_here()).stdout.split() == [expected]


def test_exit_codes_have_one_meaning_given_in_the_help_and_in_the_documentation(run_here):
    shown, page = run_here("--help").stdout, (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for code, what in cli.EXIT_CODES.items():
        assert f"  {code:<4} {what}\n" in shown
        assert f"| {code} | {what} |\n" in page.replace("`", "")


def test_the_version_is_printed(run_here):
    assert well(run_here("--version")).stdout.startswith("tracker ")


def run_into(*arguments, stdout=None, stderr=subprocess.PIPE):
    """What a command whose output goes there returns and says."""
    command = [sys.executable, "-m", "tracker", *arguments]
    return subprocess.run(command, cwd=ROOT, stdout=stdout, stderr=stderr, check=False, text=True)


@pytest.mark.skipif(os.name != "posix", reason="system: pipes and devices of POSIX systems")
def test_a_reader_that_has_left_is_no_reason_to_complain():
    reader, writer = os.pipe()
    os.close(reader)
    done = run_into("--help", stdout=writer)
    assert (done.returncode, done.stderr) == (2, "")
    os.close(writer)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="system: no /dev/full")
def test_output_that_cannot_be_written_is_one_line_and_an_error_that_cannot_be_told_is_still_one():
    with open("/dev/full", "w") as full:
        done = run_into("--help", stdout=full)
        assert run_into("info", "nowhere", stderr=full).returncode == 2
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2
    assert line.startswith("tracker: output: ")


def error_after(stop: KeyboardInterrupt) -> ImportError:
    error = ImportError("initialization failed")
    error.__cause__ = stop
    return error


@pytest.mark.parametrize(
    ("raised", "code", "message"),
    [
        (error_after(Ended(signal.SIGHUP)), 129, "tracker: interrupted\n"),
        (KeyboardInterrupt(), 130, "tracker: interrupted\n"),
        (RuntimeError("two\nlines"), 2, "RuntimeError in test_cli.py"),
        (OSError(28, "No space left on device", "x"), 2, "tracker: x: No space left on device\n"),
    ],
)
@pytest.mark.parametrize("closed", [False, True])
def test_whatever_happens_is_one_line_without_traceback(raised, code, message, closed, monkeypatch, capsys):
    def fail(_: object) -> None:
        raise raised

    if closed:  # by the parent process
        monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr("tracker.load_object", fail)
    with pytest.raises(SystemExit) as stop:
        cli.main(["detect", "--object", "cube_v2", "--calibration", "x", "x.png"])
    assert stop.value.code == code
    printed = capsys.readouterr()
    assert message in printed.err
    assert len(printed.err.splitlines()) == 1
    assert printed.out == ""


def test_a_bar_leaves_its_line_once_all_is_done(monkeypatch):
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    with bar("frames", 3, quiet=False) as advance:
        for _ in range(3):
            assert "frames" in shown.getvalue()
            advance(1)
        done = shown.getvalue()
        assert done.endswith("\r")
        assert not done.rsplit("\r", 2)[1].strip()
        advance(1)
    assert shown.getvalue() == done


CODES = {signal.SIGHUP: 129, signal.SIGINT: 130, signal.SIGTERM: 143}


def ask_to_end(number: int, *_: object) -> None:
    os.kill(os.getpid(), number)
    time.sleep(60)


class Finalized:
    """Python drops what its finalizer raises, and an interrupt may come while that runs."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __del__(self) -> None:
        ask_to_end(self.number)


def drop_and_wait(number: int) -> None:
    Finalized(number)
    time.sleep(60)


@pytest.mark.parametrize("number", CODES)
def test_a_signal_that_is_dropped_comes_again_as_itself(number):
    before = sys.unraisablehook
    with ended_by_signals(), pytest.raises(KeyboardInterrupt) as stop:
        drop_and_wait(number)
    assert exit_code(stop.value) == CODES[number]
    assert sys.unraisablehook is before


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
    def hook_within() -> object:
        with ended_by_signals():
            return sys.unraisablehook

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(hook_within).result() is sys.unraisablehook


@pytest.mark.parametrize("number", CODES)
def test_a_command_that_is_asked_to_end_leaves_nothing_half_written(number, tmp_path, run_here, monkeypatch):
    log, before = write_log(tmp_path / "job", 3), signal.getsignal(number)
    (tmp_path / "out").mkdir()
    for name in ("cv2.imencode", "cv2.imwrite"):
        monkeypatch.setattr(name, functools.partial(ask_to_end, number))
    result = run_here("convert", log, "-o", tmp_path / "out" / "folder")
    assert (result.returncode, result.stdout, result.stderr) == (CODES[number], "", "tracker: interrupted\n")
    assert os.listdir(tmp_path / "out") == []
    assert signal.getsignal(number) is before
