import importlib.util
import os
import shutil
import signal
import subprocess
import sys

import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.needs import lack
from tracker.pose.result import Observation, Status
from tracker.viz import rerun_viewer
from tracker.viz.rerun_viewer import open_scene

if importlib.util.find_spec("rerun") is None:
    lack("rerun", "no module rerun")

pytestmark = pytest.mark.process

COMMAND = rerun_viewer._command


@pytest.fixture(autouse=True)
def own(monkeypatch):
    """No viewer is left behind."""
    monkeypatch.setattr(rerun_viewer, "_open", [])
    monkeypatch.setattr(rerun_viewer, "_STARTING", 120.0)  # others may need the processor
    yield
    for process in rerun_viewer._open:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()


def test_nobody_but_this_machine_can_connect_to_a_viewer_and_each_is_one_of_its_own(monkeypatch):
    if not shutil.which("ss"):
        lack("system", "no ss, which tells who listens where")
    # What shows nothing, but listens as the viewer does: there is no screen.
    ports: list[int] = []
    monkeypatch.setattr(
        rerun_viewer, "_command", lambda port: ports.append(port) or [*COMMAND(port), "--serve-grpc"]
    )
    for _ in range(2):
        with open_scene(None, RIG, tracker.load_object("cube_v2")) as scene:
            scene.show(0, 0.0, Observation(None, None, Status.LOST), ())
    for port in ports:
        command = ["ss", "-Hltn", f"sport = :{port}"]
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        assert [line.split()[3] for line in lines] == [f"127.0.0.1:{port}"]
    assert len(set(ports)) == 2


def test_a_file_of_the_present_folder_is_not_taken_for_the_viewer(tmp_path, monkeypatch):
    (tmp_path / "rerun_cli.py").write_text("raise SystemExit('of the present folder')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    done = subprocess.run([*COMMAND(0), "--version"], capture_output=True, text=True, check=False)
    assert "present folder" not in done.stderr
    assert done.stdout.startswith("rerun")


@pytest.mark.parametrize("seconds", [0.0, 0.2])
def test_a_viewer_that_ends_is_reported_with_its_reason(seconds, monkeypatch):
    """Before it listens, and after."""
    program = (
        "import socket, sys, time\n"
        f"one = socket.create_server(('127.0.0.1', int(sys.argv[1]))) if {seconds} else None\n"
        f"time.sleep({seconds})\n"
        "sys.exit('Error: the loop: no screen is there.')"
    )
    monkeypatch.setattr(rerun_viewer, "_command", lambda port: [sys.executable, "-c", program, str(port)])
    monkeypatch.setattr(rerun_viewer, "_SETTLING", 120.0)
    with pytest.raises(tracker.TrackerError, match="cannot be opened: no screen is there; a file"):
        rerun_viewer.start_viewer()


def test_a_viewer_that_never_listens_is_ended(monkeypatch):
    hanging = [sys.executable, "-c", "import time; time.sleep(600)"]
    monkeypatch.setattr(rerun_viewer, "_command", lambda _: hanging)
    monkeypatch.setattr(rerun_viewer, "_STARTING", 0.1)
    with pytest.raises(tracker.TrackerError, match="it does not listen"):
        rerun_viewer.start_viewer()
    (process,) = rerun_viewer._open
    assert process.poll() is not None
