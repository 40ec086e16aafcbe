"""Poses for other processes, by ZeroMQ (the extra `live`)."""

from __future__ import annotations

import re
from importlib.util import find_spec
from typing import Any

from tracker.errors import LiveError, install
from tracker.live.message import message_of
from tracker.live.moment import Moment

_FORMS = "tcp://127.0.0.1:PORT, ipc://PATH"
_ADDRESS = re.compile(r"tcp://.+:(\d{1,5}|\*)|(ipc|inproc)://.+")
_PORT = re.compile(r"(?<=:)\d+$")
"""ZeroMQ takes one that is too large for another that is not."""
_LOCAL = re.compile(r"tcp://(127(\.\d{1,3}){3}|localhost|\[::1\]):(\d{1,5}|\*)|(ipc|inproc)://.+")


class ZmqPublisher:
    """Publishes each moment; a listener of `Live`.

    A subscriber gets the newest message only: what it does not fetch is replaced, and one that hangs holds
    up nobody. Nothing is ever received.

    Args:
        address: e.g. `tcp://127.0.0.1:5555`.
        public: whether other machines may connect. Whoever can reach the address sees the poses.

    Raises:
        LiveError: pyzmq is not installed, the address is not this machine's own, or cannot be bound.
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

        self._zmq = zmq
        self._socket: Any = zmq.Context.instance().socket(zmq.PUB)
        self._socket.setsockopt(zmq.CONFLATE, 1)
        self._socket.setsockopt(zmq.LINGER, 0)
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
