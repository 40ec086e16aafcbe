from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import TaskError
from tracker.tasks import rearrange_dice as dice

SEEDS = st.integers(0, 2**32)
COORDINATES = st.floats(-0.3, 0.3)


def inside_by_hand(x: float, y: float) -> bool:
    return all(
        math.dist((x + dx, y + dy), (0, 0)) <= 0.19 for dx in (-0.011, 0.011) for dy in (-0.011, 0.011)
    )


def test_cells_are_those_of_a_grid_whose_corners_are_in_the_arena():
    steps = [0.022 * k for k in range(-8, 9)]
    expected = [(x, y, 0.011) for x in steps for y in steps if inside_by_hand(x, y)]
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


@pytest.mark.parametrize("rng", [None, True, -1, 1.0, "1"])
def test_chance_comes_from_a_seed_or_a_generator(rng):
    with pytest.raises(TaskError, match=r"rng: found .*expected"):
        dice.sample_goal(rng)


@given(st.lists(st.tuples(COORDINATES, COORDINATES, st.floats(-0.01, 0.2)), min_size=25, max_size=25))
def test_a_goal_is_valid_if_every_die_is_in_the_arena_and_above_its_floor(places):
    margins = [max(math.hypot(abs(x) + 0.011, abs(y) + 0.011) - 0.19, 0.011 - z) for x, y, z in places]
    if max(margins) <= 0:
        np.testing.assert_array_equal(dice.validate_goal(places), places)
    elif max(margins) > 1e-8:
        with pytest.raises(TaskError):
            dice.validate_goal(places)


@given(st.floats(0.06, math.pi / 2 - 0.06), st.integers(0, 3))
def test_rounding_does_not_invalidate_a_goal(angle, quarter):
    corner = 0.19 * np.exp(1j * (angle + quarter * math.pi / 2))
    goal = dice.sample_goal(0)
    goal[3] = (
        *(np.array([corner.real, corner.imag]) - np.copysign(0.011, [corner.real, corner.imag])),
        0.011,
    )
    for factor in (1.0, 1 - 1e-10, 1 + 1e-10):
        dice.validate_goal(goal * factor)
        dice.validate_goal(goal * factor / 3 * 3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda goal: goal[:24], "found 24 positions, expected 25"),
        (lambda goal: [], "found 0 positions, expected 25"),
        (lambda goal: goal[:, :2], r"found shape \(25, 2\), expected \(N, 3\)"),
        (lambda goal: goal.ravel(), r"found shape \(75,\)"),
        (lambda goal: goal.astype(str), "found values of type <U"),
        (lambda goal: goal > 0, "found values of type bool"),
        (lambda goal: [*goal[:24].tolist(), [0.0]], "different lengths"),
        (lambda goal: "goal", "found values of type <U4"),
        (lambda goal: None, "found values of type object"),
        (lambda goal: np.where(goal == goal[7, 0], np.nan, goal), "position .*nan.*expected finite"),
        (lambda goal: np.where(np.arange(25)[:, None] == 3, 1e200, goal), "position 3.*expected finite"),
        (lambda goal: goal - (0, 0, 0.001), "position 0.*found the height 0.01 m, expected at least"),
        (lambda goal: goal - (0.4, 0, 0), "position 0.*its die reaches .*expected at most 0.19 m"),
    ],
)
def test_a_faulty_goal_is_refused_with_its_fault(change, said):
    with pytest.raises(TaskError, match=said):
        dice.validate_goal(change(dice.sample_goal(0)))
