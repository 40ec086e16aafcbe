import importlib.util
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.command import assert_one_line_error, well
from tests.helpers.log_writers import make_content, write_native
from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import make_job, write_log
from tracker.calibration.by_object.health import QUANTITIES, Sample
from tracker.pose.result import Observation, Status
from tracker.poses.file import write_poses
from tracker.recordings import run
from tracker.viz import rerun_viewer

needs_rerun = pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun: no module rerun")


def entities(path: Path) -> set[str]:
    """Names of what is in the file, which is whole."""
    assert path.read_bytes()[:3] == b"RRF"
    chunk = pytest.importorskip("rerun.chunk", reason="rerun: no module rerun.chunk")
    return {one.entity_path for one in chunk.RrdReader(path).stream().to_chunks()}


@needs_rerun
@pytest.mark.slow
def test_poses_alone_are_shown_without_images(tmp_path, rng, run_here):
    write_poses(tmp_path / "poses.h5", random_poses(rng, 20))
    well(run_here("view", "poses.h5", "-o", "view.rrd", folder=tmp_path))
    found = entities(tmp_path / "view.rrd")
    assert {"/world/arena", "/world/measured", "/world/filtered", "/world/uncertainty/filtered"} <= found
    assert {"/world/trajectory/filtered", "/confidence/measured", "/std_mm/filtered", "/status"} <= found
    assert "/world/cameras/camera60" in found
    assert "/world/cameras/camera60/image" not in found


@needs_rerun
@pytest.mark.slow
def test_a_recording_is_tracked_on_the_way(tmp_path, run_here):
    write_log(tmp_path / "log", 6)
    given = ("log", "--object", "cube_v2", "-o", "view.rrd", "--every", 2, "-q")
    well(run_here("view", *given, folder=tmp_path))
    health = {"/health/brightness/camera180", "/health/residual/camera60"}
    assert {"/world/cameras/camera180/image", "/status", *health} <= entities(tmp_path / "view.rrd")


@needs_rerun
@pytest.mark.parametrize("more", [(), ("--log", "log")])
def test_poses_are_shown_at_the_times_of_their_images(more, tmp_path, run_here, monkeypatch):
    content = make_content(4)
    content.stamps[:] += [0.01, 0.05, 0.02, 0.06]  # the recorder's own, which are later
    log = write_native(write_log(tmp_path / "log", 4), content)
    poses, shown = run(make_job(log, tmp_path / "poses.h5")).poses, []
    monkeypatch.setattr("tracker.viz.rerun_scene.Scene.show", lambda _, *row: shown.append(row[:2]))
    well(run_here("view", "poses.h5", *more, "-o", "view.rrd", folder=tmp_path))
    assert shown == list(zip(poses.index, poses.timestamp, strict=True))


@needs_rerun
@pytest.mark.parametrize("height", [1.5, float("nan")])
def test_what_a_frame_tells_of_the_rig_is_drawn_where_there_is_something(height, tmp_path):
    from tracker.viz.rerun_viewer import open_scene

    values = {key: np.full(3, 0.2) for key in QUANTITIES}
    with open_scene(tmp_path / "view.rrd", RIG, tracker.load_object("cube_v2")) as scene:
        scene.show(0, 0.0, Observation(None, None, Status.LOST), (), Sample(values, height, None))
    assert ("/health/table" in entities(tmp_path / "view.rrd")) == np.isfinite(height)


def luminance(color: tuple[int, ...]) -> float:
    """Of sRGB, as the guidelines on web content define it."""
    value = np.array(color) / 255
    linear = np.where(value <= 0.03928, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@needs_rerun
@pytest.mark.parametrize("background", [(255, 255, 255), (20, 24, 28)])
def test_lines_are_clear_in_the_light_and_in_the_dark_theme(background):
    from tracker.viz.rerun_scene import _AXES, KINDS

    for color in (*KINDS.values(), *_AXES.values()):
        darker, lighter = sorted((luminance(background), luminance(color)))
        assert (lighter + 0.05) / (darker + 0.05) > 3, color


def test_a_missing_package_is_named_with_its_extra(monkeypatch, run_here):
    monkeypatch.setattr(rerun_viewer, "find_spec", lambda _: None)
    assert_one_line_error(run_here("view", "poses.h5"), ".[rerun]")
