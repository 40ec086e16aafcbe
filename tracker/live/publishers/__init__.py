"""Publishers by the addresses with which a command names them."""

from __future__ import annotations

from tracker.live.publishers.lcm import SCHEMES, LcmPublisher
from tracker.live.publishers.zeromq import ZmqPublisher
from tracker.objects.model import CuboidModel

Publisher = ZmqPublisher | LcmPublisher


def is_lcm(address: str) -> bool:
    """Whether LCM is to publish there, not ZeroMQ."""
    return address.partition("://")[0] in SCHEMES


def open_publisher(
    address: str, model: CuboidModel, *, body: str | None = None, public: bool = False
) -> Publisher:
    """What publishes at an address such as `tcp://127.0.0.1:5555` or `lcm://`.

    Args:
        address: as ZmqPublisher and LcmPublisher take it.
        model: the object.
        body: what LCM's messages call it; None: `cube`, or `cuboid`.
        public: whether other machines may receive it.
    """
    if is_lcm(address):
        return LcmPublisher(address, model, body=body, public=public)
    return ZmqPublisher(address, public=public)
