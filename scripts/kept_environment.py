"""Make a virtual environment from a cached one that all checkouts share; create the cached one if missing.

    python scripts/kept_environment.py FOLDER [ARGUMENT ...]

ARGUMENTs are passed to pip and name what to install. The cached environment is named by a hash of all that
determines its contents: these arguments, pyproject.toml's requirements if "." is among them, the files after
`-r`, and the interpreter. It is in `$XDG_CACHE_HOME/trifinger-object-tracker/environments`. FOLDER gets links
to its files, so that it stays complete whatever happens to the cached one. The project itself is in neither.
"""

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
"""Number of cached environments; beyond it, the least recently used ones are removed."""


def requirements() -> str:
    """Return pyproject.toml's requirements; without a TOML parser, the whole file."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    if tomllib is None:
        return text
    project = tomllib.loads(text)["project"]
    return repr([project[name] for name in ("requires-python", "dependencies", "optional-dependencies")])


def key(arguments: Sequence[str]) -> str:
    """Return the name of this interpreter's cached environment for pip's arguments."""
    key_parts = [sys.version, os.path.realpath(sys.executable), *arguments]
    key_parts += [requirements() for argument in arguments if argument.startswith(".")]
    files = [Path(name) for flag, name in itertools.pairwise(arguments) if flag == "-r"]
    key_parts += [path.read_text(encoding="utf-8") for path in (Path(__file__), *files)]
    return hashlib.sha256("\0".join(key_parts).encode()).hexdigest()[:16]


@contextlib.contextmanager
def alone(name: str) -> Iterator[None]:
    """Lock the environment of this name against other processes that make it."""
    KEPT.mkdir(parents=True, exist_ok=True)
    with (KEPT / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def kept(arguments: Sequence[str]) -> Path:
    """Return the cached environment for pip's arguments; create it if missing."""
    name = key(arguments)
    folder = KEPT / name
    stamp = KEPT / f"{name}.installed"
    with alone(name):
        # The stamp is made last, so that an interrupted installation is repeated.
        if not stamp.is_file():
            subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True)
            pip = [str(folder / "bin" / "python"), "-m", "pip", "--disable-pip-version-check"]
            subprocess.run([*pip, "install", "--quiet", *arguments], cwd=ROOT, check=True)
            if any(argument.startswith(".") for argument in arguments):
                subprocess.run([*pip, "uninstall", "--quiet", "--yes", PROJECT], check=True)
        stamp.touch()
    return folder


def forget_the_oldest() -> None:
    """Remove the least recently used cached environments."""
    stamps = sorted(KEPT.glob("*.installed"), key=lambda stamp: stamp.stat().st_mtime)
    for stamp in stamps[:-MOST]:
        stamp.unlink()
        shutil.rmtree(stamp.with_suffix(""), ignore_errors=True)


def link(source: str, target: str) -> None:
    """Hard-link a file, or copy it if the target is on another disk."""
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
    """Make the environment that the command line requests."""
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    folder, *arguments = sys.argv[1:]
    lay(kept(arguments), Path(folder).absolute())
    forget_the_oldest()


if __name__ == "__main__":
    main()
