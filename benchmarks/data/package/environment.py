"""The platform's own simulation package, in an environment of its own.

It comes from PyPI with more than this project wants to depend on. It gets a virtual environment below the
cache, or lives where the environment variable TRIFINGER_SIMULATION_PYTHON names an interpreter.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.data.store import CACHE
from tracker.errors import TrackerError

PACKAGE, VERSION = "trifinger-simulation", "2.0.0"
VARIABLE = "TRIFINGER_SIMULATION_PYTHON"
"""Environment variable that names an interpreter which can import the package."""

_SECONDS = 3600


class PackageError(TrackerError):
    """The simulation package cannot be had, or fails."""


def interpreter(folder: Path = CACHE, *, install: bool = True) -> Path:
    """An interpreter that can import the package; its environment is made if need be.

    Args:
        folder: where the environment is kept.
        install: whether to make it where there is none.

    Raises:
        PackageError: there is none, with the reason.
    """
    chosen = os.environ.get(VARIABLE)
    if chosen:
        if not Path(chosen).is_file():
            raise PackageError(f"{VARIABLE}={chosen}: no such file")
        return Path(chosen)
    root = folder.resolve() / f"{PACKAGE}-{VERSION}"
    python, stamp = root / "bin" / "python", root / ".installed"
    # The stamp is made last, so that what an interruption left unfinished is made again; an interpreter that
    # has gone since then is a link to a Python that was removed.
    if stamp.is_file() and python.is_file():
        return python
    if not install:
        raise PackageError(f"{PACKAGE} is not installed")
    folder.mkdir(parents=True, exist_ok=True)
    run([sys.executable, "-m", "venv", "--clear", str(root)])
    pip = [str(python), "-m", "pip", "--disable-pip-version-check"]
    run([*pip, "install", "--quiet", f"{PACKAGE}=={VERSION}"])
    run([str(python), "-c", "import trifinger_simulation"])
    stamp.touch()
    return python


def run(command: Sequence[str]) -> str:
    """What a command of the package's environment prints.

    Raises:
        PackageError: it fails, with the last line that it wrote to stderr, or takes more than an hour.
    """
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PackageError(f"{PACKAGE}: {error}") from error
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise PackageError(f"{PACKAGE}: {lines[-1]}")
    return done.stdout
