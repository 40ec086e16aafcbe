"""The rigs of the benchmark: their truth by OpenCV alone, their arenas, and the table."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.data import rig_scenes, scenes
from benchmarks.data.films import SEED as FILM_SEED
from benchmarks.data.rig_cases import CASES, Placement, RigCase
from benchmarks.data.rig_scenes import DEVELOPMENT_SEED, RigScene, RigSceneStore, rig_scene
from benchmarks.measure.rigs import Answer, RigOptions, row
from benchmarks.report.rigs_tables import rigs_markdown, rigs_table
from benchmarks.score.errors import projected
from benchmarks.score.records import read_results
from synthetic.raycast.scene import random_scene
from tracker.geometry.cuboid import FACE_NORMALS, corners

WITHOUT_FINGERS = 0
"""A scene's number."""


def small(case: RigCase, width: int = 120) -> RigCase:
    """The same rig with pictures of about this width, which are quick to render."""
    cameras = [
        camera.resized(width, max(1, round(camera.height * width / camera.width)))
        for camera in case.stage_cameras
    ]
    return dataclasses.replace(case, stage_cameras=tuple(cameras))


@pytest.mark.parametrize("name", CASES)
def test_the_truth_projects_onto_its_labels(name):
    case = small(CASES[name])
    model = case.objects[-1]
    scene = rig_scene(case, model, 5, WITHOUT_FINGERS)
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
        for seed in range(100):
            scene = random_scene(on_stage, np.random.default_rng(seed), occlusion=0)
            position, rotation = case.placement.pose(scene.position, scene.rotation)
            assert np.hypot(*(position[:2] - arena.center)) < arena.radius
            assert 0 < position[2] - arena.table < arena.height
            points = corners(model.size) @ rotation.T + position
            assert points[:, 2].min() > arena.table - 1e-12
            inside = [
                ((pixels > -0.5) & (pixels < (camera.width - 0.5, camera.height - 0.5))).all()
                for camera in case.rig
                for pixels in [projected(camera, points)]
            ]
            assert sum(inside) > len(inside) / 2


def test_a_world_that_is_moved_and_scaled_gives_the_same_pictures(rng):
    placement = Placement(0.3, 2.0, (0.7, -0.4, 0.25))
    points = rng.uniform(-0.1, 0.1, (20, 3))
    moved = np.array([placement.pose(point, np.eye(3))[0] for point in points])
    for camera in CASES["platform"].stage_cameras:
        np.testing.assert_allclose(
            projected(placement.camera(camera), moved), projected(camera, points), atol=1e-9
        )
    assert np.linalg.norm(moved[0] - moved[1]) == pytest.approx(0.3 * np.linalg.norm(points[0] - points[1]))


def test_a_scene_of_pictures_of_several_sizes_survives_the_disk():
    case = small(CASES["mixed sizes"], 40)
    cameras = tuple(camera.resized(40 + 2 * k, 30) for k, camera in enumerate(case.stage_cameras))
    scene = rig_scene(dataclasses.replace(case, stage_cameras=cameras), case.objects[0], 5, 3)
    again = RigScene.unpacked(scene.packed())
    for field in dataclasses.fields(RigScene):
        before, after = getattr(scene, field.name), getattr(again, field.name)
        pairs = zip(before, after, strict=True) if isinstance(before, tuple) else [(before, after)]
        assert all(np.array_equal(one, other) for one, other in pairs)


def test_what_is_judged_has_a_seed_of_its_own():
    taken = {scenes.SEED + k for k in range(100)} | {FILM_SEED, FILM_SEED + 1}
    assert rig_scenes.SEED not in taken
    assert RigOptions().seed == DEVELOPMENT_SEED != rig_scenes.SEED


def test_figures_of_a_rig():
    figures = row(
        [
            Answer(10.0, 2.0, 1.0, 0.5, 0.5, 0.9),
            Answer(20.0, 2.0, 0.5, 4.0, 4.0, 0.9),
            Answer(30.0, 2.0, 0.5, 0.2, 90.0, 0.9),
            Answer(40.0, 2.0, 0.0),
        ]
    )
    assert (figures["within_1"], figures["within_5"], figures["none"]) == (25.0, 50.0, 25.0)
    assert (figures["median_mm"], figures["median_deg"], figures["wrong_and_sure"]) == (0.5, 4.0, 25.0)
    assert (figures["median_ms"], figures["ratio"], figures["visible"]) == (25.0, 12.5, 50.0)


def test_tables_have_a_cell_for_each_heading_and_no_nan():
    nothing = [Answer(1.0, 1.0, 1.0)]
    rows = [{"rig": "platform", "object": "cube_v2", **row(nothing)}]
    table = rigs_table(rows)
    assert [len(cells) for cells in table.rows] == [len(table.heads)]
    text = "\n\n".join(rigs_markdown({"about": {"seed": 1, "scenes": 1}, "rows": rows}))
    assert "nan" not in text
    assert "three 270×270" in text


def test_a_smoke_run_of_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(CASES, "large box", small(CASES["large box"], 200))
    out, cache = tmp_path / "out", tmp_path / "cache"
    arguments = ["rigs", "--only", "large box", "--scenes", "1", "--seed", "5", "--workers", "1"]
    done = CliRunner().invoke(
        main, [*arguments, "--cache", str(cache), "-o", str(out)], catch_exceptions=False
    )
    assert done.exit_code == 0
    assert "## Other rigs" in done.output
    rigs = read_results(out)["rigs"]
    assert rigs["about"] == {"seed": 5, "scenes": 1}
    assert [(part["rig"], part["object"], part["scenes"]) for part in rigs["rows"]] == [
        ("large box", "box_100", 1)
    ]
    (file,) = cache.rglob("*.npz")
    file.write_bytes(b"broken")
    store = RigSceneStore("large box", "box_100", 5, 1, cache)
    assert next(store.scenes([0])).images[0].shape == (200, 200, 3)
