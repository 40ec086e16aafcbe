import gc
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from numba import njit
from numba.core.types import BaseFunction

from tests.helpers import ROOT, run_python
from tests.helpers.command import Terminal, until
from tracker import warm_up
from tracker.processes import python_command

pytestmark = pytest.mark.process

SCRIPT = """
import gc
import numpy as np
from numba.core.dispatcher import Dispatcher
import tracker
from tracker.cli.demo import DATA

def known():
    kernels = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    return {(one.py_func.__qualname__, signature) for one in kernels for signature in one.signatures
            if one.py_func.__module__.startswith("tracker.")}

with tracker.open_log(DATA) as log:
    frames, rig = list(log), log.rig
tracker.ObjectTracker("cube_v1", rig)
before = known()
print(len(before))
one = tracker.CameraRig([rig[0]], arena=rig.arena)
dark = [0 * image for image in frames[0].images]
veiled = [np.maximum(image, 40) for image in frames[5].images]
for name in ("cube_v2", "cuboid_2x2x8_v2"):
    for cameras in (rig, one):
        follower = tracker.ObjectTracker(tracker.load_object(name), cameras)
        n = len(cameras)
        found = follower.detect(frames[0].images[:n]).object_pose
        for frame in frames[:3]:
            follower.update(frame.images[:n], frame.timestamp)
        last = frames[2].timestamp
        follower.update(frames[3].images[:n], [last + 0.1 + 0.005 * c for c in range(n)])
        follower.update([None, *frames[4].images[1:n]], last + 0.2)
        uses = follower.update([frames[3].images[0], *veiled[1:n]], last + 0.25).cameras
        assert uses[0] == ("frozen" if n > 1 else "used")
        follower.update(dark[:n], last + 0.3)
        follower.predict(last + 0.4)
        print(name, n, found is not None)
print(sorted(what for what, _ in known() - before))
"""


def test_once_a_tracker_is_made_no_image_has_anything_compiled_or_loaded():
    result = run_python(["-c", SCRIPT], check=True)
    count, *found, later = result.stdout.splitlines()
    assert int(count) == warm_up.KERNELS
    assert found[0] == "cube_v2 3 True"
    assert later == "[]"


@pytest.mark.parametrize("command", ["doctor", "detect tracker/demo/000000 --object cube_v2"])
def test_where_numba_may_not_compile_that_is_said_in_one_line(command, monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    result = run_python(["-m", "tracker", *command.split()])
    (line,) = result.stderr.splitlines()
    assert result.returncode == 2
    assert line.startswith("tracker: NUMBA_DISABLE_JIT: found it set")


@pytest.mark.parametrize("kept", [True, False])
def test_kernels_that_a_full_disk_does_not_take_are_told_of(kept, tmp_path, monkeypatch, caplog):
    on_disk = iter([False, False, kept])
    monkeypatch.setattr(warm_up, "kernels_are_cached", lambda: next(on_disk))
    monkeypatch.setattr(warm_up, "kernel_folder", lambda: str(tmp_path))
    for name in ("_begin", "use_others", "use_refinement"):
        monkeypatch.setattr(warm_up, name, lambda: None)
    warm_up.warm_up()
    assert (f"could not be kept in {tmp_path}" in caplog.text) != kept


def test_threads_that_compile_at_once_leave_garbage_collection_as_it_was(monkeypatch):
    before, seconds = gc.get_threshold(), iter([0.1, 0.3])  # the one that begins first ends first
    monkeypatch.setattr(warm_up, "kernels_are_cached", lambda: False)
    monkeypatch.setattr(warm_up, "kernel_folder", lambda: None)
    monkeypatch.setattr(warm_up, "use_others", lambda: time.sleep(next(seconds)))
    monkeypatch.setattr(warm_up, "use_refinement", lambda: None)
    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(warm_up.warm_up) for _ in range(2)]:
            done.result()
    assert gc.get_threshold() == before


def test_compiled_quickly_a_kernel_gives_the_same_and_numba_is_left_as_it_was():
    def kernel(whole, real):
        return whole + whole, whole + real, whole / 2, real + 2

    resolve = BaseFunction.get_call_type
    with warm_up.quickly():
        assert BaseFunction.get_call_type is not resolve
        quick = njit(kernel)(3, 0.5)
    assert BaseFunction.get_call_type is resolve
    assert [(type(value), value) for value in quick] == [(type(v), v) for v in kernel(3, 0.5)]


@pytest.mark.parametrize("packages", ["tracker/{}/__pycache__", "cache/tracker.{}"])
def test_a_terminal_shows_how_many_kernels_there_are_on_disk(packages, tmp_path, monkeypatch):
    for package, count in (("pose", 3), ("segmentation", 2)):
        for name in ("kernels-1", "kernels-2"):
            folder = tmp_path / packages.format(package) / name
            folder.mkdir(parents=True)
            for number in range(count):
                (folder / f"{number}.nbc").touch()
    own = tmp_path / packages.format("pose") / "kernels-1"
    monkeypatch.setattr(warm_up, "kernel_folder", lambda: str(own))
    monkeypatch.setattr(warm_up.sys, "stderr", Terminal())
    with warm_up._counted():
        until(lambda: f"compiled 5 of {warm_up.KERNELS} kernels" in warm_up.sys.stderr.getvalue())


def test_what_compiles_beside_runs_nothing_of_the_present_folder(tmp_path, monkeypatch):
    (tmp_path / "tracker.py").write_text("open('ran', 'w').close()")
    (tmp_path / "json.py").write_text("raise SystemExit('of the present folder')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(ROOT), *filter(None, sys.path)])
    process = warm_up._begin()
    assert process is not None
    assert process.wait() == 0
    assert not (tmp_path / "ran").exists()
    command = python_command("import json; print(json.dumps(sys.argv[1:]))", "a b", "--c")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ('["a b", "--c"]\n', "")
