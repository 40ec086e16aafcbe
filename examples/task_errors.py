"""Errors and rewards of the tasks that move an object, for one state; arrays over time work as well."""

import tracker
from tracker.tasks import move_object

cuboid = tracker.load_object("cuboid_2x2x8_v2")
goal_position, goal_orientation = (0.0, 0.0, 0.0825), (0, 0, 0, 1)  # [m], xyzw
position, orientation = (0.01, -0.02, 0.075), (0.1, 0, 0, 1)

print(move_object.position_error(goal_position, position))  # ½ (‖Δxy‖ / 0.39 m + |Δz| / 0.1 m)
print(move_object.rotation_error(goal_orientation, orientation))  # angle / π
print(move_object.long_axis_error(goal_orientation, orientation))  # angle between the long axes / π
print(move_object.reward(4, goal_position, position, goal_orientation, orientation, model=cuboid))

trajectory = [(0, (0.1, 0.0, 0.0325)), (30_000, (0.0, 0.1, 0.0325))]  # control steps, [m]
print(move_object.active_goal(trajectory, [29_999, 30_000]))
print(move_object.weighted_total({1: [-5000.0], 2: [-4000.0], 3: [-6000.0], 4: [-9000.0]}))  # Σ i · R_i
