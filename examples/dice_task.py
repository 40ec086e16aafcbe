"""The dice task on the images in `examples/dice`: the error, where the dice are, and which must go where."""

from pathlib import Path

import cv2

import tracker
from tracker.tasks import rearrange_dice

folder = Path(__file__).with_name("dice")
rig = tracker.CameraRig.load(folder)
images = [cv2.imread(str(folder / f"{name}.png")) for name in rig.names]

goal = rearrange_dice.read_goal(folder / "goal.json")  # (25, 3) [m]
areas = rearrange_dice.goal_masks(rig, goal)  # once per goal
masks = [None if image is None else rearrange_dice.segment_dice(image) for image in images]
print("error [px]", rearrange_dice.error(areas, masks))  # the reward is its negative

dice = rearrange_dice.locate(rig, masks, images)  # position [m], yaw, probability of each
plan = rearrange_dice.assign(goal, [die.position for die in dice])
for place, die in plan.pairs:
    if plan.distance[place] > rearrange_dice.TOLERANCE:
        print("move", dice[die].position, "to", goal[place])
