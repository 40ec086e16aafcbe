"""Poses for other processes, by LCM (the extra `lcm`)."""

from __future__ import annotations

import ipaddress
import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from tracker.errors import LiveError, install
from tracker.live.lcm_message import body_of, channel_of, lcm_message_of
from tracker.live.moment import Moment
from tracker.objects.model import CuboidModel

SCHEMES = ("lcm", "udpm", "file")
"""What an address begins with, before `://`."""

DEFAULT = "udpm://239.255.76.67:7667?ttl=0"
"""LCM's own; a time to live of 0 keeps messages on this machine."""

_VARIABLE = "LCM_DEFAULT_URL"
_FORMS = "lcm://, udpm://ADDRESS:PORT?ttl=0 or file://PATH"
_NEW = "?mode=w"
_PORT = 7667
_HEADER = 28
"""Of each event of a log, before channel and message [bytes]."""
_ROUTE = "ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo"


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
        self.channel = channel_of(self._body)
        self.fault: str | None = None
        """How many messages the network did not take, and why not the last of them; or what a log lacks."""
        self._unsent = 0
        kind, _, rest = self.address.partition("://")
        self._log = Path(rest.removesuffix(_NEW)) if kind == "file" else None
        self._logged = 0
        if find_spec("lcm") is None:
            raise LiveError(f"publish: lcm is not installed: {install('lcm')}")
        import lcm

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
            self._unsent += 1
            self.fault = f"publish {self.address}: {self._unsent} messages were not sent; last: {error}"
        self._logged += _HEADER + len(self.channel) + len(message)
        self._look_at_log(closed=False)

    def close(self) -> None:
        """Free the address; nobody may be in a call."""
        self._lcm = None
        self._look_at_log(closed=True)

    def _look_at_log(self, *, closed: bool) -> None:
        """Whether the log has what it was given: LCM says nothing of a disk that is full."""
        if self._log is None:
            return
        try:
            found = self._log.stat()
        except OSError as error:
            self.fault = f"publish {self.address}: the log is gone: {error.strerror}"
            return
        # Before it is closed, the last of it waits in memory.
        waiting = 0 if closed else 2 * found.st_blksize
        if found.st_size < self._logged - waiting:
            lacks = self._logged - found.st_size
            self.fault = f"publish {self.address}: the log lacks {lacks} bytes, is the disk full?"


def _url(address: str, public: bool) -> str:
    """The address in LCM's words, put together anew: LCM reads nothing that was not looked at here."""
    kind, _, rest = address.partition("://")
    if kind == "lcm" and not rest:
        given = os.environ.get(_VARIABLE) or DEFAULT
        if given.startswith("lcm:"):
            raise LiveError(f"publish: {_VARIABLE}: found {given}, expected udpm://ADDRESS:PORT?ttl=0")
        return _url(given, public)
    if kind == "udpm":
        return _multicast(address, public)
    if kind == "file" and rest and "?" not in rest:
        path = Path(rest)
        if path.exists() or not path.parent.is_dir():
            raise LiveError(f"publish {address}: expected a new file, in a folder that there is")
        return f"file://{rest}{_NEW}"
    raise LiveError(f"publish: found {address}, expected {_FORMS}")


def _multicast(address: str, public: bool) -> str:
    try:
        parts = urlsplit(address)
        group = ipaddress.IPv4Address(parts.hostname or "")
        port = _PORT if parts.port is None else parts.port
        options = parse_qsl(parts.query, strict_parsing=bool(parts.query))
        # How much may wait for who receives is nothing to who sends.
        reach = [int(value) for name, value in options if name != "recv_buf_size"] or [0]
        known = all(name in ("ttl", "recv_buf_size") for name, _ in options)
    except ValueError as error:
        raise LiveError(f"publish {address}: {error}; expected {_FORMS}") from error
    if parts.path or parts.fragment or parts.username is not None or not known or len(reach) != 1:
        raise LiveError(f"publish: found {address}, expected {_FORMS}")
    if not (group.is_multicast and 1 <= port <= 65535 and 0 <= reach[0] <= 255):
        raise LiveError(
            f"publish: found {address}, expected the address of a group, from 224.0.0.0 on, a port, "
            "and a ttl from 0 to 255"
        )
    if reach[0] and not public:
        raise LiveError(
            f"publish {address}: other machines could receive it; expected ttl=0, or to be told that it is "
            "meant to be public"
        )
    return f"udpm://{group}:{port}?ttl={reach[0]}"
