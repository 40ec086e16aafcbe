"""`tracker live --check`: a look at the cameras before anything is tracked."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from tracker.cli.table import table

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.live import Source
    from tracker.live.camera_check import SetLooks

SECONDS = 10.0
"""How long it is looked for, unless --seconds says otherwise."""


def check_cameras(source: Source, rig: CameraRig, seconds: float | None) -> None:
    """Print what was seen and what is wrong; exits with 1 where anything is."""
    from tracker.live.camera_check import look_at

    looks = look_at(source, rig, seconds or SECONDS)
    click.echo(_table(looks))
    click.echo()
    faults = looks.faults()
    click.echo("\n".join(faults) if faults else "nothing is wrong with the cameras")
    if faults:
        sys.exit(1)


def _table(looks: SetLooks) -> str:
    rows = [["camera", "pictures", "missing", "late [ms]", "grey level", "clipped [%]", "blur [px]"]]
    for one in looks.cameras:
        level, clipped, blur = one.look
        numbers = [f"{1e3 * one.skew:.1f}", f"{level:.0f}", f"{100 * clipped:.1f}", f"{blur:.2f}"]
        rows.append([one.name, str(one.pictures), str(sum(one.missing.values())), *numbers])
    return f"{looks.sets} sets in {looks.seconds:.1f} s, {looks.rate:.1f} Hz\n{table(rows)}"
