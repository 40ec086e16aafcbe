"""Poses for other processes, by ZeroMQ (the extra `live`): one JSON object a message."""

from __future__ import annotations

import json
import re
import stat
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tracker.errors import LiveError, install
from tracker.live.moment import Moment

VERSION = 3
"""Of the message; it grows when a field changes its meaning or goes, not when one is added."""

_FORMS = "tcp://127.0.0.1:PORT, ipc://PATH"
_ADDRESS = re.compile(r"tcp://.+:(\d{1,5}|\*)|(ipc|inproc)://.+")
_PORT = re.compile(r"(?<=:)\d+$")
"""ZeroMQ takes one that is too large for another that is not."""
_LOCAL = re.compile(r"tcp://(127(\.\d{1,3}){3}|localhost|\[::1\]):(\d{1,5}|\*)|(ipc|inproc)://.+")


def message_of(moment: Moment) -> bytes:
    """The message, UTF-8: the filtered pose of the newest images, or null where the object is lost.

    Fields: `version`; `sequence`, of the set of images; `timestamp`, of its latest image [s]; `status`;
    `pose`, with `position` (3) [m], `orientation` (4) xyzw, `covariance` (6, 6) of (δp, δθ) along world
    axes [m, rad] and `confidence`, or null; `velocity` (6) [m/s, rad/s] or null; `latency_ms`, from the
    latest image to the pose; `faults`, what was wrong with this set, texts by the camera's name; `jump`, how
    all stamps jumped before it, or null; `fault_counts`, in how many sets since the start something was wrong
    with each camera, and `jump_count`: of sets that a subscriber never fetched, they tell.
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
        public: whether other machines may connect. Whoever can reach the address sees the poses.

    Raises:
        LiveError: pyzmq is not installed, the address is not this machine's own, cannot be bound, or names a
            file that is no socket.
    """

    def __init__(self, address: str, *, public: bool = False) -> None:
        if not _ADDRESS.fullmatch(address) or int((_PORT.search(address) or "0")[0]) > 65535:
            raise LiveError(f"publish: found {address}, expected {_FORMS}, lcm://, udpm:// or file://")
        if not (public or _LOCAL.fullmatch(address)):
            raise LiveError(
                f"publish {address}: other machines could connect to it; expected {_FORMS}, or to be told "
                "that it is meant to be public"
            )
        if find_spec("zmq") is None:
            raise LiveError(f"publish: pyzmq is not installed: {install('live')}")
        import zmq

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
        """As `LcmPublisher` has it; nothing is left unsent here but what nobody fetched."""

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
