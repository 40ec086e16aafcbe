from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.random import default_rng

pytest.importorskip("pybullet", reason="platform: no module pybullet")
pytest.importorskip("trimesh", reason="platform: no module trimesh")

import trimesh

from synthetic.look.appearance import random_look
from synthetic.world import kinematics, meshes
from synthetic.world.kinematics import TIP_RADIUS
from synthetic.world.motion import CUBOID_MOTIONS, DICE_MOTIONS, film
from synthetic.world.placement import MAX_CLEARANCE, goal_cells, random_place
from synthetic.world.platform import ARENA_RADIUS, Platform
from synthetic.world.scenes import random_scene
from tests.helpers.stills import platform as platform_of
from tracker import load_object
from tracker.errors import TrackerError
from tracker.geometry import so3
from tracker.geometry.cuboid import FACE_NORMALS, corners

NAMES = ("cube_v2", "cuboid_2x2x8_v2", "dice")


@pytest.fixture
def armless(monkeypatch):
    """Scenes lack the robot's bodies, which take longest to make."""
    for name in NAMES:
        monkeypatch.setattr(platform_of(name), "_robot_meshes", {})


def all_corners(platform, scene):
    """(N, 8, 3) [m] in the world's frame."""
    return np.stack([corners(platform.size) @ s.rotation.T + s.position for s in scene.objects])


def sequence(platform, rng, **options):
    """Time stamps [s], from 0, and the scenes at exactly these times."""
    return ((stamp, scene_at(stamp)) for stamp, scene_at in film(platform, rng, **options))


def depth(platform, scene):
    """Greatest depth [m] to which a finger is inside an object; negative: the gap, at most 20 mm."""
    world, farthest = platform.world, 2 * TIP_RADIUS
    world.set_objects(scene.objects)
    world.set_joints(scene.robot_position)
    found = [gap for body in world.objects for gap in world.near(body, farthest)]
    return -min(found, default=farthest)


def assert_equal(first, second):
    np.testing.assert_equal(asdict(first), asdict(second))


@pytest.mark.parametrize("name", NAMES)
def test_the_same_generator_gives_the_same_scene_whatever_came_before(name):
    platform = platform_of(name)
    kind = "dice_thrown" if name == "dice" else "thrown"
    first = random_scene(platform, default_rng(5), kind=kind)
    random_scene(platform, default_rng(6))
    assert_equal(first, random_scene(platform, default_rng(5), kind=kind))
    with Platform(name) as other:
        assert_equal(first, random_scene(other, default_rng(5), kind=kind))


@pytest.mark.parametrize("name", NAMES)
def test_objects_are_in_the_arena_and_free_of_fingers(name):
    platform = platform_of(name)
    for seed in range(8 if name == "dice" else 40):
        scene = random_scene(platform, default_rng(seed), near=1.0)
        points = all_corners(platform, scene)
        assert points[..., 2].min() > -1e-9
        assert np.hypot(points[..., 0], points[..., 1])[points[..., 2] < 0.03].max(initial=0) < 0.196
        assert depth(platform, scene) < 0
        if scene.about["kind"] in ("rest", "tilted"):
            assert points[..., 2].min() < 1e-9
            assert np.hypot(points[..., 0], points[..., 1]).max() < ARENA_RADIUS
        if scene.about["kind"] == "air":
            assert points[..., 2].min() <= MAX_CLEARANCE


@pytest.mark.parametrize("name", ["cube_v2", "cuboid_2x2x8_v2"])
def test_resting_objects_are_level_on_every_face(name):
    faces = set()
    for seed in range(40):
        scene = random_scene(platform_of(name), default_rng(seed), kind="rest", near=None)
        (state,) = scene.objects
        heights = np.abs(state.rotation[2])
        assert heights.max() == pytest.approx(1.0, abs=1e-9)
        faces.add(scene.about["face_up"])
        axis = int(np.argmax(heights))
        assert np.sign(state.rotation[2, axis]) == (1 if scene.about["face_up"] % 2 == 0 else -1)
    assert faces == set(range(6))


def test_objects_are_tilted_about_both_edges_below_every_face():
    tilted = set()
    for seed in range(120):
        scene = random_scene(platform_of("cuboid_2x2x8_v2"), default_rng(seed), kind="tilted", near=None)
        heights = np.abs(scene.objects[0].rotation[2])
        assert heights.min() == pytest.approx(0.0, abs=1e-9)
        tilted.add((scene.about["face_up"], int(heights.argmin())))
    assert len(tilted) == 12


def test_fingers_come_near_when_they_are_to_and_are_absent_when_they_are_to():
    platform = platform_of("cube_v2")
    near = [random_scene(platform, default_rng(seed), near=1.0).about for seed in range(20)]
    assert np.mean([sum(about["fingers_near"]) for about in near]) > 1.5
    scene = random_scene(platform, default_rng(0), near=None)
    assert not [body for body in scene.bodies if "finger" in body.name]


def apart(platform, scene):
    """Least distance [m] of two dice along one of the axes; negative: they may overlap."""
    points = all_corners(platform, scene)
    low, high = points.min(axis=1), points.max(axis=1)
    gaps = (low[:, None] - high).max(axis=-1)
    return np.maximum(gaps, gaps.T)[~np.eye(len(low), dtype=bool)].min()


def test_dice_are_numbered_and_have_brighter_pips_and_a_goal_lies_on_the_grid():
    for seed in range(5):
        scene = random_scene(platform_of("dice"), default_rng(seed), kind="dice_goal")
        dice = [body for body in scene.bodies if body.labels.any()]
        assert [body.labels.tolist() for body in dice] == [[number, number] for number in range(1, 26)]
        for blue, pips in (body.colors for body in dice):
            assert pips.min() > 0.4
            assert blue[2] < 0.1 * pips[2]
        places = np.stack([state.position[:2] for state in scene.objects])
        distance = np.linalg.norm(places[:, None] - goal_cells(), axis=2).min(axis=1)
        assert distance.max() < 0.007
        assert apart(platform_of("dice"), scene) > -1e-9


@pytest.mark.parametrize("seed", range(3))
def test_dice_that_fall_begin_apart(armless, seed):
    _, scene = next(sequence(platform_of("dice"), default_rng(seed), seconds=0.1, kind="drop"))
    assert apart(platform_of("dice"), scene) > -1e-9


def test_a_die_is_a_closed_cube_whose_opposite_faces_have_7_pips():
    size, diameter = 0.022, 0.0034
    mesh = meshes.die(size, 0.0044, diameter)
    solid = trimesh.Trimesh(mesh.vertices, mesh.triangles)
    # Closed, with equal vertices made one: no triangle ends in the middle of another's side.
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume == pytest.approx(size**3)
    assert solid.area == pytest.approx(6 * size**2)
    np.testing.assert_allclose(np.abs(solid.face_normals).max(axis=1), 1.0)
    pip = np.pi * diameter**2 / 4
    areas = np.where(mesh.groups == 1, solid.area_faces, 0.0)
    shown = (FACE_NORMALS @ solid.face_normals.T > 0.5) @ areas
    np.testing.assert_allclose(shown / pip, [1, 6, 2, 5, 3, 4])
    # Each face has corners of its own, for the sake of smooth shading.
    for vertex in np.unique(mesh.triangles):
        normals = solid.face_normals[(mesh.triangles == vertex).any(axis=1)]
        assert np.ptp(normals, axis=0).max() < 1e-9


def test_what_surrounds_an_object_does_not_depend_on_it():
    rngs = [default_rng(7) for _ in NAMES]
    looks = [random_look(rng, platform_of(name).model) for rng, name in zip(rngs, NAMES, strict=True)]
    for part in ("robot", "table", "wall", "floor", "cross", "gloss"):
        for look in looks[1:]:
            np.testing.assert_array_equal(getattr(look, part), getattr(looks[0], part))
    assert len({rng.random() for rng in rngs}) == 1


def test_objects_larger_than_the_arena_and_unknown_kinds_are_refused():
    platform, rng = platform_of("cube_v2"), default_rng(0)
    with pytest.raises(TrackerError, match=r"diagonal of 0\.433 m, expected less than the arena's 0\.38 m"):
        random_place(rng, np.full(3, 0.25), np.eye(3))
    with pytest.raises(TrackerError, match=r"dice_goal.*expected one of rest"):
        random_scene(platform, rng, kind="dice_goal")
    with pytest.raises(TrackerError, match=r"fly.*expected one of push"):
        sequence(platform, rng, seconds=1.0, kind="fly")
    with pytest.raises(TrackerError, match="expected one of push"):
        sequence(platform_of("dice"), rng, seconds=1.0, kind="carry")


MOTIONS = [(name, kind) for name in NAMES for kind in (DICE_MOTIONS if name == "dice" else CUBOID_MOTIONS)]


@pytest.mark.parametrize(("name", "kind"), MOTIONS)
def test_motion_is_continuous_and_possible(armless, name, kind):
    platform = platform_of(name)
    seconds, rate = (0.6 if name == "dice" else 3.0), 120.0
    steps = list(sequence(platform, default_rng(1), seconds=seconds, rate=rate, kind=kind, jitter=0))
    positions = np.array([[state.position for state in scene.objects] for _, scene in steps])
    rotations = np.array([[state.rotation for state in scene.objects] for _, scene in steps])
    joints = np.array([scene.robot_position for _, scene in steps])
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=2) * rate
    turn = so3.angle_between(rotations[:-1], rotations[1:]) * rate
    held = np.array([bool(scene.about["fingers_hold"]) for _, scene in steps])
    driven = held[1:] & held[:-1]
    # Falling from 0.1 m ends at 1.4 m/s, and what then lands on an edge turns quickly.
    assert speed.max() < 2.0
    assert turn.max() < 60.0
    assert speed[driven].max(initial=0.0) < 0.3
    assert turn[driven].max(initial=0.0) < np.radians(200)
    assert np.abs(np.diff(joints, axis=0)).max() * rate < 8.0
    for _, scene in steps[::15]:
        assert depth(platform, scene) < 0.001
        points = all_corners(platform, scene)
        assert points[..., 2].min() > -1e-9
        assert np.hypot(points[..., 0], points[..., 1])[points[..., 2] < 0.03].max(initial=0) < 0.197


def test_the_same_generator_gives_the_same_motion():
    platform = platform_of("cube_v2")
    both = (sequence(platform, default_rng(3), seconds=3.0, kind="mixed") for _ in range(2))
    for (time, scene), (other_time, other) in zip(*map(list, both), strict=True):
        assert time == other_time
        assert_equal(scene, other)


def test_an_object_is_carried_through_the_air_by_fingers_that_touch_it(armless):
    platform = platform_of("cube_v2")
    steps = list(sequence(platform, default_rng(2), seconds=4.0, kind="carry"))
    heights = [all_corners(platform, scene)[..., 2].min() for _, scene in steps]
    assert max(heights) > 0.02
    gaps = [-depth(platform, scene) for _, scene in steps if scene.about["fingers_hold"]]
    assert len(gaps) > 20
    assert max(gaps) < 0.003
    for _, scene in steps:
        (state,) = scene.objects
        for tip in kinematics.tips(scene.robot_position)[scene.about["fingers_hold"]]:
            beside = np.abs((tip - state.position) @ state.rotation) - platform.size / 2
            assert beside.max() < TIP_RADIUS + 0.003


def test_a_long_object_is_carried_within_the_wall(monkeypatch):
    platform = platform_of(replace(load_object("cube_v2"), size=np.array([0.3, 0.03, 0.03])))
    monkeypatch.setattr(platform, "_robot_meshes", {})
    for _, scene in sequence(platform, default_rng(0), seconds=3.0, rate=20.0, kind="carry", jitter=0):
        assert np.hypot(*all_corners(platform, scene)[..., :2].T).max() < 0.2


def test_stamps_jitter_about_the_rate_and_pictures_are_dropped():
    def stamps(**more):
        options = {"seconds": 1.2, "rate": 100.0, "kind": "push", **more}
        return np.array([time for time, _ in film(platform_of("cube_v2"), default_rng(0), **options)])

    np.testing.assert_allclose(stamps(jitter=0.0), np.arange(120) / 100, atol=1e-12)
    jittered = stamps(jitter=0.002)
    assert (np.diff(jittered) > 0).all()
    assert 0.001 < np.diff(jittered).std() < 0.003
    dropped = stamps(dropped=0.3)
    assert dropped[0] == 0
    assert 60 < len(dropped) < 105
