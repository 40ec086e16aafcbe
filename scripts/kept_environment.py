"""Make a virtual environment out of one that is kept for all checkouts, which is made if need be.

    python scripts/kept_environment.py FOLDER [ARGUMENT ...]

ARGUMENTs are pip's, and name what to install. The kept environment is named after all that decides what is
in it: these, what pyproject.toml wants where "." is among them, the files that follow `-r`, the interpreter.
It lies in `$XDG_CACHE_HOME/trifinger-object-tracker/environments`. FOLDER gets links to its files, so that it
stays whole whatever becomes of the kept one. The project itself is in neither.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

try:
    import tomllib
except ImportError:  # Python 3.10
    tomllib = None

ROOT = Path(__file__).resolve().parents[1]
PROJECT = "trifinger-object-tracker"
KEPT = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / PROJECT / "environments"
MOST = 8
"""Environments that are kept; of more, those go that were used the longest ago."""


def requirements() -> str:
    """What pyproject.toml requires; the whole file where no parser of it is at hand."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    if tomllib is None:
        return text
    project = tomllib.loads(text)["project"]
    return repr([project[name] for name in ("requires-python", "dependencies", "optional-dependencies")])


def key(arguments: Sequence[str]) -> str:
    """Name of the kept environment of this interpreter that has what pip's arguments ask for."""
    key_parts = [sys.version, os.path.realpath(sys.executable), *arguments]
    key_parts += [requirements() for argument in arguments if argument.startswith(".")]
    files = [Path(name) for flag, name in itertools.pairwise(arguments) if flag == "-r"]
    key_parts += [path.read_text(encoding="utf-8") for path in (Path(__file__), *files)]
    return hashlib.sha256("\0".join(key_parts).encode()).hexdigest()[:16]


@contextlib.contextmanager
def alone(name: str) -> Iterator[None]:
    """Wait until no other process makes the environment of this name."""
    KEPT.mkdir(parents=True, exist_ok=True)
    with (KEPT / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def kept(arguments: Sequence[str]) -> Path:
    """The kept environment that has what pip's arguments ask for."""
    name = key(arguments)
    folder = KEPT / name
    stamp = KEPT / f"{name}.installed"
    with alone(name):
        # The stamp is made last, so that an interrupted installation is done again.
        if not stamp.is_file():
            subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True)
            pip = [str(folder / "bin" / "python"), "-m", "pip", "--disable-pip-version-check"]
            subprocess.run([*pip, "install", "--quiet", *arguments], cwd=ROOT, check=True)
            if any(argument.startswith(".") for argument in arguments):
                subprocess.run([*pip, "uninstall", "--quiet", "--yes", PROJECT], check=True)
        stamp.touch()
    return folder


def forget_the_oldest() -> None:
    """Remove kept environments that were used the longest ago."""
    stamps = sorted(KEPT.glob("*.installed"), key=lambda stamp: stamp.stat().st_mtime)
    for stamp in stamps[:-MOST]:
        stamp.unlink()
        shutil.rmtree(stamp.with_suffix(""), ignore_errors=True)


def link(source: str, target: str) -> None:
    """A second name of a file; a copy where that is on another disk."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def lay(source: Path, target: Path) -> None:
    """Make `target` an environment like `source`, whose scripts run in it."""
    if target.exists():
        shutil.rmtree(target)
    shutil.copytree(source, target, symlinks=True, copy_function=link)
    old, new = os.fsencode(source), os.fsencode(target)
    for path in (target / "pyvenv.cfg", *(target / "bin").iterdir()):
        if path.is_file() and not path.is_symlink() and old in (content := path.read_bytes()):
            mode = path.stat().st_mode
            path.unlink()
            path.write_bytes(content.replace(old, new))
            path.chmod(mode)


def main() -> None:
    """Make the environment that the command line asks for."""
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    folder, *arguments = sys.argv[1:]
    lay(kept(arguments), Path(folder).absolute())
    forget_the_oldest()


if __name__ == "__main__":
    main()
