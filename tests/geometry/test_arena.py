import dataclasses
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tracker
from synthetic.camera.rigs import perturbed_rig, sized
from tests.helpers import make_camera
from tracker import Arena, CameraRig
from tracker.calibration.rig import ARENA_FILE, read_arena
from tracker.errors import CalibrationError
from tracker.geometry.arena import LARGEST, LARGEST_STD

ELSEWHERE = Arena((0.7, -0.4), 0.06, 0.05, 0.25, (0.001, 0.002))

PLACES = st.floats(-7e3, 7e3)
POSITIVE = st.floats(min_value=0.0, max_value=LARGEST, exclude_min=True)
ARENAS = st.builds(
    Arena,
    st.tuples(PLACES, PLACES),
    POSITIVE,
    POSITIVE,
    st.none() | st.floats(-1e4, 1e4),
    st.tuples(*(st.floats(0.0, most) for most in LARGEST_STD)),
)


def make_rig(arena: Arena = ELSEWHERE) -> CameraRig:
    return CameraRig((make_camera(60), make_camera(180)), arena)


def test_numbers_of_any_kind_become_floats():
    arena = Arena(np.array([1, 2]), np.float32(0.5), 1, Fraction(1, 4), [0, np.int64(1)])
    assert arena == Arena((1.0, 2.0), 0.5, 1.0, 0.25, (0.0, 1.0))
    numbers = [*arena.center, arena.radius, arena.height, arena.table, *arena.table_std]
    assert all(type(number) is float for number in numbers)
    assert hash(arena) == hash(Arena((1, 2), 0.5, 1, 0.25, (0, 1)))


@pytest.mark.parametrize(
    ("key", "values", "valid"),
    [
        ("center", [(0.0,), (0.0,) * 3, 0.0, "12", None, (0.0, math.nan), np.eye(2)], "two finite numbers"),
        ("radius", [0, -0.1, 235], "more than 0 and at most 10 metres"),
        ("radius", [math.inf, "0.2", True, 10**400], "a finite number"),
        ("height", [0.0, 185.0], "more than 0 and at most 10 metres"),
        ("height", [(0.1,)], "a finite number"),
        ("table", [math.nan, "here"], "a finite number"),
        ("table", [1e17, -1.1e4], "at most 10000 metres from the world's origin"),
        ("center", [(1e300, 1e300), (0.0, -1.1e4)], "at most 10000 metres from the world's origin"),
        ("table_std", [(0.01, -0.01)], "standard deviations from 0 to 1 metre and 1.6 rad"),
        ("table_std", [(8.0, 0.02), (0.01, 2.0)], "standard deviations from 0 to 1 metre and 1.6 rad"),
        ("table_std", [(0.01,), (0.01, math.inf), (0.01, False)], "two finite numbers"),
    ],
)
def test_an_impossible_value_is_named(key, values, valid):
    for value in values:
        with pytest.raises(CalibrationError, match=rf"^arena: {key}: found .*, expected {valid}$"):
            Arena(**{key: value})


def test_the_arena_holds_what_is_not_beside_or_above_it_or_below_its_table():
    arena, place = Arena(), np.array([0.02, -0.03, 0.0325])
    assert arena.holds(place, 0.0)
    assert arena.holds(place, arena.lowest)
    assert not arena.holds(place, arena.lowest - 1e-3)
    for beyond in ([0.3, 0.0, 0.03], [0.0, -0.26, 0.03], [0.0, 0.0, 0.25]):
        assert not arena.holds(np.array(beyond), 0.0)


def test_a_height_or_tilt_that_is_uncertain_may_be_off_by_as_much_and_no_table_be_at_any_height():
    uncertain, place = Arena(table_std=(0.003, 0.01)), np.array([0.0, 0.0, 0.02])
    assert not uncertain.holds(place, -0.0065)
    assert uncertain.holds(place, -0.0065, 0.002)
    assert not uncertain.holds(place, -0.0075, 0.002)
    for away, low in ((0.0, -0.0021), (0.1, -0.0064), (0.2, -0.0123)):
        for more, held in ((2e-4, True), (0.0, False)):
            place = np.array([0.0, away, 0.03])
            assert Arena(table_std=(0.001, 0.03)).holds(place, low + more) == held
    without = Arena(table=None, height=0.2, table_std=(0.0, 0.0))
    for z, held in ((0.19, True), (0.21, False), (-0.19, True), (-0.21, False)):
        assert without.holds(np.array([0.0, 0.0, z]), z - 0.03) == held


@given(ARENAS)
def test_every_arena_survives_its_file(tmp_path_factory, arena):
    folder = tmp_path_factory.getbasetemp() / "arena"
    CameraRig((make_camera(60),), arena).save(folder)
    assert read_arena(folder) == arena


def test_a_rig_is_saved_and_loaded_with_its_arena_and_a_folder_saved_again_keeps_none_of_old(tmp_path):
    platform = Arena((0.0, 0.0), 0.235, 0.185, 0.0, (0.008, 0.017))
    assert CameraRig((make_camera(60),)).arena == platform == tracker.Arena()
    for arena in (ELSEWHERE, Arena(radius=0.1), Arena(), ELSEWHERE):
        make_rig(arena).save(tmp_path)
        assert CameraRig.load(tmp_path).arena == arena
        assert (tmp_path / ARENA_FILE).exists() == (arena != Arena())
    assert CameraRig.load(tmp_path, pattern="*60.yml").arena == ELSEWHERE
    assert CameraRig.load(tmp_path / "camera60.yml").arena == ELSEWHERE
    assert CameraRig.load([tmp_path / "camera180.yml", tmp_path / "camera60.yml"]).arena == ELSEWHERE
    (tmp_path / ARENA_FILE).write_text("table = 1  # m\n")
    assert CameraRig.load(tmp_path).arena == Arena(table=1.0)
    make_rig().save(tmp_path / "b")
    files = [tmp_path / "camera60.yml", tmp_path / "b" / "camera180.yml"]
    assert CameraRig.load(files).arena == Arena()  # several folders have none in common


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"radios = 0.2", "found unknown key 'radios', expected some of center, radius, height, table"),
        (b"radius = 'wide'", "arena: radius: found 'wide', expected a finite number"),
        (b"center = [0.0]", r"arena: center: found a list of 1, expected two finite numbers"),
        (b"[arena]\nradius = 1", "found unknown key 'arena'"),
        (b"radius: 0.2", "not a TOML file"),
        (b"\xff", "not a TOML file"),
        (b"table = " + b"1" * 10_000, "(not a TOML file|expected a finite number)"),
        (b"center = " + b"[" * 90_000, "not a TOML file"),
        (b"center = " + b"[" * 100_000, "cannot be read: found more than 100000 bytes"),
    ],
)
def test_a_malformed_file_is_named_with_its_fault(content, fault, tmp_path):
    make_rig().save(tmp_path)
    (tmp_path / ARENA_FILE).write_bytes(content)
    with pytest.raises(CalibrationError, match=rf"arena\.toml: {fault}"):
        CameraRig.load(tmp_path)


def test_a_file_that_cannot_be_read_or_written_is_named(tmp_path):
    make_rig(Arena()).save(tmp_path)
    (tmp_path / ARENA_FILE).symlink_to("nowhere")
    with pytest.raises(CalibrationError, match=r"arena\.toml: cannot be read"):
        CameraRig.load(tmp_path)
    (tmp_path / ARENA_FILE).unlink()
    (tmp_path / ARENA_FILE).mkdir()
    with pytest.raises(CalibrationError, match=r"arena\.toml: cannot be read"):
        CameraRig.load(tmp_path)
    for arena in (Arena(), ELSEWHERE):
        with pytest.raises(CalibrationError, match=r"arena\.toml: cannot be written"):
            make_rig(arena).save(tmp_path)


def test_a_rig_made_of_a_rig_keeps_the_arena(rng):
    rig = make_rig()
    assert dataclasses.replace(make_rig(Arena()), arena=ELSEWHERE).arena == ELSEWHERE
    assert dataclasses.replace(rig, cameras=rig.cameras[:1]).arena == ELSEWHERE
    assert rig.resized(540, 270).arena == ELSEWHERE
    assert sized(rig, 90).arena == ELSEWHERE
    assert perturbed_rig(rng).arena == Arena()
    with pytest.raises(CalibrationError, match=r"camera rig: arena: found None, expected Arena"):
        make_rig(None)  # type: ignore[arg-type]
