from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

import tracker
from benchmarks.measure import processes
from benchmarks.measure.speed import by_faces
from benchmarks.measure.timed_scenes import TimedScene, sized_scenes
from benchmarks.measure.timing import OTHER, Timings, one_thread, time_detections, time_updates
from tests.helpers import run_python


@pytest.fixture(scope="module")
def timed() -> tuple[tracker.CameraRig, list[TimedScene], Timings]:
    rig, scenes = sized_scenes("cube_v2", 2, 270)
    detector = tracker.ObjectTracker(tracker.load_object("cube_v2"), rig)
    return rig, scenes, time_detections(detector, scenes, 3)


def test_the_stages_make_up_the_whole(timed):
    _, _, timings = timed
    assert OTHER in timings.stages
    assert "total" not in timings.stages
    np.testing.assert_allclose(sum(timings.stages.values()), timings.detect, rtol=0.02)


def test_every_scene_is_timed_equally_often(timed):
    _, scenes, timings = timed
    for times in (timings.detect, timings.reference, timings.right, *timings.stages.values()):
        assert times.shape == (3 * len(scenes),)
    assert sum(row["n"] for row in by_faces(scenes, timings)) == len(timings.detect)
    assert sum(row["scenes"] for row in by_faces(scenes, timings)) == len(scenes)


def test_ratios_are_of_pairs():
    detect, reference = np.array([2.0, 40.0, 6.0]), np.array([1.0, 20.0, 3.0])
    row = Timings(detect, reference, {"a": detect / 2}, np.array([1.0, 0.0, np.nan])).row()
    assert row["ratio"] == row["ratio_p99"] == 2.0
    assert row["median_ms"] == 6.0
    assert row["right"] == 50


def test_answers_are_judged_only_where_the_truth_is_known(timed):
    rig, scenes, timings = timed
    assert np.all(timings.right == 1)
    detector = tracker.ObjectTracker(tracker.load_object("cube_v2"), rig)
    unknown = time_detections(detector, [TimedScene(scenes[0].images)], 1)
    assert np.isnan(unknown.row()["right"])


def test_updates_are_timed_while_the_object_is_followed(timed):
    rig, scenes, _ = timed
    still = [dataclasses.replace(scenes[0], timestamp=k / 10) for k in range(4)]
    away = [dataclasses.replace(scenes[0], images=[None] * 3, timestamp=0.4 + k / 10) for k in range(2)]
    follower = tracker.ObjectTracker(tracker.load_object("cube_v2"), rig)
    timings = time_updates(follower, [*still, *away], 2)
    # Neither the play that warms up, nor the frame that finds the object, nor those without it.
    assert len(timings.detect) == len(timings.reference) == 2 * (len(still) - 1)
    assert timings.row()["right"] == 100
    assert timings.row()["ratio"] > 0
    nothing = time_updates(follower, away, 1).row()
    assert nothing["n"] == 0
    assert np.isnan(nothing["ratio"])


def test_one_thread_leaves_the_number_of_threads_as_it_was():
    before = cv2.getNumThreads()
    with one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before


def test_a_scene_is_the_same_at_every_size():
    _, small = sized_scenes("cuboid_2x2x8_v2", 1, 90)
    _, large = sized_scenes("cuboid_2x2x8_v2", 1, 180)
    np.testing.assert_array_equal(small[0].position, large[0].position)
    for one, other in zip(small[0].images, large[0].images, strict=True):
        halved = cv2.resize(other, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        assert np.median(np.abs(halved.astype(float) - one)) < 6


def test_a_scene_seen_by_fewer_cameras_keeps_their_images_only():
    images = [np.zeros((4, 4, 3), np.uint8) + k for k in range(3)]
    seen = TimedScene(images, faces=5).seen_by([2, 0])
    assert seen.images[1] is None
    assert seen.images[0] is images[0]
    assert seen.images[2] is images[2]


def test_fresh_processes_are_measured(timed, monkeypatch):
    asked = []
    # They find the kernels compiled: to compile them all takes most of a minute.
    monkeypatch.setattr(processes, "kernels_in", lambda cache: asked.append(cache) or {})
    rig, scenes, _ = timed
    rows = {row["group"]: row for row in processes.process_rows("cube_v2", rig, scenes[0], 1)}
    assert len(asked) == 2
    assert asked[0] == asked[1]
    assert not asked[0].exists()
    assert len(rows) == 3
    assert all(row["seconds"] > 0 for row in rows.values())
    memory = {group: row["megabytes"] for group, row in rows.items()}
    assert memory["import tracker"] < memory["first detection, kernels in the cache"]


ONE_KERNEL = """
import numpy as np
from tracker.compiled import is_cached
from tracker.geometry.so3 import exp_into

print(is_cached(exp_into))
exp_into(np.zeros(3), np.empty((3, 3)))
"""


def test_only_the_first_process_of_a_folder_compiles(tmp_path, monkeypatch):
    for key, value in processes.kernels_in(tmp_path).items():
        monkeypatch.setenv(key, value)
    found = [run_python(["-c", ONE_KERNEL], check=True).stdout.strip() for _ in range(2)]
    assert found == ["False", "True"]
