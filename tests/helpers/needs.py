"""What a test may need that not every machine has, and what happens where it is missing.

A test that misses something is skipped with a reason "KIND: why", where KIND is one of KINDS. The
environment variable REQUIRE lists the kinds, with commas between them, that a run has to have: a skip of
such a kind is a failure. So is a skip for a reason of no kind.
"""

import os
from collections.abc import Iterator
from typing import Any, NoReturn

import pytest

VARIABLE = "REQUIRE"

KINDS = {
    "real": "recorded data of real platforms",
    "platform": "the simulated platform: the extra `synthetic`, the robot's meshes, a renderer",
    "package": "the platform's own simulation package, in an environment of its own",
    "rerun": "the extra `rerun`",
    "plot": "the extra `plot`",
    "video": "the extra `video`",
    "gymnasium": "the package `gymnasium`",
    "pylon": "the extra `pylon`",
    "live": "the extra `live`",
    "lcm": "the extra `lcm`",
    "datasets": "the extra `datasets`",
    "cluster": "the extra `cluster`",
    "htcondor": "HTCondor's Python binding",
    "slurm": "a Slurm of one machine",
    "bench": "the extra `bench`",
    "xarray": "the package `xarray`",
    "zarr": "a zarr that writes the data sets' stores",
    "docs": "the extra `docs`",
    "multicast": "a network that carries multicast",
    "system": "files and figures that only some operating systems have",
}
"""Each kind of need, and what meets it."""


def lack(kind: str, why: str) -> NoReturn:
    """Skip the test, or the module, that misses something of a kind."""
    pytest.skip(f"{kind}: {why}", allow_module_level=True)


def required() -> frozenset[str]:
    """The kinds that this run has to have.

    Raises:
        pytest.UsageError: REQUIRE names one that is none.
    """
    kinds = frozenset(filter(None, map(str.strip, os.environ.get(VARIABLE, "").split(","))))
    unknown = sorted(kinds - set(KINDS))
    if unknown:
        raise pytest.UsageError(f"{VARIABLE}: no kind {', '.join(unknown)}; there are {', '.join(KINDS)}")
    return kinds


def pytest_configure() -> None:
    required()


def _settle(report: Any) -> None:
    """Make a failure of a skip that is not allowed."""
    if not report.skipped or hasattr(report, "wasxfail"):
        return
    reason = report.longrepr[2].removeprefix("Skipped: ")
    kind = reason.partition(":")[0]
    if kind not in KINDS:
        problem = f"a skip needs a reason of a kind ({', '.join(KINDS)})"
    elif kind in required():
        problem = f"{VARIABLE} asks for {kind}, {KINDS[kind]}"
    else:
        return
    report.outcome, report.longrepr = "failed", f"{report.nodeid}: skipped because {reason}, but {problem}"


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_makereport() -> Iterator[None]:
    _settle((yield).get_result())


pytest_make_collect_report = pytest_runtest_makereport
