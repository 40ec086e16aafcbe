from __future__ import annotations

import json
import os
import string

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import TaskError
from tracker.tasks import rearrange_dice as dice
from tracker.tasks.rearrange_dice.goal_files import MAX_FILE_SIZE


def same_places(a, b) -> bool:
    """Whether two goals are the same but for the order."""
    a, b = (np.array(sorted(np.round(goal, 9).tolist())) for goal in (a, b))
    return bool(np.abs(a - b).max() == 0)


@given(st.integers(0, 2**32))
def test_json_keeps_every_bit(tmp_path_factory, seed):
    path = tmp_path_factory.getbasetemp() / "goal.json"
    rng = np.random.default_rng(seed)
    goal = dice.sample_goal(rng) * rng.uniform(0.1, 1, (25, 1)) + [0, 0, 0.011]
    dice.write_goal(path, goal)
    np.testing.assert_array_equal(dice.read_goal(path), goal)


def test_a_pattern_file_keeps_the_places(tmp_path):
    goal = dice.sample_goal(1)
    dice.write_goal(tmp_path / "goal.txt", goal)
    assert same_places(dice.read_goal(tmp_path / "goal.txt"), goal)


def test_what_a_file_holds_is_told_from_its_content(tmp_path):
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


GOAL = json.dumps(dice.sample_goal(0).tolist())
FIRST = GOAL[1 : GOAL.index("]") + 1]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "an empty file"),
        (" \n", "an empty file"),
        ("null", "row 1"),
        ("[", "not JSON"),
        ("[]", "found 0 positions, expected 25"),
        ("{}", "found no key, expected the key 'goal'"),
        ('{"goals": [], "b": 1}', "found 'goals', 'b', expected the key 'goal'"),
        (f'{{"goal": {GOAL}, "goal": {GOAL}}}', "found the key 'goal' twice"),
        ('{"goal": {"goal": []}}', "goal: found an object of 1, expected a list"),
        ('{"goal": null}', "goal: found null"),
        ('{"goal": "[]"}', r"goal: found \"\[\]\""),
        (GOAL.replace(FIRST, "7", 1), r"position 0: found 7, expected \[x, y, z\]"),
        (GOAL.replace(FIRST, "[]", 1), "position 0: found a list of 0"),
        (GOAL.replace(FIRST, "[0, 0, 0.011, 0]", 1), "position 0: found a list of 4"),
        (GOAL.replace(FIRST, '[0, "0", 0.011]', 1), 'position 0: y: found "0", expected a finite number'),
        (GOAL.replace(FIRST, "[0, true, 0.011]", 1), "position 0: y: found true"),
        (GOAL.replace(FIRST, "[0, null, 0.011]", 1), "position 0: y: found null"),
        (GOAL.replace(FIRST, "[0, [0], 0.011]", 1), "position 0: y: found a list of 1"),
        (GOAL.replace(FIRST, "[0, NaN, 0.011]", 1), "found NaN, expected finite"),
        (GOAL.replace(FIRST, "[0, -Infinity, 0.011]", 1), "found -Infinity"),
        (GOAL.replace(FIRST, "[0, 1e999, 0.011]", 1), "position 0: y: found Infinity"),
        (GOAL.replace(FIRST, f"[0, 1{'0' * 400}, 0.011]", 1), "y: found a whole number above"),
        (GOAL.replace(FIRST, f"[0, 1{'0' * 5000}, 0.011]", 1), "not JSON|whole number above"),
        (GOAL.replace(FIRST, "[0, 0.3, 0.011]", 1), "position 0, .*its die reaches"),
        (GOAL + "x", "not JSON: Extra data"),
        ("[" * 50_000, "nested too deeply"),
        ('{"goal":' * 10_000, "nested too deeply"),
        (GOAL + " " * MAX_FILE_SIZE, f"more than {MAX_FILE_SIZE} bytes"),
        (b"[\xff]", "byte 1, which is no UTF-8"),
        (GOAL.encode("utf-16"), "no UTF-8"),
        ("X" + dice.empty_pattern()[1:], "row 1, column 1"),
    ],
)
def test_a_faulty_file_is_named_with_its_fault(tmp_path, content, said):
    path = tmp_path / "goal.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(TaskError, match=said) as raised:
        dice.read_goal(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert len(str(raised.value)) < len(str(path)) + 250


@pytest.mark.parametrize("name", ["nowhere.json", "", "a\0b"])
def test_a_file_that_cannot_be_read_is_named(tmp_path, name):
    with pytest.raises(TaskError, match="cannot be read"):
        dice.read_goal(f"{tmp_path}/{name}")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(string.printable, max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.just("goal") | st.text(max_size=3), inner),
    max_leaves=30,
)


@given(JSON)
def test_no_other_json_is_a_goal(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "some.json"
    path.write_text(json.dumps(data))
    with pytest.raises(TaskError, match=r"some\.json: "):
        dice.read_goal(path)


@given(st.binary(max_size=200))
def test_no_other_bytes_are_a_goal(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "some.bin"
    path.write_bytes(data)
    with pytest.raises(TaskError, match=r"some\.bin: "):
        dice.read_goal(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("goal.yaml", r"found suffix '\.yaml', expected \.json, or \.txt"),
        ("goal", "found no suffix"),
        ("nowhere/goal.json", "cannot be written: there is no folder .*nowhere"),
        ("taken.json", "cannot be written"),
        ("a\0.json", "cannot be written"),
    ],
)
def test_a_file_that_cannot_be_written_is_named(tmp_path, name, said):
    (tmp_path / "taken.json").mkdir()
    with pytest.raises(TaskError, match=said):
        dice.write_goal(f"{tmp_path}/{name}", dice.sample_goal(0))
    assert os.listdir(tmp_path) == ["taken.json"]


def test_a_goal_that_is_not_valid_is_not_written(tmp_path):
    off_cells = dice.sample_goal(0) * 0.9 + [0, 0, 0.01]
    for name, goal in (("goal.json", np.zeros((25, 3))), ("goal.txt", off_cells)):
        with pytest.raises(TaskError):
            dice.write_goal(tmp_path / name, goal)
    assert os.listdir(tmp_path) == []
