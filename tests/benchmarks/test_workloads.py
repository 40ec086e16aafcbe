import dataclasses
import re
import sys

import numpy as np
import pytest

from benchmarks.data import disturbances, fingerprint, scenes, workloads
from benchmarks.data.plan import DEVELOPMENT, FULL, SHARES, Plan, release, stream
from benchmarks.data.recorded import another
from benchmarks.data.scenes import SIZE, Scene, rig, scene_store
from benchmarks.data.workloads import BY_NAME, case
from benchmarks.measure.accuracy import signature
from tests.benchmarks.made_up import assert_survives
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.calibration.deviations import rotation_vector_variance
from tracker.geometry import so3


def scene(rng, index=0):
    images = tuple(rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8) for _ in range(3))
    labels = tuple(rng.integers(0, 7, (SIZE, SIZE), dtype=np.uint8) for _ in range(3))
    seen = np.array([0.2, 0.5, 0.8])
    return Scene(images, seen, np.zeros(3), np.eye(3), index=index, labels=labels)


@pytest.mark.parametrize("name", ["light", "hard_light", "poor_images", "slightly_poor"])
def test_a_disturbance_is_seeded_and_of_each_camera_by_itself(name):
    grey = [np.full((64, 64, 3), 100, np.uint8)] * 2
    first, again = (getattr(disturbances, name)(grey, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert first[0].dtype == np.uint8
    assert (grey[0] == 100).all()


def test_light_stays_within_what_it_says_and_a_slight_blur_is_the_same_for_all(rng):
    grey = [np.full((16, 16, 3), 100, np.uint8)] * 200
    values = np.array(disturbances.light(grey, rng))[:, 0, 0]
    assert values.min() >= 0.8 * 0.6 * 100 - 1
    assert values.max() <= 1.2 * 1.4 * 100 + 1
    ramps = [disturbances._ramp((60, 80), disturbances._slope(rng)) for _ in range(50)]
    assert max(np.abs(ramp - 1).max() for ramp in ramps) <= 0.35 + 1e-12
    image = rng.integers(0, 256, (32, 32, 3), dtype=np.uint8)
    once, again = (disturbances.slight_blur([image], np.random.default_rng(seed))[0] for seed in (1, 2))
    np.testing.assert_array_equal(once, again)
    assert once.std() < image.std()


def test_a_moved_rig_states_by_how_much(rng):
    true = rig()
    shifts, turns = [], []
    for _ in range(400):
        moved = disturbances.moved_rig(true, rng)
        a, b = true[0].camera_from_world, moved[0].camera_from_world
        shifts.append(b[:3, 3] - a[:3, 3])
        turns.append(so3.log(b[:3, :3] @ a[:3, :3].T))
    np.testing.assert_allclose(np.std(shifts, axis=0), disturbances.SHIFT_STD, rtol=0.15)
    np.testing.assert_allclose(np.std(turns, axis=0), disturbances.TURN_STD, rtol=0.15)
    std = moved[0].camera_from_world_std
    assert std is not None
    variances = rotation_vector_variance(moved[0].camera_from_world[:3, :3], std[:3, :3])
    np.testing.assert_allclose(np.sqrt(variances), disturbances.TURN_STD, rtol=1e-6)
    np.testing.assert_array_equal(std[:3, 3], disturbances.SHIFT_STD)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_cameras_take_turns(rng, count):
    workload = next(w for w in workloads.WORKLOADS if w.cameras == (None if count == 3 else count))
    seen = [case(workload, "cube_v2", scene(rng, k), rig(), 1) for k in range(6)]
    assert all(len(c.used) == count for c in seen)
    assert sorted(k for c in seen for k in c.used) == sorted(list(range(3)) * (2 * count))
    assert seen[0].visible == pytest.approx(np.mean(seen[0].scene.visible_fraction[list(seen[0].used)]))


@pytest.mark.parametrize("name", BY_NAME)
def test_a_case_depends_on_workload_and_scene_alone(rng, name, request):
    if name == "other calibration":
        request.getfixturevalue("real")
    one, other = scene(rng, 5), scene(rng, 4)
    a, b = (case(BY_NAME[name], "cube_v2", one, rig(), 1, other) for _ in range(2))
    assert all(map(np.array_equal, a.images, b.images))
    for x, y in zip(a.rig, b.rig, strict=True):
        assert np.array_equal(x.camera_from_world, y.camera_from_world)


@pytest.mark.parametrize("name", ["flooded", "black", "other moment"])
def test_a_fault_is_of_one_camera(rng, name):
    one, other = scene(rng, 2), scene(rng, 3)
    seen = set()
    for index in range(12):
        given = case(BY_NAME[name], "cube_v2", dataclasses.replace(one, index=index), rig(), 1, other)
        changed = [k for k in range(3) if not np.array_equal(given.images[k], one.images[k])]
        assert len(changed) == 1
        seen.update(changed)
        if name == "other moment":
            assert np.array_equal(given.images[changed[0]], other.images[changed[0]])
    assert seen == {0, 1, 2}


def test_swapped_cameras_hold_each_others_pictures(rng):
    one = scene(rng)
    given = case(BY_NAME["swapped"], "cube_v2", one, rig(), 1)
    same = [[np.array_equal(a, b) for b in one.images] for a in given.images]
    assert np.sum(same) == 3
    assert np.trace(same) == 1


def test_another_robots_calibration_is_off_by_what_two_robots_differ(real):
    true = rig()
    for seed in range(5):
        believed = another(true, np.random.default_rng(seed))
        points = np.array([[0.0, 0.0, 0.03], [0.1, 0.0, 0.03], [0.0, -0.1, 0.03]])
        off = [a.project(points) - b.project(points) for a, b in zip(true, believed, strict=True)]
        assert 1 < np.linalg.norm(off, axis=-1).max() < 60


def test_every_effect_and_every_look_alike_is_a_workload_and_every_set_of_scenes_has_a_share():
    from synthetic.effects import NAMES
    from synthetic.world.look_alikes import KINDS

    assert {f"effect: {name}" for name in NAMES if name != "timing"} < set(BY_NAME)
    assert {f"look-alike: {kind}" for kind in KINDS} < set(BY_NAME)
    assert len(KINDS) >= 8
    plan = Plan(FULL)
    for workload in workloads.WORKLOADS:
        assert 4 <= plan.count(workload.base) <= FULL
    assert plan.count("realistic") == plan.count("world") == FULL >= 200
    assert all(Plan(1).count(base) == 1 for base in ("realistic", "world", "rig: platform"))
    assert set(SHARES) >= {"film", "motion", "thrown", "laid"}


def test_a_scene_survives_the_disk_and_cameras_that_are_not_as_stated_go_with_it(rng):
    usual, moved = rig(), disturbances.moved_rig(rig(), rng)
    rows = np.stack([scenes.rows_of(usual), scenes.rows_of(moved)])
    one = dataclasses.replace(scene(rng), cameras=rows)
    for before in (scene(rng), dataclasses.replace(one, position=None, rotation=None)):
        assert_survives(before)
    given = case(BY_NAME["world"], "cube_v2", one, usual, 1)
    for found, expected in ((given.true_rig, usual), (given.rig, moved)):
        for a, b in zip(found, expected, strict=True):
            for part in ("matrix", "distortion", "camera_from_world", "camera_from_world_std"):
                assert np.array_equal(getattr(a, part), getattr(b, part))
    exact = case(BY_NAME["realistic"], "cube_v2", scene(rng), usual, 1)
    assert exact.rig is exact.true_rig is usual


def test_the_signature_tells_pictures_apart(rng):
    images = [rng.integers(20, 230, (SIZE, SIZE, 3)).astype(np.uint8) for _ in range(3)]
    own = signature(images)
    level = [image.copy() for image in images]
    level[1][5, 5, 0] += 1
    noisy = [image + rng.integers(0, 2, image.shape).astype(np.uint8) for image in images]
    assert abs(signature(level) - own) < 0.01
    assert abs(signature(noisy) - own) > 0.1
    assert abs(signature([images[0], None, images[2]]) - own) > 0.1


def test_pictures_are_made_by_code_that_the_renderer_imports_and_by_neither_words_nor_anything_else():
    code = b'"""What."""\ndef f(x):\n    """Doc."""\n    # why\n    return x + 1\n'
    assert fingerprint.code(code) == fingerprint.code(b"def f(x):\n    return x + 1\n")
    assert fingerprint.code(code) != fingerprint.code(b"def f(x):\n    return x + 2\n")
    sources = fingerprint.sources(["benchmarks.data.scenes"])
    files = {str(path.relative_to(fingerprint.ROOT)) for path in sources}
    assert {"benchmarks/data/scenes.py", "synthetic/frames.py", "synthetic/camera/sensor.py"} <= files
    assert {"synthetic/look/data/face_colors.json", "tracker/objects/data/cube_v2.toml"} <= files
    assert "tracker/geometry/camera.py" in files
    for other in ("synthetic/export/", "synthetic/cli.py", "benchmarks/data/store.py", "tracker/pose/"):
        assert not any(file.startswith(other) for file in files)
    named = re.compile(r"^ *(?:import|from) (\w+)(?:[\w.]* import .*| as \w+)?$", re.MULTILINE)
    used = {
        name for file in sources if file.suffix == ".py" for name in named.findall(file.read_text("utf-8"))
    }
    # Those of files of settings draw nothing.
    used -= {*sys.stdlib_module_names, *fingerprint.PROJECT, "yaml", "tomli"}
    assert {{"cv2": "opencv-python-headless"}.get(name, name) for name in used} == {*fingerprint.LIBRARIES}


def test_no_two_kinds_of_scenes_and_no_two_commits_share_a_seed():
    names = [("scenes", "a", "b"), ("scenes", "a", "c"), ("films", "a"), ("scenes", "ab"), ("films", "b")]
    seeds = {stream(seed, *name) for seed in (1, 2, DEVELOPMENT) for name in names}
    assert len(seeds) == 3 * len(names)
    assert stream(1, "films", "a") == stream(1, "films", "a")
    assert release("a" * 40) == release("a" * 40)
    assert len({release("a" * 40), release("b" * 40), DEVELOPMENT}) == 3


@pytest.mark.usefixtures("sketched")
def test_scenes_do_not_depend_on_the_cache(tmp_path):
    skip_without_platform()
    plan = Plan(seed=5, workers=1, cache=tmp_path)
    store = scene_store("cube_v2", "realistic", plan)
    first = [(s.index, *s.visible_fraction) for s in store.scenes([0, 3])]
    # Broken and from the cache, in another order.
    next(tmp_path.rglob("00003.npz")).write_bytes(b"broken")
    fresh = scene_store("cube_v2", "realistic", plan)
    again = [(s.index, *s.visible_fraction) for s in fresh.scenes([3, 0])]
    assert again == first[::-1]
