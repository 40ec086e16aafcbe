"""The viewer of others' making is open to this machine only."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import socket
import subprocess
import sys
import time

import pytest

import tracker
from tests.helpers.filmed import RIG
from tests.helpers.needs import lack
from tracker.pose.result import Observation, Status
from tracker.viz import rerun_viewer as viewer_process
from tracker.viz.rerun_viewer import open_scene

if importlib.util.find_spec("rerun") is None:
    lack("rerun", "no module rerun")

pytestmark = pytest.mark.process

COMMAND = viewer_process._command


@pytest.fixture(autouse=True)
def port(monkeypatch):
    """A port of its own, and no viewer left behind."""
    with socket.create_server(("127.0.0.1", 0)) as one:
        free = one.getsockname()[1]
    monkeypatch.setattr(viewer_process, "PORT", free)
    monkeypatch.setattr(viewer_process, "_open", [])
    monkeypatch.setattr(viewer_process, "_STARTING", 120.0)  # others may need the processor
    yield free
    for process in viewer_process._open:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()


def test_nobody_but_this_machine_can_connect_to_the_viewer(port, monkeypatch):
    if not shutil.which("ss"):
        lack("system", "no ss, which tells who listens where")
    # What shows nothing, but listens as the viewer does: there is no screen.
    monkeypatch.setattr(viewer_process, "_command", lambda: [*COMMAND(), "--serve-grpc"])
    with open_scene(None, RIG, tracker.load_object("cube_v2")) as scene:
        scene.show(0, 0.0, Observation(None, None, Status.LOST), ())
        command = ["ss", "-Hltn", f"sport = :{port}"]
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        assert [line.split()[3] for line in lines] == [f"127.0.0.1:{port}"]


def test_a_viewer_that_is_open_is_used_with_a_warning(port, monkeypatch, caplog):
    viewer = subprocess.Popen([*COMMAND(), "--serve-grpc"], stderr=subprocess.DEVNULL, start_new_session=True)
    viewer_process._open.append(viewer)
    deadline = time.monotonic() + 120
    while not viewer_process._answers():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    monkeypatch.setattr(viewer_process, "_command", lambda: pytest.fail("another was started"))
    assert viewer_process.viewer_address() == f"rerun+http://127.0.0.1:{port}/proxy"
    assert caplog.messages == [f"shown in the viewer that is open already, at 127.0.0.1:{port}"]


def test_what_is_no_viewer_is_not_sent_pictures(port, monkeypatch):
    monkeypatch.setattr(viewer_process, "_command", lambda: pytest.fail("another was started"))
    monkeypatch.setattr(viewer_process, "_ANSWERING", 0.1)
    with (
        socket.create_server(("127.0.0.1", port)),
        pytest.raises(tracker.TrackerError, match=rf"127\.0\.0\.1:{port} in use by something that is no"),
    ):
        viewer_process.viewer_address()


def test_a_file_of_the_present_folder_is_not_taken_for_the_viewer(tmp_path, monkeypatch):
    (tmp_path / "rerun_cli.py").write_text("raise SystemExit('of the present folder')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    done = subprocess.run([*COMMAND(), "--version"], capture_output=True, text=True, check=False)
    assert "present folder" not in done.stderr
    assert done.stdout.startswith("rerun")


@pytest.mark.parametrize("seconds", [0.0, 0.2])
def test_a_viewer_that_ends_is_reported_with_its_reason(seconds, port, monkeypatch):
    """Before it listens, and after."""
    program = (
        "import socket, sys, time\n"
        f"one = socket.create_server(('127.0.0.1', {port})) if {seconds} else None\n"
        f"time.sleep({seconds})\n"
        "sys.exit('Error: the loop: no screen is there.')"
    )
    monkeypatch.setattr(viewer_process, "_command", lambda: [sys.executable, "-c", program])
    monkeypatch.setattr(viewer_process, "_SETTLING", 120.0)
    with pytest.raises(tracker.TrackerError, match="cannot be opened: no screen is there; a file"):
        viewer_process.viewer_address()


def test_a_viewer_that_never_listens_is_ended(monkeypatch):
    hanging = [sys.executable, "-c", "import time; time.sleep(600)"]
    monkeypatch.setattr(viewer_process, "_command", lambda: hanging)
    monkeypatch.setattr(viewer_process, "_STARTING", 0.1)
    with pytest.raises(tracker.TrackerError, match="it does not listen"):
        viewer_process.viewer_address()
    (process,) = viewer_process._open
    assert process.poll() is not None
