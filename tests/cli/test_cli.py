import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import ROOT
from tests.helpers.command import well
from tracker import cli
from tracker.cli.terminal import Ended, bar


@pytest.mark.parametrize(
    ("command", "words"),
    [
        *[(name, ()) for name in ("", "track", "dice", "colors", "colors fit", "colors check")],
        *[(name, ()) for name in ("colors adapt", "colors new")],
        ("detect", ("cube_v1, cube_v2, cube_v3, cuboid_2x2x8_v2, simulated_cube, simulated_cuboid, or a",)),
        ("detect", ("cuboid, or a TOML file", "dice, simulation, or a file (.npz)", "recording (.dat, .h5)")),
    ],
)
def test_every_command_explains_itself_and_names_what_can_be_named(command, words, run_here):
    result = run_here(*command.split(), "--help")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith(f"Usage: tracker {command}".rstrip())
    for word in words:
        assert word in " ".join(result.stdout.split())


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


def help_into(stdout) -> tuple[int, list[str]]:
    """Exit code and lines on stderr of `tracker --help` that writes there."""
    command = [sys.executable, "-m", "tracker", "--help"]
    done = subprocess.run(command, cwd=ROOT, stdout=stdout, stderr=subprocess.PIPE, check=False, text=True)
    return done.returncode, done.stderr.splitlines()


@pytest.mark.skipif(os.name != "posix", reason="system: pipes and devices of POSIX systems")
def test_a_reader_that_has_left_is_no_reason_to_complain():
    reader, writer = os.pipe()
    os.close(reader)
    assert help_into(writer) == (2, [])
    os.close(writer)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="system: no /dev/full")
def test_output_that_cannot_be_written_is_one_line():
    with open("/dev/full", "w") as full:
        code, (line,) = help_into(full)
    assert code == 2
    assert line.startswith("tracker: output: ")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="system: no /dev/full")
def test_an_error_that_cannot_be_told_is_still_an_error():
    command = [sys.executable, "-m", "tracker", "info", "nowhere"]
    with open("/dev/full", "w") as full:
        assert subprocess.run(command, cwd=ROOT, stderr=full, check=False).returncode == 2


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
    ],
)
def test_whatever_happens_is_one_line_without_traceback(raised, code, message, monkeypatch, capsys):
    def fail(_: object) -> None:
        raise raised

    monkeypatch.setattr("tracker.load_object", fail)
    with pytest.raises(SystemExit) as stop:
        cli.main(["detect", "--object", "cube_v2", "--calibration", "x", "x.png"])
    assert stop.value.code == code
    printed = capsys.readouterr()
    assert message in printed.err
    assert len(printed.err.splitlines()) == 1
    assert printed.out == ""


class Terminal(io.StringIO):
    def isatty(self):
        return True


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
