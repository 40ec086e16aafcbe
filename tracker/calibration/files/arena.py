"""The arena beside the camera files: one TOML file, `arena.toml`.

    center = [0.0, 0.0]         # of the arena in the world, x and y [m]
    radius = 0.235              # within which the object's centre is [m]
    height = 0.185              # up to which it is, above the table [m]
    table = 0.0                 # z of the table in the world [m], or "none"
    table_std = [0.008, 0.017]  # how well height [m] and tilt [rad] of the table are known

A key that is left out has the value shown, which is that of `geometry.arena.Arena`.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from tracker.checks import naming
from tracker.errors import CalibrationError
from tracker.files import told_as, write_whole
from tracker.files.toml import read_toml
from tracker.geometry.arena import Arena

FILE_NAME = "arena.toml"
"""Name of the file in the folder of the camera files."""

NO_TABLE = "none"

_KEYS = tuple(field.name for field in dataclasses.fields(Arena))
_TITLE = "# Where the object may be and where the table is, in the cameras' world [m, rad].\n"


def read_arena(folder: Path) -> Arena:
    """The arena of a folder's file, or the default; CalibrationError: it cannot be read or is malformed."""
    path = folder / FILE_NAME
    if not path.exists():
        return Arena()
    values = read_toml(path, CalibrationError, _KEYS)
    if values.get("table") == NO_TABLE:
        values["table"] = None
    with naming(path, CalibrationError):
        return Arena(**values)


def write_arena(arena: Arena, folder: Path) -> None:
    """Write the file that `read_arena` reads; for the default arena there is none, one of old is removed.

    CalibrationError: the file cannot be written or removed.
    """
    path = folder / FILE_NAME
    values = dataclasses.asdict(arena)
    if arena.table is None:
        values["table"] = NO_TABLE
    # JSON's texts, numbers and lists of them are TOML's, too.
    text = _TITLE + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
    with told_as(CalibrationError, path):
        if arena == Arena():
            path.unlink(missing_ok=True)
        else:
            write_whole(path, text)
