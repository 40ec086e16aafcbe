"""The task of the 25 dice: push them into a pattern.

A goal is 25 places (x, y, z) [m] in the world. The dice look all the same, so it does not matter which
of them is where: the state is judged by the pixels in each camera's image that show dice although no
place of the goal is there. That takes a mask of the dice in each image, and a mask of the goal in each
camera; the error is the number of pixels that are in the first and not in the second.
"""

from tracker.tasks.rearrange_dice.finder import Die, locate
from tracker.tasks.rearrange_dice.goals import (
    ARENA_RADIUS,
    CELLS_PER_ROW,
    DIE_WIDTH,
    NUM_DICE,
    TOLERANCE,
    cells,
    empty_pattern,
    parse_pattern,
    pattern,
    read_goal,
    sample_goal,
    validate_goal,
    write_goal,
)
from tracker.tasks.rearrange_dice.score import (
    Assignment,
    assign,
    error,
    error_per_camera,
    goal_masks,
    reward,
)
from tracker.tasks.rearrange_dice.segment import segment_dice

__all__ = [
    "ARENA_RADIUS",
    "CELLS_PER_ROW",
    "DIE_WIDTH",
    "NUM_DICE",
    "TOLERANCE",
    "Assignment",
    "Die",
    "assign",
    "cells",
    "empty_pattern",
    "error",
    "error_per_camera",
    "goal_masks",
    "locate",
    "parse_pattern",
    "pattern",
    "read_goal",
    "reward",
    "sample_goal",
    "segment_dice",
    "validate_goal",
    "write_goal",
]
