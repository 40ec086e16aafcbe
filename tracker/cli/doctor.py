"""`tracker doctor`: check whether this machine has what the tracker needs, and suggest remedies."""

import functools
import importlib
import os
import platform
import re
import statistics
import timeit
from collections.abc import Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import click

from tracker.errors import install, message
from tracker.version import version

NAME = "trifinger-object-tracker"
OPENCV = "opencv-python-headless"
CORE = {
    "numpy": "numpy",
    "scipy": "scipy",
    OPENCV: "cv2",
    "numba": "numba",
    "h5py": "h5py",
    "Pillow": "PIL.Image",
    "PyYAML": "yaml",
    "tqdm": "tqdm",
}
"""Required packages, and the modules to import."""

DETECTION = 1.5  # approximate time of a detection, relative to that of the reference work

_PACKAGE_OF_EXTRA = re.compile(r"""([\w.-]+).*?extra *== *['"]([\w-]+)['"]""")


class Finding(NamedTuple):
    """The result of one check."""

    what: str
    found: str
    remedy: str = ""
    """Empty if all is well."""


@click.command()
def doctor() -> None:
    """Check this machine: versions, compiled code, extras, speed.

    Each problem comes with a remedy. The exit code is 1 if the tracker cannot work.
    """
    lacking = [_print(finding, "!!") for finding in _needed()]
    click.echo("\noptional:")
    for extra, packages in sorted(_extras().items()):
        if missing := [name for name in packages if _version(name) is None]:
            _print(Finding(extra, f"without {', '.join(missing)}", install(extra)), "--")
        else:
            _print(Finding(extra, ", ".join(packages)), "--")
    raise click.exceptions.Exit(any(lacking))


def _print(finding: Finding, mark: str) -> bool:
    """Print a finding, with `mark` if it has a remedy; return whether it has one."""
    click.echo(f"{mark if finding.remedy else 'ok'}  {finding.what:12} {finding.found}")
    if finding.remedy:
        click.echo(f"{'':17}{finding.remedy}")
    return bool(finding.remedy)


def _needed() -> Iterator[Finding]:
    yield Finding("tracker", f"{version()}, {Path(__file__).parents[1]}")
    yield Finding("Python", f"{platform.python_version()}, {platform.platform(terse=True)}")
    for name, module in CORE.items():
        yield _package(name, module)
    if all(_fault_of_module(module) is None for module in CORE.values()):
        yield _cache()
        yield _speed()


def _package(name: str, module: str) -> Finding:
    """Check a package. OpenCV's packages share a folder: the last one installed partly replaces others."""
    if name == OPENCV:
        names = {(dist.metadata["Name"] or "").lower() for dist in metadata.distributions()}
        found = sorted(one for one in names if re.fullmatch(r"opencv[-_](contrib[-_])?python.*", one))
        what = "OpenCV"
    else:
        what, found = name, [] if _version(name) is None else [name]
    shown = ", ".join(f"{one} {_version(one)}" for one in found)
    again = f"python3 -m pip install {name}"
    if not found:
        return Finding(what, "not installed", again)
    again = f"python3 -m pip uninstall -y {' '.join(found)}; {again}"
    if (fault := _fault_of_module(module)) is not None:
        return Finding(what, f"{shown} does not load: {fault}", again)
    if len(found) > 1:
        return Finding(what, f"{len(found)} in one folder: {shown}", again)
    return Finding(what, shown.removeprefix(f"{what} "))


@functools.cache
def _fault_of_module(name: str) -> str | None:
    """Return why a module cannot be imported, or None; a broken module may raise any error."""
    try:
        module = importlib.import_module(name)
    except Exception as error:
        return message(error)
    # If one of two packages that share a folder was removed, the remaining folder imports without error.
    return None if module.__file__ else "only the folder is left"


def _version(name: str) -> str | None:
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(name)
    return None


def _cache() -> Finding:
    """Check the cache of compiled code; NUMBA_CACHE_DIR overrides its location."""
    from tracker.warm_up import kernel_folder, kernels_are_cached

    cached, folder = kernels_are_cached(), kernel_folder()
    asked = os.environ.get("NUMBA_CACHE_DIR")
    if folder is None or not (cached or os.access(folder, os.W_OK)):
        places = f"neither NUMBA_CACHE_DIR={asked}" if asked else "neither the folder of the tracker"
        remedy = "export NUMBA_CACHE_DIR=DIR, a permanent folder that you can write to"
        shown = f"{places} nor ~/.cache/numba can be written: every process compiles for half a minute"
        return Finding("cache", shown, remedy)
    compiled = "compiled" if cached else "not compiled yet; the first run takes half a minute longer"
    only = "" if os.access(folder, os.W_OK) else ", which can only be read"
    return Finding("cache", f"{folder}{only}: {compiled}")


def _speed() -> Finding:
    """Measure reference work on three images; a detection takes a known multiple of its time."""
    import cv2
    import numpy as np

    noise = np.random.default_rng(0).integers(0, 256, (270, 270, 3), dtype=np.uint8)

    def work() -> None:
        cv2.cvtColor(cv2.medianBlur(noise, 5), cv2.COLOR_BGR2HSV)

    took = 1e3 * statistics.median(timeit.repeat(work, number=3, repeat=20))
    shown = f"reference work {took:.1f} ms, so a detection about {DETECTION * took:.1f} ms"
    return Finding("speed", f"{os.cpu_count()} cores; {shown}")


def _extras() -> dict[str, list[str]]:
    """Return the packages in each extra, except those for development."""
    extras: dict[str, list[str]] = {}
    with suppress(metadata.PackageNotFoundError):
        for requirement in filter(None, map(_PACKAGE_OF_EXTRA.match, metadata.requires(NAME) or [])):
            package, extra = requirement.groups()
            if extra not in ("all", "dev", "docs") and package != NAME:
                extras.setdefault(extra, []).append(package)
    return extras
