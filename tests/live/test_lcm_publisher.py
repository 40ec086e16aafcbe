import os
import re
import socket
import subprocess
import sys
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tracker
from tests.helpers import ROOT
from tests.helpers.moments import estimate, moment
from tests.helpers.needs import lack
from tracker.errors import LiveError
from tracker.live.publishers import DEFAULT, LcmPublisher, _url, body_of, lcm_message_of

lcm = pytest.importorskip("lcm", reason="lcm: no module lcm")

CUBE, CUBOID = tracker.load_object("cube_v2"), tracker.load_object("cuboid_2x2x8_v2")


@pytest.fixture(scope="module")
def decoded(tmp_path_factory):
    """Reads a message by the code that LCM's own generator makes of the documented type."""
    folder, page = tmp_path_factory.mktemp("type"), (ROOT / "docs" / "live.md").read_text()
    (folder / "state.lcm").write_text(re.search(r"package dairlib;.*?\n}\n", page, re.DOTALL)[0])
    generator = os.path.join(lcm.LCM_BIN_DIR, "lcm-gen")
    subprocess.run([generator, "--python", "--ppath", folder, folder / "state.lcm"], check=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        from dairlib import lcmt_object_state

        def decode(content):
            state = lcmt_object_state.decode(content)
            assert state.encode() == content
            return state

        yield decode
    sys.modules.pop("dairlib")


@pytest.fixture
def file(tmp_path):
    """The address of a log."""
    return f"file://{tmp_path / 'poses.lcm'}"


def content_of(one, body="cube"):
    return lcm_message_of(one, "cube_v2", body)


def test_a_message_has_the_pose_with_w_first_and_the_rotation_before_the_centre(decoded):
    pose = estimate(0.25)
    found = decoded(content_of(moment(7, pose=pose)))
    assert found.utime == 1_000_700_000
    assert found.object_name == "cube_v2"
    assert found.position_names == [f"cube_{n}" for n in ("qw", "qx", "qy", "qz", "x", "y", "z")]
    assert found.velocity_names == [f"cube_{n}" for n in ("wx", "wy", "wz", "vx", "vy", "vz")]
    assert found.position[4:] == tuple(pose.position)
    w, *xyz = found.position[:4]
    assert np.allclose(Rotation.from_quat([*xyz, w]).as_matrix(), pose.rotation, atol=1e-12)
    assert found.velocity == (3, 4, 5, 0, 1, 2)
    assert content_of(moment(0)) is None  # where the object is lost


def test_bodies_and_their_channels_are_called_after_their_shape_or_as_given(decoded, file):
    assert [body_of(CUBE), body_of(CUBOID), body_of(CUBOID, "box_2")] == ["cube", "cuboid", "box_2"]
    assert decoded(content_of(moment(0, pose=estimate()), "box_2")).velocity_names[0] == "box_2_wx"
    assert LcmPublisher(file, CUBE, body="box_2").channel == "BOX_2_STATE"
    for name in ("", "2box", "a b", "käse", "a" * 41):
        with pytest.raises(LiveError, match="body: found"):
            body_of(CUBE, name)


def test_what_is_missing_is_named_with_its_extra(file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "lcm", None)
    with pytest.raises(LiveError, match=r"pip install .*\[lcm\]"):
        LcmPublisher(file, CUBE)
    assert not list(tmp_path.iterdir())


def test_a_log_has_a_message_of_each_pose_and_none_of_a_lost_object(decoded, file, tmp_path):
    publisher = LcmPublisher(file, CUBE)
    poses = [estimate(0.01 * n) for n in range(5)]
    for number, pose in enumerate(poses):
        publisher(moment(number, pose=pose))
        publisher(moment(number))  # lost
    publisher.close()
    events = list(lcm.EventLog(str(tmp_path / "poses.lcm")))
    assert [event.channel for event in events] == ["CUBE_STATE"] * 5
    for number, (pose, event) in enumerate(zip(poses, events, strict=True)):
        state = decoded(event.data)
        assert state.utime == 1_000_000_000 + 100_000 * number
        assert state.position[4:] == tuple(pose.position)


def test_a_subscriber_gets_what_is_published_and_nothing_else_listens(decoded):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    group = f"udpm://239.255.76.68:{port}?ttl=0"
    try:
        publisher = LcmPublisher(group, CUBOID)
        publisher(moment(0, pose=estimate()))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.bind(("", port))  # nobody else has it
        receiver, received = lcm.LCM(group), []
        receiver.subscribe("CUBOID_STATE", lambda *arguments: received.append(arguments))
    except (RuntimeError, LiveError) as error:
        lack("multicast", str(error))
    publisher(moment(3, pose=estimate(0.25)))
    assert receiver.handle_timeout(60_000)
    ((channel, content),) = received
    assert channel == publisher.channel
    assert decoded(content).object_name == "cuboid_2x2x8_v2"
    publisher.close()


def test_a_log_that_cannot_be_written_is_reported_without_words_on_networks(monkeypatch, file):
    monkeypatch.setattr("lcm.LCM", Mock(side_effect=RuntimeError))
    with pytest.raises(LiveError, match=r"cannot be set up for file://[^;]*$"):
        LcmPublisher(file, CUBE)
    with pytest.raises(LiveError, match="ip route add"):
        LcmPublisher(DEFAULT, CUBE)


def test_a_log_that_is_written_whole_is_no_fault_and_one_that_lacks_something_is(tmp_path):
    whole, full, few = (LcmPublisher(f"file://{tmp_path / name}", CUBE) for name in ("whole", "full", "few"))
    full._lcm = few._lcm = Mock()  # LCM tells nothing of a disk that is full
    for number in range(100):
        whole(moment(number, pose=estimate()))
        full(moment(number, pose=estimate()))
        assert whole.fault is None
    assert re.search(r"the log lacks \d+ bytes, is the disk full", full.fault)
    whole.close()
    assert whole.fault is None
    few(moment(0, pose=estimate()))
    few.close()
    assert "the log lacks" in few.fault


def test_a_network_that_is_gone_ends_nothing(file):
    publisher = LcmPublisher(file, CUBE)
    publisher._lcm = Mock(**{"publish.side_effect": OSError("Network is unreachable")})
    for number in range(3):
        publisher(moment(number, pose=estimate()))
    assert publisher.fault.endswith("3 messages were not sent; last: Network is unreachable")


def test_lcm_gets_the_address_that_was_checked(monkeypatch):
    monkeypatch.delenv("LCM_DEFAULT_URL", raising=False)
    assert _url("lcm://", False) == "udpm://239.255.76.67:7667?ttl=0"
    assert _url("udpm://239.1.2.3?recv_buf_size=99", False) == "udpm://239.1.2.3:7667?ttl=0"
    assert _url("udpm://239.1.2.3:7000?ttl=2", True) == "udpm://239.1.2.3:7000?ttl=2"
    monkeypatch.setenv("LCM_DEFAULT_URL", "udpm://239.255.76.67:7667?ttl=1")
    assert _url("lcm://", True).endswith("ttl=1")
    with pytest.raises(LiveError, match="other machines could receive it"):
        _url("lcm://", False)
    monkeypatch.setenv("LCM_DEFAULT_URL", "lcm://")
    with pytest.raises(LiveError, match="LCM_DEFAULT_URL: found lcm://"):
        _url("lcm://", False)
