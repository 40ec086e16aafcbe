"""Poses for other processes: by ZeroMQ (the extra `live`), one JSON object a message; and by LCM (`lcm`)."""

from __future__ import annotations

import json
import os
import re
import stat
import struct
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from tracker.checks import optional
from tracker.errors import LiveError
from tracker.live.moment import Moment
from tracker.objects.model import CuboidModel

VERSION = 3
"""Of the message; it grows when a field changes its meaning or goes, not when one is added."""

_FORMS = "tcp://127.0.0.1:PORT, ipc://PATH"
_ADDRESS = re.compile(r"tcp://(?P<host>.+):(?P<port>\d{1,5}|\*)|(ipc|inproc)://.+")
_LOCAL = re.compile(r"127(\.\d{1,3}){3}|localhost|\[::1\]")


def message_of(moment: Moment) -> bytes:
    """The message, UTF-8: the filtered pose of the newest images, or null where the object is lost.

    `timestamp` [s]; `pose` as of `detect --json`, `velocity` (6) [m/s, rad/s] along world axes; the others as
    of Moment. The counts tell a subscriber of sets that it never fetched.
    """
    pose = moment.filtered_object_pose
    content: dict[str, Any] = {
        "version": VERSION,
        "sequence": moment.sequence,
        "timestamp": moment.timestamp,
        "status": moment.status.value,
        "pose": None if pose is None else pose.as_json(),
        "velocity": None if pose is None else pose.velocity.tolist(),
        "latency_ms": 1e3 * moment.latency,
        "faults": dict(moment.faults),
        "jump": moment.jump,
        "fault_counts": dict(moment.fault_counts),
        "jump_count": moment.jump_count,
    }
    return json.dumps(content, allow_nan=False).encode()


class ZmqPublisher:
    """Publishes each moment; a listener of `Live`.

    A subscriber gets the newest message only: what it does not fetch is replaced, and one that hangs holds
    up nobody. Nothing is ever received.

    Args:
        address: e.g. `tcp://127.0.0.1:5555`.
        public: whether other machines may connect. Anyone who can reach the address sees the poses.

    Raises:
        LiveError: pyzmq is not installed, the address is not this machine's own, cannot be bound, or names a
            file that is no socket.
    """

    def __init__(self, address: str, *, public: bool = False) -> None:
        found = _ADDRESS.fullmatch(address)
        # ZeroMQ takes a port that is too large for another that is not.
        if not found or ((found["port"] or "*") != "*" and int(found["port"]) > 65535):
            raise LiveError(f"publish: found {address}, expected {_FORMS}, lcm://, udpm:// or file://")
        if not (public or found["host"] is None or _LOCAL.fullmatch(found["host"])):
            raise LiveError(
                f"publish {address}: other machines could connect to it; expected {_FORMS}, or public=True "
                "(--public)"
            )
        zmq = optional("zmq", "live", f"publish {address}", LiveError)
        _refuse_file(address)
        self._zmq = zmq
        self._socket: Any = zmq.Context.instance().socket(zmq.PUB)
        self._socket.setsockopt(zmq.CONFLATE, 1)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.IPV6, "[" in address)
        try:
            self._socket.bind(address)
        except zmq.ZMQError as error:
            self._socket.close()
            raise LiveError(f"publish {address}: {error}") from error
        self.address: str = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        """Where subscribers connect; with the port that was chosen for `*`."""
        self.fault: str | None = None
        """As of `LcmPublisher`; here nothing is left unsent but what nobody fetched."""

    def __call__(self, moment: Moment) -> None:
        """Publish a moment."""
        self._socket.send(message_of(moment), self._zmq.NOBLOCK)

    def close(self) -> None:
        """Free the address; nobody may be in a call."""
        self._socket.close()


def _refuse_file(address: str) -> None:
    """Refuse a path where something other than a socket is: ZeroMQ would remove it."""
    kind, _, path = address.partition("://")
    if kind != "ipc" or path.startswith("@") or path == "*":  # an abstract name, or one that ZeroMQ chooses
        return
    try:
        there = stat.S_ISSOCK(Path(path).lstat().st_mode)
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        raise LiveError(f"publish {address}: {error}") from error
    if not there:
        raise LiveError(f"publish {address}: found something other than a socket there, expected a new path")


FINGERPRINT = 0x2D41F07A9260F694
"""Of the type's layout, as LCM derives it from names, types and dimensions of its fields; every message
begins with it."""

POSITIONS = ("qw", "qx", "qy", "qz", "x", "y", "z")
VELOCITIES = ("wx", "wy", "wz", "vx", "vy", "vz")
"""What the numbers are called, after the body's name."""

_BODY = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")  # LCM takes channels of up to 63 characters

DEFAULT = "udpm://239.255.76.67:7667?ttl=0"
"""LCM's own; a time to live of 0 keeps messages on this machine."""

_VARIABLE = "LCM_DEFAULT_URL"
_LCM_FORMS = (
    "lcm://, udpm://ADDRESS:PORT?ttl=0 with a group from 224.0.0.0 on and a ttl up to 255, or file://PATH"
)
_NEW = "?mode=w"
_LCM_PORT = 7667
_HEADER = 28
"""Of each event of a log, before channel and message [bytes]."""
_ROUTE = "ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo"


def body_of(model: CuboidModel, name: str | None = None) -> str:
    """What messages call the object: the given name, else `cube`, or `cuboid` where edges differ.

    Raises:
        LiveError: the name has other characters than letters, digits and _, or more than 40.
    """
    if name is None:
        return "cube" if np.allclose(model.size, model.size[0]) else "cuboid"
    if not _BODY.fullmatch(name):
        raise LiveError(f"body: found {name!r}, expected a letter, then letters, digits and _, 40 at most")
    return name


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
    positions = w, x, y, z, *pose.position
    velocities = *pose.velocity[3:], *pose.velocity[:3]
    content = struct.pack(">Qq", FINGERPRINT, round(1e6 * moment.timestamp)) + _text(object_name)
    content += struct.pack(">ii", len(POSITIONS), len(VELOCITIES))
    for names, values in ((POSITIONS, positions), (VELOCITIES, velocities)):
        content += b"".join(_text(f"{body}_{name}") for name in names)
        content += struct.pack(f">{len(names)}d", *values)
    return content


def _text(text: str) -> bytes:
    content = text.encode() + b"\0"
    return struct.pack(">I", len(content)) + content


class LcmPublisher:
    """Publishes the pose of each moment as `lcmt_object_state`; a listener of `Live`.

    The channel is the body's name with `_STATE`. Where the object is lost nothing is published. Nothing is
    ever received, and what cannot be sent is counted and forgotten.

    Args:
        address: `lcm://`, which is LCM's own default or what LCM_DEFAULT_URL says; `udpm://ADDRESS:PORT`, a
            multicast group; `file://PATH`, a log of LCM that does not exist yet.
        model: the object.
        body: what messages call it; None: see `body_of`.
        public: whether other machines may receive it, as a time to live of 1 or more has it.

    Raises:
        LiveError: the package is not installed, the address is none or reaches other machines, or LCM
            cannot be set up there.
    """

    def __init__(
        self, address: str, model: CuboidModel, *, body: str | None = None, public: bool = False
    ) -> None:
        self.address = _url(address, public)
        """In LCM's words."""
        self._name, self._body = model.name, body_of(model, body)
        self.channel = f"{self._body.upper()}_STATE"
        self._unsent, self._refused = 0, ""
        kind, _, rest = self.address.partition("://")
        self._log = Path(rest.removesuffix(_NEW)) if kind == "file" else None
        self._logged = 0
        lcm = optional("lcm", "lcm", f"publish {address}", LiveError)
        try:
            self._lcm: Any = lcm.LCM(self.address)
        except RuntimeError as error:
            route = f"; without a network it needs a route: {_ROUTE}"
            raise LiveError(
                f"publish {address}: LCM cannot be set up for {self.address}"
                + ("" if self.address.startswith("file:") else route)
            ) from error

    def __call__(self, moment: Moment) -> None:
        """Publish a moment."""
        message = lcm_message_of(moment, self._name, self._body)
        if message is None:
            return
        try:
            self._lcm.publish(self.channel, message)
        except OSError as error:  # of this moment; a network comes back
            self._unsent, self._refused = self._unsent + 1, str(error)
        self._logged += _HEADER + len(self.channel) + len(message)

    def close(self) -> None:
        """Free the address; nobody may be in a call."""
        self._lcm = None

    @property
    def fault(self) -> str | None:
        """What a log lacks: LCM says nothing of a disk that is full. Or how many messages were not sent."""
        where = f"publish {self.address}:"
        if self._log is not None:
            try:
                found = self._log.stat()
            except OSError as error:
                return f"{where} the log is gone: {error.strerror}"
            lacks = self._logged - found.st_size
            # Before it is closed, the last of it waits in memory.
            if lacks > (0 if self._lcm is None else 2 * found.st_blksize):
                return f"{where} the log lacks {lacks} bytes, is the disk full?"
        if self._unsent:
            return f"{where} {self._unsent} messages were not sent; last: {self._refused}"
        return None


def _url(address: str, public: bool) -> str:
    """The address in LCM's words, put together from checked parts: LCM reads nothing else."""
    kind, _, rest = address.partition("://")
    if address == "lcm://":
        address = os.environ.get(_VARIABLE) or DEFAULT
        if address.startswith("lcm:"):
            raise LiveError(f"publish: {_VARIABLE}: found {address}, expected udpm://ADDRESS:PORT?ttl=0")
    elif kind == "file" and rest and "?" not in rest:
        path = Path(rest)
        if path.exists() or not path.parent.is_dir():
            raise LiveError(f"publish {address}: expected a new file, in a folder that there is")
        return f"file://{rest}{_NEW}"
    try:
        found = urlsplit(address)
        group, port = IPv4Address(found.hostname or ""), _LCM_PORT if found.port is None else found.port
        options = parse_qsl(found.query, strict_parsing=bool(found.query))
        # How much may wait for who receives is nothing to who sends.
        given = {key: int(value) for key, value in options if key != "recv_buf_size"}
        hops = given.pop("ttl", 0)
        valid = (found.scheme, found.path, given) == ("udpm", "", {}) and len(options) == len(dict(options))
        valid &= group.is_multicast and port > 0 and 0 <= hops < 256
    except ValueError:
        valid = False
    if not valid:
        raise LiveError(f"publish: found {address}, expected {_LCM_FORMS}")
    if hops and not public:
        raise LiveError(
            f"publish {address}: other machines could receive it; expected ttl=0, or public=True (--public)"
        )
    return f"udpm://{group}:{port}?ttl={hops}"


Publisher = ZmqPublisher | LcmPublisher


def is_lcm(address: str) -> bool:
    """Whether LCM is to publish there, not ZeroMQ."""
    return address.partition("://")[0] in ("lcm", "udpm", "file")


def open_publisher(
    address: str, model: CuboidModel, *, body: str | None = None, public: bool = False
) -> Publisher:
    """What publishes at an address such as `tcp://127.0.0.1:5555` or `lcm://`; see the two publishers."""
    if is_lcm(address):
        return LcmPublisher(address, model, body=body, public=public)
    return ZmqPublisher(address, public=public)
