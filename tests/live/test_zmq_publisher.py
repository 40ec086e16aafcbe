import contextlib
import itertools
import json
import socket
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import ROOT, contents
from tests.helpers.moments import estimate, moment
from tracker.errors import LiveError
from tracker.live.publishers import ZmqPublisher, message_of

zmq = pytest.importorskip("zmq", reason="live: no module zmq")


def test_a_message_says_everything_in_plain_json():
    one = replace(
        moment(7, pose=estimate(0.25)),
        faults={"stamps": "the buffer failed"},  # a camera may be called so
        jump="went back by 3.000 s",
        fault_counts={"stamps": 4, "camera60": 0},
        jump_count=2,
    )
    content = json.loads(message_of(one))
    pose = content.pop("pose")
    assert content == {
        "version": 3,
        "sequence": 7,
        "timestamp": pytest.approx(1000.7),
        "status": "tracking",
        "velocity": [0, 1, 2, 3, 4, 5],
        "latency_ms": pytest.approx(12),
        **{name: getattr(one, name) for name in ("faults", "jump", "fault_counts", "jump_count")},
    }
    assert (pose["position"], pose["orientation"]) == ([0.25, -0.02, 0.0325], [0, 0, 0.6, 0.8])
    assert (np.array(pose["covariance"]).shape, pose["confidence"]) == ((6, 6), 0.97)
    lost = json.loads(message_of(moment(0)))
    assert (lost["pose"], lost["velocity"], lost["status"]) == (None, None, "lost")


@pytest.fixture
def publisher():
    with contextlib.closing(ZmqPublisher("tcp://127.0.0.1:*")) as one:
        yield one


def test_a_subscriber_gets_the_newest_only(publisher):
    sequences, received = itertools.count(), []
    with zmq.Context.instance().socket(zmq.SUB) as listening:
        listening.setsockopt(zmq.CONFLATE, 1)
        listening.setsockopt(zmq.LINGER, 0)
        listening.setsockopt_string(zmq.SUBSCRIBE, "")
        listening.connect(publisher.address)
        while not listening.poll(20):  # until it is connected
            publisher(moment(next(sequences)))
        for sequence in range(1000, 1100):
            publisher(moment(sequence))
        while not received or received[-1] < 1099:
            received.append(json.loads(listening.recv())["sequence"])
    assert received == sorted(received)
    assert len(received) < 100


def test_the_example_prints_what_is_published(publisher):
    command = [sys.executable, str(ROOT / "examples" / "subscribe.py"), publisher.address]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        done = threading.Event()

        def publish():
            while not done.wait(0.02):
                publisher(replace(moment(0, pose=estimate(0.25)), fault_counts={"camera60": count}))

        count = 5  # before anybody listened
        publishing = threading.Thread(target=publish)
        publishing.start()
        lines = [process.stdout.readline(), process.stdout.readline()]
        assert lines == ["tracking [0.25, -0.02, 0.0325]\n"] * 2
        count = 7
        line = next(line for line in process.stdout if line != lines[0])
        assert line == "camera60: faults in 2 sets: usable again\n"
        done.set()
        publishing.join()
        process.kill()


def test_an_address_in_use_is_named(publisher):
    with pytest.raises(LiveError, match=rf"publish {publisher.address}: Address already in use"):
        ZmqPublisher(publisher.address)


def test_what_is_there_and_is_no_socket_is_left_as_it_is(tmp_path):
    (tmp_path / "file").write_text("years of work")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "folder").mkdir()
    before = contents(tmp_path)
    for name in ("file", "link", "folder"):
        with pytest.raises(LiveError, match="other than a socket"):
            ZmqPublisher(f"ipc://{tmp_path / name}")
        assert contents(tmp_path) == before


def test_a_socket_that_an_earlier_run_left_is_bound_again(tmp_path):
    left = tmp_path / "poses"
    with socket.socket(socket.AF_UNIX) as earlier:
        earlier.bind(str(left))
    assert left.is_socket()
    ZmqPublisher(f"ipc://{left}").close()


@pytest.mark.parametrize(
    ("kind", "room"),
    [(socket.SOCK_DGRAM, 0), (socket.SOCK_SEQPACKET, 0), (socket.SOCK_STREAM, 0), (socket.SOCK_STREAM, 9)],
)
def test_a_socket_of_any_kind_is_left_to_its_program_even_if_that_is_busy(tmp_path, kind, room):
    path = str(tmp_path / "poses")
    with socket.socket(socket.AF_UNIX, kind) as other, socket.socket(socket.AF_UNIX, kind) as client:
        other.bind(path)
        if kind != socket.SOCK_DGRAM:
            other.listen(room)
        client.connect(path)  # without room there is none for another
        with pytest.raises(LiveError, match="found a program that listens there, expected a new path"):
            ZmqPublisher(f"ipc://{path}")
        client.send(b"still there")


def test_addresses_are_bound_for_all_where_that_is_meant_and_of_ipv6_where_the_machine_has_it():
    with contextlib.closing(ZmqPublisher("tcp://0.0.0.0:*", public=True)) as one:
        assert one.address.startswith("tcp://0.0.0.0:")
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        with pytest.raises(LiveError, match=r"publish tcp://\[::1\]"):
            ZmqPublisher("tcp://[::1]:*")
        return
    with contextlib.closing(ZmqPublisher("tcp://[::1]:*")) as one:
        assert one.address.startswith("tcp://[::1]:")
