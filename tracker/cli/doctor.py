"""`tracker doctor`: what of this machine the tracker needs, what it lacks, and the remedy."""

from __future__ import annotations

import ctypes.util
import os
import platform
import re
import time
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import click

from tracker.errors import install
from tracker.version import version

NAME = "trifinger-object-tracker"
CORE = ("numpy", "scipy", "opencv-python-headless", "numba", "h5py")
REFERENCE_ROUNDS = 20
DETECTION = 1.5
"""Time of a detection over that of the reference work, about."""

_EXTRA = re.compile(r"""extra *== *['"](?P<extra>[\w-]+)['"]""")
_PACKAGE = re.compile(r"[\w.-]+")


class Finding(NamedTuple):
    """What was found of one thing."""

    what: str
    good: bool
    found: str
    remedy: str = ""


@click.command(short_help="Tell what of this machine is amiss, and the remedy.")
def doctor() -> None:
    """Look at this machine: versions, compiled code, OpenGL, extras, speed; what is amiss has its remedy.

    The exit code is 1 where something keeps the tracker from working.
    """
    worst = 0
    for group, findings in (("", _needed()), ("if you want it", _optional())):
        if group:
            click.echo(f"\n{group}:")
        for finding in findings:
            mark = "ok" if finding.good else ("--" if group else "!!")
            click.echo(f"{mark}  {finding.what:12} {finding.found}")
            if finding.remedy:
                click.echo(f"{'':17}{finding.remedy}")
            if not group and not finding.good:
                worst = 1
    raise click.exceptions.Exit(worst)


def _needed() -> Iterator[Finding]:
    yield Finding("tracker", True, f"{version()}, {Path(__file__).parents[1]}")
    yield Finding("Python", True, f"{platform.python_version()}, {platform.platform(terse=True)}")
    for name in CORE:
        found = _version(name)
        if name.startswith("opencv"):
            yield _opencv()
        elif found is None:
            yield Finding(name, False, "not installed", f"python3 -m pip install {name}")
        else:
            yield Finding(name, True, found)
    yield _cache()
    yield _speed()


def _optional() -> Iterator[Finding]:
    libraries = [name for name in ("EGL", "GL") if ctypes.util.find_library(name) is None]
    remedy = "apt-get install libegl1 libgl1; without it synthetic pictures are drawn by a slower renderer"
    found = f"no lib{', lib'.join(libraries)}" if libraries else "libEGL, libGL"
    yield Finding("OpenGL", not libraries, found, remedy if libraries else "")
    for extra, packages in sorted(_extras().items()):
        missing = [name for name in packages if _version(name) is None]
        found = f"without {', '.join(missing)}" if missing else ", ".join(packages)
        yield Finding(extra, not missing, found, install(extra) if missing else "")


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _opencv() -> Finding:
    """Two OpenCVs write into one folder: whichever came last is imported, in part."""
    names = {(dist.metadata["Name"] or "").lower() for dist in metadata.distributions()}
    found = sorted(name for name in names if re.fullmatch(r"opencv[-_](contrib[-_])?python.*", name))
    said = ", ".join(f"{name} {_version(name)}" for name in found)
    if not found:
        return Finding("OpenCV", False, "not installed", "python3 -m pip install opencv-python-headless")
    if len(found) > 1:
        remedy = f"python3 -m pip uninstall {' '.join(found)}; python3 -m pip install opencv-python-headless"
        return Finding("OpenCV", False, f"{len(found)} in one folder: {said}", remedy)
    return Finding("OpenCV", True, said)


def _cache() -> Finding:
    """Where compiled code is kept; NUMBA_CACHE_DIR says where instead."""
    from tracker.pose.solve.refine import settle
    from tracker.warm_up import kernels_are_cached

    folder = getattr(settle.stats, "cache_path", None)
    if folder is None or not os.access(folder, os.W_OK):
        remedy = "every process compiles for half a minute: set NUMBA_CACHE_DIR to a folder of your own"
        return Finding("cache", False, f"{folder or 'no folder'} cannot be written", remedy)
    compiled = "compiled" if kernels_are_cached() else "not compiled yet, which will take half a minute"
    return Finding("cache", True, f"{folder}: {compiled}")


def _speed() -> Finding:
    """Time of reference work on three pictures, of which a detection takes a known multiple."""
    import cv2
    import numpy as np

    noise = np.random.default_rng(0).integers(0, 256, (270, 270, 3), dtype=np.uint8)
    times = []
    for _ in range(REFERENCE_ROUNDS):
        start = time.perf_counter()
        for _ in range(3):
            cv2.cvtColor(cv2.medianBlur(noise, 5), cv2.COLOR_BGR2HSV)
        times.append(time.perf_counter() - start)
    took = 1e3 * sorted(times)[len(times) // 2]
    said = f"reference work {took:.1f} ms, so a detection about {DETECTION * took:.1f} ms"
    return Finding("speed", True, f"{os.cpu_count()} cores; {said}")


def _extras() -> dict[str, list[str]]:
    """Packages of each extra, without those for development."""
    extras: dict[str, list[str]] = {}
    try:
        requirements = metadata.requires(NAME) or []
    except metadata.PackageNotFoundError:
        return {}
    for requirement in requirements:
        package, extra = _PACKAGE.match(requirement), _EXTRA.search(requirement)
        if package and extra and extra["extra"] not in ("all", "dev", "docs") and package[0] != NAME:
            extras.setdefault(extra["extra"], []).append(package[0])
    return extras
