"""What is published of a moment by LCM: the type `lcmt_object_state` of the package `dairlib`."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

import numpy as np

from tracker.errors import LiveError
from tracker.live.moment import Moment
from tracker.objects.model import CuboidModel

FINGERPRINT = 0x2D41F07A9260F694
"""Of the type's layout, as LCM derives it from names, types and dimensions of its fields; every message
begins with it."""

POSITIONS = ("qw", "qx", "qy", "qz", "x", "y", "z")
VELOCITIES = ("wx", "wy", "wz", "vx", "vy", "vz")
"""What the numbers are called, after the body's name."""

_BODY = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")  # LCM takes channels of up to 63 characters


def body_of(model: CuboidModel, name: str | None = None) -> str:
    """What messages call the object: a name that is wanted, else `cube`, or `cuboid` where edges differ.

    Raises:
        LiveError: the name has other characters than letters, digits and _, or more than 40.
    """
    if name is None:
        return "cube" if np.allclose(model.size, model.size[0]) else "cuboid"
    if not _BODY.fullmatch(name):
        raise LiveError(f"body: found {name!r}, expected a letter, then letters, digits and _, 40 at most")
    return name


def channel_of(body: str) -> str:
    """Where messages of a body are published, such as `CUBE_STATE`."""
    return f"{body.upper()}_STATE"


def lcm_message_of(moment: Moment, object_name: str, body: str) -> bytes | None:
    """The filtered pose of the newest images; None where the object is lost, which the type cannot say.

    `utime` is the exposure of the latest image [µs], on the clock of the source's stamps, of cameras the
    epoch's. Positions are a quaternion, w first, and the centre [m], of the object in the world; velocities
    the rotation's [rad/s] and the centre's [m/s], both along world axes.
    """
    pose = moment.filtered_object_pose
    if pose is None:
        return None
    x, y, z, w = pose.orientation
    return b"".join(
        [
            struct.pack(">Qq", FINGERPRINT, round(1e6 * moment.timestamp)),
            _text(object_name),
            struct.pack(">ii", len(POSITIONS), len(VELOCITIES)),
            _named(body, POSITIONS, (w, x, y, z, *pose.position)),
            _named(body, VELOCITIES, (*pose.velocity[3:], *pose.velocity[:3])),
        ]
    )


def _named(body: str, names: Sequence[str], values: Sequence[float]) -> bytes:
    """Names, then numbers."""
    texts = [_text(f"{body}_{name}") for name in names]
    return b"".join([*texts, struct.pack(f">{len(names)}d", *values)])


def _text(text: str) -> bytes:
    content = text.encode() + b"\0"
    return struct.pack(">I", len(content)) + content
