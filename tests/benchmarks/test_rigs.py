import dataclasses

import cv2
import numpy as np
import pytest

from benchmarks.data.rigs import CASES, Placement, RigCase, rig_scene
from benchmarks.judge.results import read_results
from benchmarks.score.errors import projected
from tests.benchmarks.made_up import assert_survives, printed_by
from tests.helpers.stills import bare_scene
from tracker.geometry.cuboid import FACE_NORMALS, corners


def small(case: RigCase, width: int = 120) -> RigCase:
    """The same rig with pictures of about this width, which are quick to render."""
    heights = [max(1, round(camera.height * width / camera.width)) for camera in case.stage_cameras]
    pairs = zip(case.stage_cameras, heights, strict=True)
    cameras = tuple(camera.resized(width, height) for camera, height in pairs)
    return dataclasses.replace(case, stage_cameras=cameras)


@pytest.mark.parametrize("name", CASES)
def test_the_truth_projects_onto_its_labels(name):
    case = small(CASES[name])
    model = case.objects[-1]
    scene = rig_scene(case, model, 5, 0)  # even scenes have no fingers
    points = corners(model.size) @ scene.rotation.T + scene.position
    normals = FACE_NORMALS @ scene.rotation.T
    middles = scene.position + normals * (model.size[[0, 0, 1, 1, 2, 2]] / 2)[:, None]
    checked = 0
    for camera, labels in zip(case.rig, scene.labels, strict=True):
        assert labels.shape == (camera.height, camera.width)
        hull = cv2.convexHull(projected(camera, points).astype(np.float32))
        for (v, u), label in np.ndenumerate(labels):
            depth = cv2.pointPolygonTest(hull, (float(u), float(v)), True)
            assert depth > -1 if label else depth < 1
        for face, (u, v) in enumerate(np.rint(projected(camera, middles)).astype(int)):
            towards = camera.position - middles[face]
            if normals[face] @ towards > 0.4 * np.linalg.norm(towards):
                assert labels[v, u] == model.face_labels[face]
                checked += 1
    assert checked >= len(case.rig)


@pytest.mark.parametrize("name", CASES)
def test_every_scene_is_in_the_arena_and_in_view(name):
    case = CASES[name]
    arena = case.rig.arena
    for model in case.objects:
        on_stage = case.on_stage(model)
        for seed in range(40):
            (state,) = bare_scene(on_stage, np.random.default_rng(seed)).objects
            position, rotation = case.placement.pose(state.position, state.rotation)
            assert np.hypot(*(position[:2] - arena.center)) < arena.radius
            assert 0 < position[2] - arena.table < arena.height
            points = corners(model.size) @ rotation.T + position
            assert points[:, 2].min() > arena.table - 1e-12
            inside = 0
            for camera in case.rig:
                pixels = projected(camera, points)
                inside += ((pixels > -0.5) & (pixels < (camera.width - 0.5, camera.height - 0.5))).all()
            assert inside > len(case.rig) / 2


def test_a_world_that_is_moved_and_scaled_gives_the_same_pictures(rng):
    placement = Placement(0.3, 2.0, (0.7, -0.4, 0.25))
    points = rng.uniform(-0.1, 0.1, (20, 3))
    moved = np.array([placement.pose(point, np.eye(3))[0] for point in points])
    for camera in CASES["platform"].stage_cameras:
        seen = projected(placement.camera(camera), moved)
        np.testing.assert_allclose(seen, projected(camera, points), atol=1e-9)
    assert np.linalg.norm(moved[0] - moved[1]) == pytest.approx(0.3 * np.linalg.norm(points[0] - points[1]))


def test_a_scene_of_pictures_of_several_sizes_survives_the_disk():
    case = small(CASES["mixed sizes"], 40)
    cameras = tuple(camera.resized(40 + 2 * k, 30) for k, camera in enumerate(case.stage_cameras))
    assert_survives(rig_scene(dataclasses.replace(case, stage_cameras=cameras), case.objects[0], 5, 3))


def test_a_smoke_run_of_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(CASES, "large box", small(CASES["large box"], 200))
    out = tmp_path / "out"
    arguments = ("--scenes", 1, "--seed", 5, "--workers", 1, "--cache", tmp_path / "cache", "-o", out)
    printed_by("accuracy", "--only", "rig: large box", *arguments)
    frame = read_results(out).frames["accuracy"]
    assert frame[["group", "object"]].to_numpy().tolist() == [["rig: large box", "box_100"]]
    assert frame.ratio[0] > 0
