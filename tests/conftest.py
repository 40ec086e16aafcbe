"""Fixtures and settings of all tests."""

import gc
import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from tests.helpers import RIG, ROOT
from tests.helpers.command import Run
from tests.helpers.needs import (  # noqa: F401
    lack,
    pytest_configure,
    pytest_make_collect_report,
    pytest_runtest_makereport,
)
from tracker import CameraRig, cli
from tracker.warm_up import quickly

# What nohup ignores stays ignored, in the commands that tests begin, too; in the background so does Ctrl-C.
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Derandomised: a run never depends on chance or on earlier runs. Without a deadline, since the first
# call may compile.
settings.register_profile("repository", derandomize=True, deadline=None, database=None, max_examples=50)
settings.load_profile("repository")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Import and compile in less time: the garbage collector then runs seldom."""
    stack = ExitStack()
    stack.enter_context(quickly())
    session.config.add_cleanup(stack.close)


def pytest_collection_finish() -> None:
    gc.set_threshold(700, 10, 10)  # Python's own: what tests leave does not stay


@pytest.fixture(scope="session")
def real() -> Path:
    """Folder of recorded data of real platforms; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("TRACKER_REAL_DATA", ROOT.parent / "shared" / "real"))
    if not folder.is_dir():
        lack("real", "no recorded data; set TRACKER_REAL_DATA to its folder")
    return folder


@pytest.fixture(scope="session")
def rig() -> CameraRig:
    """Three cameras like the platform's, 270×270, whose calibration is exact."""
    return RIG


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)


@pytest.fixture
def run_here(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs the command in this process, which is faster; what compiled libraries print is seen too.

    `main` may be that of another program.
    """

    def run_it(
        *arguments: object, folder: Path = ROOT, main: Callable[[list[str]], object] = cli.main
    ) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(folder)
        capfd.readouterr()  # what a library printed before, as PyBullet does when it is imported
        with pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        printed = capfd.readouterr()
        return subprocess.CompletedProcess([], int(stop.value.code or 0), printed.out, printed.err)

    return run_it


@pytest.fixture
def run_script(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs a script with its arguments in this process, which has loaded already what the script imports."""

    def run_it(script: Path, *arguments: object, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", [str(script), *map(str, arguments)])
        runpy.run_path(str(script), run_name="__main__")
        printed = capfd.readouterr()
        return subprocess.CompletedProcess([], 0, printed.out, printed.err)

    return run_it
