"""The goal of a job: `goal.json` in its folder, as the platform writes it.

    {"difficulty": 4, "goal": {"position": [x, y, z], "orientation": [x, y, z, w]}}   a pose
    [[0, [x, y, z]], [30000, [x, y, z]], …]                                           a trajectory
    [[x, y, z], … 25 of them]                                                         dice

The last two may also be the value of `goal` in an object, as in a job's configuration; dice may be a pattern.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tracker.checks import naming
from tracker.conventions import FloatArray
from tracker.errors import TaskError
from tracker.objects.model import CuboidModel
from tracker.tasks import move_object
from tracker.tasks.checks import quaternions
from tracker.tasks.rearrange_dice.goals import listed, parse_pattern, places_of, read_stored

FILE_NAME = "goal.json"
"""Name of the file in a job's folder."""

STEPS_PER_SECOND = 1000.0
"""Rate of the platform's control steps, the unit of time in trajectories [1/s]."""


@dataclass(frozen=True, eq=False)
class JobGoal:
    """The goal of a job."""

    task: Literal["move_object", "trajectory", "rearrange_dice"]
    """Kind of task."""
    level: int | None = None
    """Difficulty of moving an object, 1 to 4."""
    position: FloatArray | None = None
    """(3,) goal position of the object [m], or (25, 3) of the dice."""
    orientation: FloatArray | None = None
    """(4,) xyzw goal orientation of the object, if it matters."""
    trajectory: tuple[tuple[float, tuple[float, ...]], ...] = ()
    """Pairs of the control step at which a goal becomes active, and its position [m]."""

    def rewards(
        self, seconds: FloatArray, position: FloatArray, orientation: FloatArray, model: CuboidModel
    ) -> FloatArray:
        """Return rewards (n,) per control step, at times (n,) [s] since the beginning of the job.

        Positions (n, 3) [m], orientations (n, 4) xyzw and rewards are NaN where the object was not seen.
        TaskError if the task is not to move an object.
        """
        if self.task == "trajectory":
            # The rounding of stamps must not put a frame before the goal that begins with it.
            steps = np.rint(STEPS_PER_SECOND * seconds)
            return move_object.trajectory_reward(self.trajectory, steps, position)
        if self.task == "rearrange_dice" or self.position is None or self.level is None:
            raise TaskError("goal: found one of dice, expected that of an object")
        return move_object.reward(
            self.level, self.position, position, self.orientation, orientation, model=model
        )


def read_job_goal(path: str | os.PathLike[str]) -> JobGoal:
    """Read a job's goal file; TaskError, which names the file, if it cannot be read or has no goal."""
    data = read_stored(path)
    with naming(Path(path), TaskError):
        return _goal(data)


def _goal(data: Any) -> JobGoal:
    if isinstance(data, str):
        return JobGoal("rearrange_dice", position=parse_pattern(data))
    level = None
    if isinstance(data, dict):
        level, data = data.get("difficulty"), data.get("goal", data.get("_goal"))
    if isinstance(data, dict):
        return _pose(level, data)
    if not isinstance(data, list) or not data or not all(isinstance(entry, list) for entry in data):
        raise TaskError("found no goal, expected a pose, a trajectory or the positions of dice")
    if all(len(entry) == 2 for entry in data):
        goals = [(time, listed(place, f"trajectory: entry {k}")) for k, (time, place) in enumerate(data)]
        move_object.active_goal(goals, 0)  # checks the rest
        return JobGoal("trajectory", trajectory=tuple((float(time), tuple(place)) for time, place in data))
    return JobGoal("rearrange_dice", position=places_of(data))


def _pose(level: Any, data: dict[str, Any]) -> JobGoal:
    if isinstance(level, bool) or level not in move_object.LEVELS:
        raise TaskError(f"difficulty: found {level!r:.40}, expected 1, 2, 3 or 4")
    position, orientation = listed(data.get("position"), "position"), data.get("orientation")
    if orientation is not None:
        orientation = quaternions("orientation", listed(orientation, "orientation", "x, y, z, w"))
    if level == 4 and orientation is None:
        raise TaskError("goal: found no orientation, expected one at level 4")
    return JobGoal("move_object", int(level), position, orientation)
