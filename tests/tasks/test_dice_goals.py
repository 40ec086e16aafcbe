import json
import math
import os
import string
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers import RIG
from tracker.errors import TaskError
from tracker.tasks import rearrange_dice as dice
from tracker.tasks.job_goal import read_job_goal
from tracker.tasks.rearrange_dice.goals import MAX_FILE_SIZE

SEEDS = st.integers(0, 2**32)
COORDINATES = st.floats(-0.3, 0.3)


def beyond(x: float, y: float) -> float:
    """By how much the farthest corner of a die is out of the arena [m]."""
    return math.hypot(abs(x) + 0.011, abs(y) + 0.011) - 0.19


def test_cells_are_those_of_a_grid_whose_corners_are_in_the_arena():
    steps = [0.022 * k for k in range(-8, 9)]
    expected = [(x, y, 0.011) for x in steps for y in steps if beyond(x, y) <= 0]
    np.testing.assert_allclose(dice.cells(), expected, atol=1e-12)


@given(SEEDS)
def test_a_sampled_goal_is_25_different_cells_and_valid(seed):
    goal = dice.sample_goal(seed)
    assert goal.shape == (25, 3)
    assert len(np.unique(goal, axis=0)) == 25
    assert {tuple(place) for place in goal} <= {tuple(cell) for cell in dice.cells()}
    np.testing.assert_array_equal(dice.validate_goal(goal), goal)


def test_a_seed_decides_the_goal_and_a_generator_moves_on():
    np.testing.assert_array_equal(dice.sample_goal(3), dice.sample_goal(np.random.default_rng(3)))
    rng = np.random.default_rng(3)
    assert (dice.sample_goal(rng) != dice.sample_goal(rng)).any()
    for neither in (None, True, -1, 1.0, "1"):
        with pytest.raises(TaskError, match=r"rng: found .*expected"):
            dice.sample_goal(neither)


def test_places_may_overlap_and_what_is_returned_is_the_callers_own():
    goal = np.array([(0.0, 0.0, 0.011)] * 24 + [(0.0, 0.0, 0.033)])
    valid = dice.validate_goal(goal)
    np.testing.assert_array_equal(valid, goal)
    dice.cells()[:] = valid[:] = 0
    assert dice.cells().any()
    assert goal.any()


def test_every_cell_is_as_likely_as_any_other(rng):
    goals = np.concatenate([dice.sample_goal(rng) for _ in range(2000)])
    _, counts = np.unique(goals, axis=0, return_counts=True)
    expected = 2000 * 25 / len(dice.cells())
    assert len(counts) == len(dice.cells())
    assert np.abs(counts - expected).max() < 5 * np.sqrt(expected)


@given(st.lists(st.tuples(COORDINATES, COORDINATES, st.floats(-0.01, 0.2)), min_size=25, max_size=25))
def test_a_goal_is_valid_if_every_die_is_in_the_arena_and_above_its_floor(places):
    margins = [max(beyond(x, y), 0.011 - z) for x, y, z in places]
    if max(margins) <= 0:
        np.testing.assert_array_equal(dice.validate_goal(places), places)
    elif max(margins) > 1e-8:
        with pytest.raises(TaskError):
            dice.validate_goal(places)


@given(st.floats(0.06, math.pi / 2 - 0.06), st.integers(0, 3))
def test_rounding_does_not_invalidate_a_goal(angle, quarter):
    corner = 0.19 * np.exp(1j * (angle + quarter * math.pi / 2))
    goal = dice.sample_goal(0)
    x, y = corner.real, corner.imag
    goal[3] = x - math.copysign(0.011, x), y - math.copysign(0.011, y), 0.011
    for factor in (1.0, 1 - 1e-10, 1 + 1e-10):
        for rounded in (goal * factor, goal * factor / 3 * 3):
            np.testing.assert_array_equal(dice.validate_goal(rounded), rounded)


PLACES = dice.sample_goal(0)


@pytest.mark.parametrize(
    ("places", "message"),
    [
        (PLACES[:, :2], r"found shape \(25, 2\), expected \(N, 3\)"),
        (PLACES.ravel(), r"found shape \(75,\)"),
        (PLACES.astype(str), "found .*expected numbers"),
        (PLACES > 0, "found .*expected numbers"),
        ([[0, 0, 1j]], "found .*expected numbers"),
        ([*PLACES[:24].tolist(), [0.0]], "found a list of 25, expected numbers"),
        ("goal", "found 'goal', expected numbers"),
        ([[0, 0, 0], [0, np.nan, 0]], "found nan, expected finite"),
        ([[0, 0, np.inf]], "found inf, expected finite"),
        (np.where(np.arange(25)[:, None] == 3, 1e200, PLACES), r"found 1e\+200, expected finite"),
    ],
)
def test_what_is_no_list_of_positions_is_refused(places, message):
    for take in (dice.validate_goal, partial(dice.goal_masks, RIG), partial(dice.assign, positions=[])):
        with pytest.raises(TaskError, match=f"goal: {message}"):
            take(places)
    with pytest.raises(TaskError, match=f"dice: {message}"):
        dice.assign([], places)


@pytest.mark.parametrize(
    ("places", "message"),
    [
        (PLACES[:24], "found 24 positions, expected 25"),
        ([], "found 0 positions, expected 25"),
        (PLACES - (0, 0, 0.001), "position 0.*found the height 0.01 m, expected at least"),
        (PLACES - (0.4, 0, 0), "position 0.*its die reaches .*expected at most 0.19 m"),
    ],
)
def test_a_faulty_goal_is_refused_with_its_fault(places, message):
    with pytest.raises(TaskError, match=message):
        dice.validate_goal(places)


def same_places(a, b) -> bool:
    """Whether two goals are the same but for the order."""
    a, b = (np.array(sorted(np.round(goal, 9).tolist())) for goal in (a, b))
    return bool(np.abs(a - b).max() == 0)


def pattern_with(*changes: tuple[int, int, str]) -> str:
    """A valid pattern with characters changed at (row, column)."""
    rows = [list(row) for row in dice.pattern(PLACES).splitlines()]
    for row, column, character in changes:
        rows[row][column] = character
    return "\n".join("".join(row) for row in rows) + "\n"


@given(SEEDS)
def test_a_goal_and_its_pattern_show_each_other_and_json_keeps_every_bit(tmp_path_factory, seed):
    rng, path = np.random.default_rng(seed), tmp_path_factory.getbasetemp() / "goal"
    goal = dice.sample_goal(rng)
    text = dice.pattern(goal)
    assert same_places(dice.parse_pattern(text), goal)
    assert dice.pattern(dice.parse_pattern(text)) == text
    dice.write_goal(path.with_suffix(".txt"), goal)
    assert same_places(dice.read_goal(path.with_suffix(".txt")), goal)
    free = goal * rng.uniform(0.1, 1, (25, 1)) + [0, 0, 0.011]
    dice.write_goal(path.with_suffix(".json"), free)
    np.testing.assert_array_equal(dice.read_goal(path.with_suffix(".json")), free)
    path.with_suffix(".json").write_text(json.dumps({"_goal": free.tolist()}))  # as some jobs store it
    np.testing.assert_array_equal(dice.read_goal(path.with_suffix(".json")), free)


def test_rows_go_along_x_and_columns_along_y():
    rows = dice.empty_pattern().splitlines()
    rows[2] = f"{rows[2][:11]}X{rows[2][12:]}"
    rows[3:] = "\n".join(rows[3:]).replace(".", "X", 24).split("\n")
    goal = dice.parse_pattern("\n".join(rows))
    assert np.abs(goal - [(2 - 8) * 0.022, (11 - 8) * 0.022, 0.011]).max(axis=1).min() < 1e-12


def test_the_empty_pattern_is_the_arena():
    text = dice.empty_pattern()
    assert [len(row) for row in text.splitlines()] == [17] * 17
    assert text.count(".") == len(dice.cells())
    assert set(text) == {"#", ".", "\n"}


@pytest.mark.parametrize(
    "end", ["", "\n", "\n\nwords\n", "\n-- \nwords\n", "\n--\n", "  \n \t\nX", "\n\n\n#"]
)
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r", " \n", "\t \r\n"])
def test_text_after_the_rows_means_nothing(end, newline):
    text = pattern_with()
    goal = dice.parse_pattern(text.rstrip("\n").replace("\n", newline) + end)
    np.testing.assert_array_equal(goal, dice.parse_pattern(text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (pattern_with((0, 0, ".")), r"row 1, column 1: found '\.', expected '#' outside the arena"),
        (pattern_with((8, 4, "#")), r"row 9, column 5: found '#', expected '\.' or 'X' inside"),
        (pattern_with((8, 4, "x")), "row 9, column 5: found 'x'"),
        (pattern_with((8, 4, "\0")), r"row 9, column 5: found '\\x00'"),
        (pattern_with()[18:], "row 1"),
        (pattern_with()[:-18], "found 16 rows, expected 17"),
        ("", "found 0 rows"),
        (pattern_with().replace("\n", "\n\n", 1), "found 1 rows"),
        (pattern_with() + "#" * 17, "row 18: found '#.*expected 17 rows"),
        (pattern_with() + "words", "row 18: found 'words'"),
        (pattern_with()[1:], "row 1: found 16 characters"),
        (" " + pattern_with(), "row 1: found 18 characters"),
        (dice.empty_pattern(), "found 0 times 'X', expected 25"),
        (pattern_with().replace("..", "XX", 1), "times 'X', expected 25"),
    ],
)
def test_a_faulty_pattern_is_refused_with_row_and_column(text, message):
    with pytest.raises(TaskError, match=message):
        dice.parse_pattern(text)


@given(st.text(alphabet="#.X-\r\n \t", max_size=400) | st.text(max_size=60))
def test_any_text_is_a_pattern_or_refused(text):
    with pytest.raises(TaskError, match="pattern: "):
        dice.parse_pattern(text)


@given(SEEDS, st.integers(0, 24), st.sampled_from([(1e-5, 0, 0), (0, 0.011, 0), (0, 0, 0.022)]))
def test_only_goals_on_different_cells_have_a_pattern(seed, index, offset):
    goal = dice.sample_goal(seed)
    twice = goal.copy()
    twice[index] = twice[index - 1]
    with pytest.raises(TaskError, match=r"position \d+: .*second time"):
        dice.pattern(twice)
    toward = -np.sign(goal[index]) if offset[2] == 0 else np.ones(3)
    goal[index] += np.where(toward == 0, 1, toward) * offset
    with pytest.raises(TaskError, match=f"position {index}: found .*expected the centre of a cell"):
        dice.pattern(goal)


def test_what_a_file_holds_is_recognised_by_its_content(tmp_path):
    goal = dice.sample_goal(1)
    contents = [
        json.dumps(goal.tolist()),
        "\n\t" + json.dumps({"_": {"note": [None]}, "goal": goal.tolist()}),
        "\ufeff" + json.dumps({"goal": goal.tolist()}),
        dice.pattern(goal),
        "\ufeff" + dice.pattern(goal).replace("\n", "\r\n") + "-- \r\nText.",
    ]
    for content in contents:
        (tmp_path / "goal").write_bytes(content.encode())
        assert same_places(dice.read_goal(tmp_path / "goal"), goal)


GOAL = json.dumps(PLACES.tolist())
FIRST = GOAL[1 : GOAL.index("]") + 1]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "an empty file"),
        (" \n", "an empty file"),
        ("null", "row 1"),
        ("[", "not JSON"),
        ("[]", "found 0 positions, expected 25"),
        ("{}", "found no key, expected the key 'goal'"),
        ('{"goals": [], "b": 1}', "found 'goals', 'b', expected the key 'goal'"),
        (f'{{"goal": {GOAL}, "goal": {GOAL}}}', "found the key 'goal' twice"),
        ('{"goal": {"goal": []}}', "goal: found a mapping of 1, expected a list"),
        (GOAL.replace(FIRST, "7", 1), r"position 0: found 7, expected \[x, y, z\]"),
        (GOAL.replace(FIRST, "[0, 0, 0.011, 0]", 1), "position 0: found a list of 4"),
        (GOAL.replace(FIRST, '[0, "0", 0.011]', 1), "position 0: found '0', expected a finite number"),
        (GOAL.replace(FIRST, "[0, NaN, 0.011]", 1), "found NaN, expected finite"),
        (GOAL.replace(FIRST, "[0, 1e999, 0.011]", 1), "position 0: found inf"),
        (GOAL.replace(FIRST, f"[0, 1{'0' * 5000}, 0.011]", 1), "not JSON|whole number above"),
        (GOAL.replace(FIRST, "[0, 0.3, 0.011]", 1), "position 0, .*its die reaches"),
        (GOAL + "x", "not JSON: Extra data"),
        ("[" * 50_000, "nested too deeply"),
        (GOAL + " " * MAX_FILE_SIZE, f"more than {MAX_FILE_SIZE} bytes"),
        (b"[\xff]", "byte 1, which is no UTF-8"),
        ("X" + dice.empty_pattern()[1:], "row 1, column 1"),
    ],
)
def test_a_faulty_file_is_named_with_its_fault(tmp_path, content, message):
    path = tmp_path / "goal.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(TaskError, match=message) as raised:
        dice.read_goal(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert len(str(raised.value)) < len(str(path)) + 250


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(string.printable, max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.just("goal") | st.text(max_size=3), inner),
    max_leaves=30,
)
PAIRS = st.lists(st.lists(JSON, min_size=2, max_size=2), min_size=1, max_size=3)


@given(JSON | PAIRS, st.sampled_from([dice.read_goal, read_job_goal]))
def test_no_other_json_is_a_goal(tmp_path_factory, data, read):
    path = tmp_path_factory.getbasetemp() / "some.json"
    path.write_text(json.dumps(data))
    with pytest.raises(TaskError, match=r"some\.json: "):
        read(path)


@pytest.mark.parametrize("name", ["nowhere.json", "", "a\0b"])
def test_a_file_that_cannot_be_read_is_named(tmp_path, name):
    with pytest.raises(TaskError, match=r"cannot be read|found a null byte"):
        dice.read_goal(f"{tmp_path}/{name}")


@pytest.mark.parametrize(
    ("name", "goal", "message"),
    [
        ("goal.yaml", PLACES, r"found suffix '\.yaml', expected \.json or \.txt"),
        ("goal", PLACES, "found no suffix"),
        ("nowhere/goal.json", PLACES, "cannot be written: there is no folder .*nowhere"),
        ("taken.json", PLACES, "cannot be written"),
        ("a\0.json", PLACES, "found a null byte"),
        ("goal.json", np.zeros((25, 3)), "height 0 m"),
        ("goal.txt", PLACES * 0.9 + [0, 0, 0.01], "expected the centre of a cell"),
    ],
)
def test_a_goal_that_cannot_be_written_is_named_and_leaves_nothing(tmp_path, name, goal, message):
    (tmp_path / "taken.json").mkdir()
    with pytest.raises(TaskError, match=message):
        dice.write_goal(f"{tmp_path}/{name}", goal)
    assert os.listdir(tmp_path) == ["taken.json"]
    with pytest.raises(TaskError, match="goal: found None, expected a path"):
        dice.write_goal(None, PLACES)
