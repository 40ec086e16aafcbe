from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import TaskError
from tracker.tasks import rearrange_dice as dice

SEEDS = st.integers(0, 2**32)


def same_places(a, b) -> bool:
    """Whether two goals are the same but for the order."""
    a, b = (np.array(sorted(np.round(goal, 9).tolist())) for goal in (a, b))
    return bool(np.abs(a - b).max() == 0)


def pattern_with(*changes: tuple[int, int, str], seed: int = 0) -> str:
    """A valid pattern with characters changed at (row, column)."""
    rows = [list(row) for row in dice.pattern(dice.sample_goal(seed)).splitlines()]
    for row, column, character in changes:
        rows[row][column] = character
    return "\n".join("".join(row) for row in rows) + "\n"


@given(SEEDS)
def test_a_pattern_shows_the_goal_it_was_made_of(seed):
    goal = dice.sample_goal(seed)
    assert same_places(dice.parse_pattern(dice.pattern(goal)), goal)


@given(SEEDS)
def test_a_goal_shows_the_pattern_it_was_made_of(seed):
    text = dice.pattern(dice.sample_goal(seed))
    assert dice.pattern(dice.parse_pattern(text)) == text


def test_rows_go_along_x_and_columns_along_y():
    rows = [list(row) for row in dice.empty_pattern().splitlines()]
    free = [(i, j) for i in range(17) for j in range(17) if rows[i][j] == "."]
    chosen = [(2, 11), *[cell for cell in free if cell != (2, 11)][:24]]
    for i, j in chosen:
        rows[i][j] = "X"
    goal = dice.parse_pattern("\n".join("".join(row) for row in rows))
    assert np.abs(goal - [(2 - 8) * 0.022, (11 - 8) * 0.022, 0.011]).max(axis=1).min() < 1e-12


def test_the_empty_pattern_is_the_arena_and_no_goal():
    text = dice.empty_pattern()
    assert [len(row) for row in text.splitlines()] == [17] * 17
    assert text.count(".") == len(dice.cells())
    assert set(text) == {"#", ".", "\n"}
    with pytest.raises(TaskError, match="found 0 times 'X', expected 25"):
        dice.parse_pattern(text)


@pytest.mark.parametrize(
    "end", ["", "\n", "\n\nwords\n", "\n-- \nwords\n", "\n--\n", "  \n \t\nX", "\n\n\n#"]
)
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r", " \n", "\t \r\n"])
def test_text_after_the_rows_means_nothing(end, newline):
    text = pattern_with()
    goal = dice.parse_pattern(text.rstrip("\n").replace("\n", newline) + end)
    np.testing.assert_array_equal(goal, dice.parse_pattern(text))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (pattern_with((0, 0, ".")), r"row 1, column 1: found '\.', expected '#' outside the arena"),
        (pattern_with((0, 0, "X")), "row 1, column 1: found 'X', expected '#' outside"),
        (pattern_with((8, 4, "#")), r"row 9, column 5: found '#', expected '\.' or 'X' inside"),
        (pattern_with((8, 4, "x")), "row 9, column 5: found 'x'"),
        (pattern_with((8, 4, "\0")), r"row 9, column 5: found '\\x00'"),
        (pattern_with((8, 16, "é")), "row 9, column 17: found 'é'"),
        (pattern_with()[18:], "row 1"),
        (pattern_with()[:-18], "found 16 rows, expected 17"),
        ("\n" + pattern_with(), "found 0 rows"),
        ("", "found 0 rows"),
        (pattern_with().replace("\n", "\n\n", 1), "found 1 rows"),
        (pattern_with() + "#" * 17, "row 18: found '#.*expected 17 rows"),
        (pattern_with() + "words", "row 18: found 'words'"),
        (pattern_with()[1:], "row 1: found 16 characters"),
        (" " + pattern_with(), "row 1: found 18 characters"),
        (pattern_with().replace("\n", "#\n"), "row 1: found 18 characters"),
        (pattern_with().replace("X", ".", 1), "found 24 times 'X', expected 25"),
        (pattern_with().replace("..", "XX", 1), "times 'X', expected 25"),
    ],
)
def test_a_faulty_pattern_is_refused_with_row_and_column(text, said):
    with pytest.raises(TaskError, match=said):
        dice.parse_pattern(text)


@given(st.text(alphabet="#.X-\r\n \t", max_size=400) | st.text(max_size=60))
def test_any_text_is_a_pattern_or_refused(text):
    with pytest.raises(TaskError, match="pattern: "):
        dice.parse_pattern(text)


@given(SEEDS, st.integers(0, 24), st.sampled_from([(1e-5, 0, 0), (0, 0.011, 0), (0, 0, 0.022)]))
def test_only_goals_on_cells_have_a_pattern(seed, index, offset):
    goal = dice.sample_goal(seed)
    toward = -np.sign(goal[index]) if offset[2] == 0 else np.ones(3)
    goal[index] += np.where(toward == 0, 1, toward) * offset
    with pytest.raises(TaskError, match=f"position {index}: found .*expected the centre of a cell"):
        dice.pattern(goal)


def test_two_places_in_one_cell_have_no_pattern():
    goal = dice.sample_goal(0)
    goal[9] = goal[4]
    with pytest.raises(TaskError, match=r"position 9: .*second time"):
        dice.pattern(goal)
