import contextlib
import http.client
import itertools
import json
import shutil
import socket
import struct
import subprocess
import threading
import time
from dataclasses import replace
from importlib.resources import files

import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.command import until
from tests.helpers.filmed import shots
from tests.helpers.moments import estimate, moment
from tracker.calibration.by_object.health import QUANTITIES
from tracker.errors import LiveError
from tracker.live.web_page import LATENCIES, WebPage, WebPageState
from tracker.pose.result import CameraUse

FOLLOWER = tracker.ObjectTracker(tracker.load_object("cube_v2"), RIG)
IMAGES = tuple(np.full((270, 270, 3), 60 + c, np.uint8) for c in range(3))


@pytest.fixture
def page():
    with contextlib.closing(WebPage(0, FOLLOWER)) as one:
        yield one


@contextlib.contextmanager
def asking(page, path, **headers):
    """A connection on which a request was made."""
    port = page._server.server_port
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=60)) as asked:
        asked.request("GET", path, headers=headers)
        yield asked


def got(page: WebPage, path: str, **headers: str) -> tuple[int, bytes]:
    with asking(page, path, **headers) as asked:
        answer = asked.getresponse()
        return answer.status, answer.read()


def next_message(page: WebPage, one) -> dict:
    """The message of a moment, by a browser that has been waiting before."""
    with asking(page, f"/message?{one.sequence - 1}") as asked:
        while not page.is_open:
            time.sleep(0.001)
        page(one)
        content = asked.getresponse().read()
    while not content:  # a busy machine takes longer than a message is waited for
        _, content = got(page, f"/message?{one.sequence - 1}")
    return json.loads(content)


def test_the_page_shows_pose_and_cameras_as_they_are(page):
    film = shots("cube_v2", 1, seed=701)[0]
    assert FOLLOWER.detect(film.images).object_pose is not None
    images = (film.images[0], None, film.images[2])
    one = moment(7, images, pose=estimate(0.05))
    seen = replace(one.observation, cameras=(CameraUse.USED, CameraUse.NO_IMAGE, CameraUse.USED))
    one = replace(one, observation=seen, faults={"camera180": "its plug is out"})
    page.faults = lambda: ["something"]
    message = next_message(page, one)
    assert message["sequence"] == 7
    assert message["position"] == pytest.approx([50.0, -20.0, 32.5])
    assert message["latency_ms"] == pytest.approx([12.0] * 4)
    assert message["faults"] == ["something"]
    first, gone, last = message["cameras"]
    assert (gone["use"], gone["fault"], gone["missing"]) == ("no_image", "its plug is out", 100.0)
    assert (gone["last_fault"], gone["last_fault_age"]) == ("its plug is out", 0.0)
    assert first["last_fault"] is None
    assert gone["level"] is None
    assert gone["beyond"] == ["missing"]
    assert first["level"] == pytest.approx(np.median(cv2.cvtColor(images[0], cv2.COLOR_BGR2GRAY)), abs=1)
    assert 0.0 < first["residual"] < 0.5
    assert last["skew"] == pytest.approx(2.0)


def test_cameras_are_compared_once_an_object_is_known_to_rest():
    film, state = shots("cube_v2", 1, seed=701)[0], WebPageState(FOLLOWER)
    follower = tracker.ObjectTracker(FOLLOWER.model, RIG)
    for k in range(3):
        one = moment(k, tuple(film.images))
        state.look(replace(one, observation=follower.update(film.images, one.timestamp)))
        assert np.isfinite(state._disagreement).any() == (k > 0)


def test_the_page_names_units_as_the_health_of_a_recording_does_and_the_number_of_latencies():
    content = files("tracker.live").joinpath("web_page.html").read_text("utf-8")
    for key, name in (("residual", "residual"), ("disagreement", "disagreement at rest")):
        assert f'"{name} [{QUANTITIES[key].unit}]"' in content
    assert f"percentiles of the last {LATENCIES} sets" in content


def test_a_fault_that_has_passed_is_reported_for_some_seconds(monkeypatch):
    now = 100.0
    monkeypatch.setattr("tracker.live.web_page.time.monotonic", lambda: now)
    state, failed = WebPageState(FOLLOWER), "the buffer failed"
    for seconds, *expected in ((0.0, failed, failed, 0.0), (4.0, None, failed, 4.0), (7.0, None, None, None)):
        now += seconds
        one = replace(moment(0, IMAGES), faults={} if seconds else {"camera60": failed})
        state.see(one)
        first = state.message(one, ())["cameras"][0]
        assert [first[name] for name in ("fault", "last_fault", "last_fault_age")] == expected


def test_one_image_in_a_hundred_may_be_missing_on_the_page_as_in_a_check():
    state = WebPageState(FOLLOWER)
    for number in range(100):
        state.see(moment(number, IMAGES if number else (None, *IMAGES[1:])))
    assert state.message(moment(99, IMAGES), ())["cameras"][0]["beyond"] == []


def test_the_picture_has_every_camera(page):
    next_message(page, moment(0, IMAGES))
    status, content = got(page, "/picture?0")
    assert status == 200
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    for c in range(3):
        assert image[300, 540 * c + 276] == pytest.approx([60 + c] * 3, abs=2)


def test_only_this_machine_can_connect(page):
    port = page.port
    if shutil.which("ss"):
        command = ["ss", "-Hltn", f"sport = :{port}"]
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        assert [line.split()[3] for line in lines] == [f"127.0.0.1:{port}"]
    addresses = {entry[4][0] for entry in socket.getaddrinfo(socket.gethostname(), port, socket.AF_INET)}
    for address in addresses:
        if not address.startswith("127."):
            with pytest.raises(OSError, match="refused"):
                socket.create_connection((address, port), timeout=60)


def test_the_page_itself_and_a_link_to_it_may_ask_but_no_site_elsewhere(page):
    def fetch(site, what):
        return {"Sec-Fetch-Site": site, "Sec-Fetch-Dest": what}

    elsewhere = "http://elsewhere.example", "null", f"http://127.0.0.1:{page.port + 1}"
    refused = [{"Origin": origin} for origin in elsewhere] + [{"Host": "elsewhere.example"}]
    refused += [fetch(site, "image") for site in ("cross-site", "same-site")]
    for path, headers in itertools.product(("/", "/message?", "/picture"), refused):
        assert got(page, path, **headers)[0] == 403
    assert got(page, "/") == (200, files("tracker.live").joinpath("web_page.html").read_bytes())
    own = {"Origin": f"http://localhost:{page.port}"}
    for headers in (own, fetch("cross-site", "document"), fetch("same-origin", "image")):
        assert got(page, "/", **headers)[0] == 200
    for port, code in ((page.port, 403), (80, 200)):  # the default is left out
        page.port = port
        for host in ("localhost", "127.0.0.1"):
            assert got(page, "/", Host=host, Origin=f"http://{host}")[0] == code


def test_a_connection_that_is_reset_is_no_word_on_stderr(page, capsys):
    for request in (b"", b"GET / HT", b"GET /message? HTTP/1.0\r\nHost: localhost:%d\r\n\r\n" % page.port):
        with socket.create_connection(("127.0.0.1", page.port), timeout=60) as asked:
            asked.sendall(request)
            time.sleep(0.05)
            asked.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    def none_is_answered():
        page(moment(0, IMAGES))
        return not any(thread.name.startswith("Thread-") for thread in threading.enumerate())

    until(none_is_answered)
    assert capsys.readouterr().err == ""


def test_connections_beyond_a_few_are_closed_and_free_again_once_others_are(page):
    with contextlib.ExitStack() as opened:
        address = "127.0.0.1", page.port
        many = [opened.enter_context(socket.create_connection(address, timeout=60)) for _ in range(24)]
        for one in many[20:]:
            one.settimeout(5)
            assert one.recv(1) == b""

    def let_in():
        with contextlib.suppress(OSError, http.client.HTTPException):
            return got(page, "/")[0] == 200

    until(let_in)


def test_a_browser_that_reads_nothing_holds_up_nobody(page):
    with asking(page, "/message?"):
        for number in range(300):
            page(moment(number, IMAGES))  # returns at once
        while next_message(page, moment(300, IMAGES))["sequence"] < 300:
            pass


def test_a_port_in_use_is_named_and_the_page_ends_with_who_watches_it():
    one = WebPage(0, FOLLOWER)
    with pytest.raises(LiveError, match=f"page {one.port}: the port cannot be used"):
        WebPage(one.port, FOLLOWER)
    with asking(one, "/message?") as watching, watching.getresponse():
        one.close()
    with pytest.raises(OSError, match="refused"):
        got(one, "/")
