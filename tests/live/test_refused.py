import os
import re
from pathlib import Path
from unittest.mock import Mock

import pytest

import tracker
from tests.helpers import RIG
from tracker.errors import LiveError
from tracker.live import ImageSet, Live, Pushed, Replay
from tracker.live.cameras import CameraSet
from tracker.live.listeners import Recorder
from tracker.live.platform import Frontend
from tracker.live.publishers import LcmPublisher, ZmqPublisher
from tracker.live.sources import open_cameras, settings_of
from tracker.live.web_page import WebPage

CUBE = tracker.load_object("cube_v2")
FINDER = tracker.ObjectTracker(CUBE, RIG)
NAN = float("nan")
GROUP = "udpm://239.255.76.67"


def waiting(**how):
    with Live(Pushed(), FINDER) as live:
        live.wait(**how)


WRONG = [
    *((lambda rate=rate: CameraSet([], [], rate=rate), "rate") for rate in (0.0, -1.0, NAN, 2000.0, None)),
    *((lambda speed=speed: Replay([], speed=speed), "speed") for speed in (0.0, -1.0, NAN, "fast")),
    (lambda: Pushed().push([None] * 3, 1.77e12), "milliseconds"),
    (lambda: open_cameras("opencv:0", RIG), "found 1 cameras.* camera60, camera180, camera300"),
    (lambda: open_cameras("opencv", RIG), "found 0 cameras"),
    (lambda: open_cameras("webcam:0", RIG), "webcam:0.* simulation"),
    (lambda: open_cameras(None, RIG), "source: found None, expected str"),
    (lambda: open_cameras("opencv:0", "calibration"), "rig: found 'calibration', expected CameraRig"),
    (lambda: ImageSet((None,), (1.0, 2.0)), "1 images, 2 stamps"),
    (lambda: ImageSet((None,), (1.0,), (None, None)), "1 images, 1 stamps and 2 faults"),
    *((lambda stamp=stamp: ImageSet((None,), (stamp,)), "taken: stamps: .*finite") for stamp in (NAN, None)),
    *((lambda age=age: ImageSet((None,), (1.0,), age=age), "taken: age: .*finite") for age in (NAN, None)),
    (lambda: ImageSet((), ()), "0 images"),
    (lambda: Live([], FINDER), "source: found list, expected"),
    *(
        (lambda kind=kind, given=given: kind(Pushed(), FINDER, history=given), "history: found .*, expected")
        for kind in (Live, Frontend)
        for given in (0, -1, 1.5, "x", None, True, 10**30)
    ),
    *((lambda kind=kind: kind(Pushed(), 3), "tracker: found 3, expected") for kind in (Live, Frontend)),
    (lambda: Live(Pushed(), FINDER, listeners=3), "listeners: found 3, expected a sequence of functions"),
    (lambda: Live(Pushed(), FINDER, listeners=["print"]), "listeners: found 'print', expected functions"),
    (lambda: waiting(after="newest"), "after: found 'newest', expected a Moment, its sequence number"),
    (lambda: Live(Pushed(), Mock(spec=["update"])), "tracker: found .*, expected a tracker.ObjectTracker"),
    *(
        (lambda t=t: Frontend(Pushed(), FINDER).get_observation(t), "t: found .*, expected a whole number")
        for t in ("a", None, 1.5)
    ),
    (lambda: waiting(timeout="1"), "timeout: found '1', expected seconds, or None"),
    *((lambda port=port: WebPage(port, FINDER), f"page {port}: the port cannot") for port in ("x", 65536)),
    (lambda: Recorder(Path(os.devnull), RIG), "there is such a file"),
]


@pytest.mark.parametrize(("make", "words"), WRONG)
def test_what_is_none_is_refused(make, words):
    with pytest.raises(LiveError, match=words):
        make()


def test_nothing_is_recorded_through_a_link_to_nothing(tmp_path):
    (tmp_path / "link.h5").symlink_to("new.h5")
    with pytest.raises(LiveError, match=r"record .*link\.h5: there is such a file, expected a new one"):
        Recorder(tmp_path / "link.h5", RIG)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Gain = [1]", r"Gain: found \[1\]"),
        ('["c"]\nGain = 1', "expected one of a, b"),
        ("Gain", "not a TOML file"),
    ],
)
def test_settings_that_are_none_are_refused(text, words, tmp_path):
    (tmp_path / "cameras.toml").write_text(text)
    with pytest.raises(LiveError, match=words):
        settings_of(tmp_path / "cameras.toml", ["a", "b"])


LOCAL = "expected tcp://127.0.0.1:PORT"
ELSEWHERE = ("0.0.0.0", "*", "192.168.1.2", "127.evil.org")
NONE = ("127.0.0.1:5555", "udp://x", "tcp://127.0.0.1", "tcp://127.0.0.1:65536")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        *((f"tcp://{host}:5555", "other machines could connect") for host in ELSEWHERE),
        *((address, f"found {address}, {LOCAL}") for address in NONE),
        (None, "address: found None, expected str"),
        ("tcp://", LOCAL),
        ("ipc://", LOCAL),
    ],
)
def test_an_address_for_zmq_that_is_none_or_reaches_others_is_refused(address, words):
    pytest.importorskip("zmq", reason="live: no module zmq")
    for public in (False, True) if LOCAL in words else (False,):
        with pytest.raises(LiveError, match=re.escape(words)):
            ZmqPublisher(address, public=public)


LCM = {
    "other machines could receive it": (f"{GROUP}:7667?ttl=1",),
    "a ttl up to 255": (f"{GROUP}:7667?ttl=-1", f"{GROUP}:7667?ttl=256"),
    "a group from 224.0.0.0 on": ("udpm://192.0.2.1:7667?ttl=0", "udpm://239.255.76.256:7667?ttl=0"),
    "somewhere": ("udpm://somewhere:7667?ttl=0",),
    "address: found None, expected str": (None,),
    "address: found a null byte": ("file:///a\0b",),
    "a new file": ("file://no/poses.lcm", f"file://{__file__}"),
    "publish file:///xxx": (f"file:///{'x' * 300}",),
    "expected lcm://": (
        *(f"{GROUP}:7667?ttl=0&ttl=1", f"{GROUP}:7667?ttl=0&transmit_only=1", f"{GROUP}:7667?ttl"),
        *(f"{GROUP}:70000?ttl=0", f"{GROUP}:0?ttl=0", f"{GROUP}:7667/more?ttl=0"),
        *("lcm://somewhere", "file://", f"file://{__file__}.lcm?mode=a"),
    ),
}
"""Addresses that are none, by words of their errors."""


@pytest.mark.parametrize(("words", "address"), [(words, one) for words in LCM for one in LCM[words]])
def test_an_address_for_lcm_that_is_none_or_reaches_others_is_refused(words, address):
    with pytest.raises(LiveError, match=re.escape(words)):
        LcmPublisher(address, CUBE)


def test_settings_of_one_camera_come_after_those_of_all(tmp_path):
    path = tmp_path / "cameras.toml"
    path.write_text('Gain = 0.0\nExposureTime = 1500.0\n["b"]\nExposureTime = 900.0\n')
    a, b = ({"Gain": 0.0, "ExposureTime": time} for time in (1500.0, 900.0))
    assert settings_of(path, ["a", "b"]) == {"a": a, "b": b}
