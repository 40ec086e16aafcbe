"""Publish poses to other processes by ZeroMQ (extra `live`), one JSON object per message, or LCM (`lcm`)."""

import errno
import json
import os
import re
import socket
import stat
import struct
from contextlib import suppress
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from tracker.checks import naming, of_kind, optional, path_of
from tracker.errors import LiveError
from tracker.files import on_error
from tracker.live.moment import Moment
from tracker.objects.model import CuboidModel

VERSION = 3
"""Version of the message; increased when a field is removed or changes its meaning, not when one is added."""

_FORMS = "tcp://127.0.0.1:PORT, ipc://PATH"
_ADDRESS = re.compile(r"tcp://(?P<host>.+):(?P<port>\d{1,5}|\*)|(ipc|inproc)://.+")
_LOCAL = re.compile(r"127(\.\d{1,3}){3}|localhost|\[::1\]")


def message_of(moment: Moment) -> bytes:
    """Return the message in UTF-8: the filtered pose of the newest images, or null if the object is lost.

    `timestamp` [s]; `pose` as in `detect --json`; `velocity` (6) [m/s, rad/s] along world axes; other fields
    as in Moment. The counts tell subscribers about sets that they never fetched.
    """
    pose = moment.filtered_object_pose
    content = {
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
    """Publishes each moment by ZeroMQ; a listener of `Live`.

    Subscribers get only the newest message: a newer one replaces what was not fetched, so a subscriber that
    hangs delays no one. Nothing is ever received.

    Args:
        address: e.g. `tcp://127.0.0.1:5555`.
        public: whether other machines may connect. Anyone who can reach the address sees the poses.

    Raises:
        LiveError: pyzmq is not installed, the address is not local to this machine, cannot be bound, or names
            a file that is not a socket.
    """

    def __init__(self, address: str, *, public: bool = False) -> None:
        found = _ADDRESS.fullmatch(of_kind(address, str, "publish: address", LiveError))
        # ZeroMQ maps a port that is too large to another port.
        if not found or ((found["port"] or "*") != "*" and int(found["port"]) > 65535):
            raise LiveError(f"publish: found {address}, expected {_FORMS}, lcm://, udpm:// or file://")
        if not (public or found["host"] is None or _LOCAL.fullmatch(found["host"])):
            raise LiveError(
                f"publish {address}: other machines could connect to it; expected {_FORMS}, or public=True "
                "(--public)"
            )
        self._zmq = zmq = optional("zmq", "live", f"publish {address}", LiveError)
        _refuse_file(address)
        self._socket: Any = zmq.Context.instance().socket(zmq.PUB)
        for option, value in ((zmq.CONFLATE, 1), (zmq.LINGER, 0), (zmq.IPV6, "[" in address)):
            self._socket.setsockopt(option, value)
        with on_error(self._socket.close), naming(f"publish {address}", LiveError, zmq.ZMQError):
            self._socket.bind(address)
        self.address: str = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        """Address for subscribers, with the port that was chosen for `*`."""
        self.fault: str | None = None  # always: only messages that were never fetched are dropped

    def __call__(self, moment: Moment) -> None:
        """Publish a moment."""
        self._socket.send(message_of(moment), self._zmq.NOBLOCK)

    def close(self) -> None:
        """Release the address; must not run during a call."""
        self._socket.close()


def _refuse_file(address: str) -> None:
    """Raise LiveError if the path holds no socket, or one in use: ZeroMQ would remove it."""
    kind, _, path = address.partition("://")
    if kind != "ipc" or path.startswith("@") or path == "*":  # an abstract name, or one that ZeroMQ chooses
        return
    with naming(f"publish {address}", LiveError, OSError, ValueError), suppress(FileNotFoundError):
        if not stat.S_ISSOCK(Path(path).lstat().st_mode):
            raise LiveError(
                f"publish {address}: found something other than a socket there, expected a new path"
            )
        with socket.socket(socket.AF_UNIX) as other:
            other.setblocking(False)  # a busy program would not answer
            if other.connect_ex(path) != errno.ECONNREFUSED:  # the error of one that a dead program left
                raise LiveError(f"publish {address}: found a program that listens there, expected a new path")


FINGERPRINT = 0x2D41F07A9260F694
"""LCM's hash of the type, derived from names, types and dimensions of its fields; every message begins with
it."""

POSITIONS = ("qw", "qx", "qy", "qz", "x", "y", "z")
VELOCITIES = ("wx", "wy", "wz", "vx", "vy", "vz")
"""Suffixes of the numbers' names, which begin with the body's name."""

_BODY = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")  # LCM's channel names have up to 63 characters

DEFAULT = "udpm://239.255.76.67:7667?ttl=0"
"""LCM's default address; a time to live of 0 keeps messages on this machine."""

_VARIABLE = "LCM_DEFAULT_URL"
_LCM_FORMS = (
    "lcm://, udpm://ADDRESS:PORT?ttl=0 with a group from 224.0.0.0 on and a ttl up to 255, or file://PATH"
)
_NEW = "?mode=w"
_HEADER = 28
"""Size of the header of each event in a log, before channel and message [bytes]."""

_ROUTE = "ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo"


def body_of(model: CuboidModel, name: str | None = None) -> str:
    """Return the object's name in messages: `name`, else by its shape; LiveError if it is malformed."""
    if name is None:
        return "cube" if np.allclose(model.size, model.size[0]) else "cuboid"
    if not _BODY.fullmatch(name):
        raise LiveError(f"body: found {name!r}, expected a letter, then letters, digits and _, 40 at most")
    return name


def lcm_message_of(moment: Moment, object_name: str, body: str) -> bytes | None:
    """Return a message with the newest filtered pose; None if the object is lost, which it cannot express.

    `utime` is the timestamp of the latest image [µs], on the source's clock (for cameras, since the epoch).
    Positions are the object's quaternion, w first, and centre [m] in the world; velocities are angular
    [rad/s], then linear [m/s], both along world axes.
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
    """Publishes the pose of each moment by LCM as `lcmt_object_state`; a listener of `Live`.

    The channel is the body's name in capitals with `_STATE`. While the object is lost, nothing is published.
    Nothing is ever received; messages that cannot be sent are counted and dropped.

    Args:
        address: `lcm://`, which stands for LCM_DEFAULT_URL or else LCM's default; `udpm://ADDRESS:PORT`, a
            multicast group; `file://PATH`, a new LCM log file.
        model: the object.
        body: its name in messages; None: see `body_of`.
        public: whether other machines may receive messages, which requires a time to live of 1 or more.

    Raises:
        LiveError: the package is not installed, the address is invalid or reaches other machines, or LCM
            cannot be set up there.
    """

    def __init__(
        self, address: str, model: CuboidModel, *, body: str | None = None, public: bool = False
    ) -> None:
        self.address = _url(address, public)  # in LCM's form
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
            route = "" if self._log else f"; without a network it needs a route: {_ROUTE}"
            raise LiveError(f"publish {address}: LCM cannot be set up for {self.address}{route}") from error

    def __call__(self, moment: Moment) -> None:
        """Publish a moment."""
        message = lcm_message_of(moment, self._name, self._body)
        if message is None:
            return
        try:
            self._lcm.publish(self.channel, message)
        except OSError as error:  # the network may come back
            self._unsent, self._refused = self._unsent + 1, str(error)
        self._logged += _HEADER + len(self.channel) + len(message)

    def close(self) -> None:
        """Release the address; must not run during a call."""
        self._lcm = None

    @property
    def fault(self) -> str | None:
        """What a log lacks (LCM does not report a full disk), or how many messages were not sent; or None."""
        where = f"publish {self.address}:"
        if self._log is not None:
            try:
                found = self._log.stat()
            except OSError as error:
                return f"{where} the log is gone: {error.strerror}"
            lacks = self._logged - found.st_size
            # Until LCM is closed, the end of the log is buffered in memory.
            if lacks > (0 if self._lcm is None else 2 * found.st_blksize):
                return f"{where} the log lacks {lacks} bytes, is the disk full?"
        if self._unsent:
            return f"{where} {self._unsent} messages were not sent; last: {self._refused}"
        return None


def _url(address: str, public: bool) -> str:
    """Return the address in LCM's form, built only from validated parts."""
    kind, _, rest = of_kind(address, str, "publish: address", LiveError).partition("://")
    if address == "lcm://":
        address = os.environ.get(_VARIABLE) or DEFAULT
        if address.startswith("lcm:"):
            raise LiveError(f"publish: {_VARIABLE}: found {address}, expected udpm://ADDRESS:PORT?ttl=0")
    elif kind == "file" and rest and "?" not in rest:
        path = path_of(rest, "publish: address", LiveError)
        if os.path.exists(path) or not path.parent.is_dir():  # Path.exists raises for too long names
            raise LiveError(f"publish {address}: expected a new file, in a folder that there is")
        return f"file://{rest}{_NEW}"
    try:
        found = urlsplit(address)
        group, port = IPv4Address(found.hostname or ""), 7667 if found.port is None else found.port
        options = parse_qsl(found.query, strict_parsing=bool(found.query))
        # The receive buffer's size does not matter to a sender.
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
    """Return whether the address is for LCM, not ZeroMQ."""
    return address.partition("://")[0] in ("lcm", "udpm", "file")
