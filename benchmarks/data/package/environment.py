"""The platform's own simulation package in a separate environment.

It comes from PyPI with more dependencies than this project should have. A virtual environment is made for it
in the cache, unless the environment variable TRIFINGER_SIMULATION_PYTHON names an interpreter.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.data.plan import CACHE
from tracker.errors import TrackerError

PACKAGE, VERSION = "trifinger-simulation", "2.0.0"
VARIABLE = "TRIFINGER_SIMULATION_PYTHON"
"""Environment variable that names an interpreter able to import the package."""

_SECONDS = 3600


class PackageError(TrackerError):
    """The simulation package is not available, or fails."""


def interpreter(folder: Path = CACHE, *, install: bool = True) -> Path:
    """Return an interpreter that can import the package; `install`: create a missing environment in `folder`.

    Raises:
        PackageError: there is no such interpreter; the message has the reason.
    """
    chosen = os.environ.get(VARIABLE)
    if chosen:
        if not Path(chosen).is_file():
            raise PackageError(f"{VARIABLE}={chosen}: no such file")
        return Path(chosen)
    root = folder.resolve() / f"{PACKAGE}-{VERSION}"
    python, stamp = root / "bin" / "python", root / ".installed"
    # The stamp file is made last, so that an interrupted installation is repeated. The interpreter may still
    # be missing: it is a link to a Python that may have been removed.
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
    """Run a command in the package's environment and return what it prints.

    Raises:
        PackageError: it fails (the message has its last line on stderr), or takes more than an hour.
    """
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PackageError(f"{PACKAGE}: {error}") from error
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise PackageError(f"{PACKAGE}: {lines[-1]}")
    return done.stdout
