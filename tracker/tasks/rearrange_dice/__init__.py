"""The task of the 25 dice: push them into a pattern.

A goal is 25 places (x, y, z) [m] in the world. The dice look alike, so it does not matter which die is
where. The error is the number of pixels, over all cameras' images, that show dice outside the goal's places:
the pixels in the mask of the dice that are not in the mask of the goal.
"""

from tracker.tasks.rearrange_dice.finder import Die as Die
from tracker.tasks.rearrange_dice.finder import locate as locate
from tracker.tasks.rearrange_dice.goals import ARENA_RADIUS as ARENA_RADIUS
from tracker.tasks.rearrange_dice.goals import CELLS_PER_ROW as CELLS_PER_ROW
from tracker.tasks.rearrange_dice.goals import DIE_WIDTH as DIE_WIDTH
from tracker.tasks.rearrange_dice.goals import NUM_DICE as NUM_DICE
from tracker.tasks.rearrange_dice.goals import TOLERANCE as TOLERANCE
from tracker.tasks.rearrange_dice.goals import cells as cells
from tracker.tasks.rearrange_dice.goals import empty_pattern as empty_pattern
from tracker.tasks.rearrange_dice.goals import parse_pattern as parse_pattern
from tracker.tasks.rearrange_dice.goals import pattern as pattern
from tracker.tasks.rearrange_dice.goals import read_goal as read_goal
from tracker.tasks.rearrange_dice.goals import sample_goal as sample_goal
from tracker.tasks.rearrange_dice.goals import validate_goal as validate_goal
from tracker.tasks.rearrange_dice.goals import write_goal as write_goal
from tracker.tasks.rearrange_dice.score import Assignment as Assignment
from tracker.tasks.rearrange_dice.score import assign as assign
from tracker.tasks.rearrange_dice.score import error as error
from tracker.tasks.rearrange_dice.score import error_per_camera as error_per_camera
from tracker.tasks.rearrange_dice.score import goal_masks as goal_masks
from tracker.tasks.rearrange_dice.score import reward as reward
from tracker.tasks.rearrange_dice.segment import segment_dice as segment_dice
