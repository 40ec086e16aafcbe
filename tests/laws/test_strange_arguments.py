import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers import ROOT
from tests.helpers.pose_logs import random_poses
from tracker import viz
from tracker.live import Pushed
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.poses.exports import write_bop, write_csv, write_tum
from tracker.poses.file import write_poses
from tracker.tasks import move_object, rearrange_dice

HUGE = 10**5000
"""Python refuses to write it."""

STRANGE = [
    *(None, True, 3, -1, 0, HUGE, 1e300, -1e300, float("nan"), float("inf"), 1j, np.float32(2), np.int64(5)),
    *("x", "", "a\0b", b"x", "\udcff", "x" * 5000, np.array("x"), Path("nowhere"), Path("a\0b"), Path("/")),
    *([], (), {}, [1, 2, 3], [[1, 2], [3]], {"a": 1}, {1, 2}, range(3), [float("nan")] * 3, ["a"] * 3),
    *((HUGE,) * 3, [HUGE] * 3, object(), object, print),
    *(np.zeros(0), np.zeros((2, 3)), np.zeros((3, 3, 3)), np.full((4, 4), np.nan), np.array([None])),
    *(np.datetime64("2020-01-01"), np.timedelta64(3, "s"), np.zeros((20, 20, 3), np.uint8), np.ma.zeros(3)),
]

DEMO = ROOT / "tracker" / "demo"
RIG = tracker.CameraRig.load(DEMO)
MODEL, COLORS = tracker.load_object("cube_v2"), tracker.load_colors("cube_v2")
IMAGES = [np.zeros((270, 270, 3), np.uint8)] * 3
GOAL = rearrange_dice.sample_goal(1)
MASKS = [np.zeros((270, 270), np.uint8)] * 3
ZERO, UNIT = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]
GOALS = {"goal_position": ZERO, "goal_orientation": UNIT}
STATE = {"position": ZERO, "orientation": UNIT}
REWARDS = {level: [1.0] for level in (1, 2, 3, 4)}
NOTHING = tracker.Observation(None, None, tracker.Status.LOST)
CORNERS = move_object.keypoints(ZERO, UNIT, MODEL.size)
PARTS = {"position": np.zeros(3), "orientation": np.array(UNIT), "covariance": np.eye(6), "confidence": 0.5}


def fields(one: object) -> dict[str, object]:
    return {field.name: getattr(one, field.name) for field in dataclasses.fields(one)}


POSES = random_poses(np.random.default_rng(0), 3)
TRACKER = tracker.ObjectTracker(MODEL, RIG)
CALLS = [
    partial(tracker.ObjectTracker, model=MODEL, rig=RIG, colors=COLORS, tracking=None),
    partial(TRACKER.detect, images=IMAGES),
    partial(TRACKER.update, images=IMAGES, timestamp=1.0),
    partial(TRACKER.predict, timestamp=1.0),
    partial(tracker.CameraRig, cameras=RIG.cameras, arena=RIG.arena),
    partial(tracker.CameraRig.load, path=DEMO, pattern=None),
    partial(tracker.Camera, **fields(RIG[0])),
    partial(RIG[0].project, points_world=[ZERO]),
    partial(RIG[0].rays, pixels=[[1, 2]]),
    partial(tracker.Arena, **fields(RIG.arena)),
    partial(tracker.CuboidModel, **fields(MODEL)),
    partial(tracker.ColorModel, name="x", log_posterior=COLORS.log_posterior),
    partial(tracker.TrackingOptions, **fields(tracker.TrackingOptions())),
    partial(tracker.PoseEstimate, **PARTS, size=np.ones(3)),
    partial(tracker.load_object, name_or_path="cube_v2"),
    partial(tracker.load_colors, name_or_path="cube_v2"),
    partial(tracker.segment, image=IMAGES[0], colors=COLORS),
    partial(tracker.open_log, path=DEMO, rate=10.0),
    partial(tracker.read_poses, path="nowhere"),
    partial(Hdf5LogWriter, "nowhere/log.h5", rig=RIG),
    partial(write_poses, "nowhere/poses.h5", poses=POSES),
    partial(write_csv, "nowhere/poses.csv", poses=POSES),
    partial(write_tum, "nowhere/poses.tum", poses=POSES, kind="filtered"),
    partial(write_bop, "nowhere/bop.csv", poses=POSES, camera=RIG[0]),
    partial(move_object.keypoints, **STATE, size=MODEL.size),
    partial(move_object.pose_from_keypoints, corners=CORNERS, size=MODEL.size, tolerance=1e-3),
    partial(move_object.reward, level=4, model=MODEL, **GOALS, **STATE),
    partial(move_object.long_axis_error, goal_orientation=UNIT, orientation=UNIT, axis=1),
    partial(move_object.trajectory_reward, trajectory=[(0, ZERO)], time=1, position=ZERO),
    partial(move_object.weighted_total, episode_rewards=REWARDS, median=False),
    partial(rearrange_dice.goal_masks, rig=RIG, goal=GOAL),
    partial(rearrange_dice.error, goal_masks=MASKS, dice_masks=MASKS),
    partial(rearrange_dice.assign, goal=GOAL, positions=GOAL),
    partial(rearrange_dice.locate, rig=RIG, masks=[None] * 3, images=None, most=25),
    partial(rearrange_dice.parse_pattern, text="x"),
    partial(rearrange_dice.read_goal, path="nowhere"),
    partial(rearrange_dice.sample_goal, rng=1),
    partial(rearrange_dice.segment_dice, image=IMAGES[0], colors=None),
    partial(Pushed().push, images=IMAGES, timestamp=1.0),
    partial(viz.overlay, images=IMAGES, rig=RIG, model=MODEL, observation=NOTHING),
    partial(viz.goal_picture, goal=GOAL),
]
"""Calls with all their arguments, each of which is replaced in its turn."""


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.func.__qualname__)
def test_what_cannot_be_taken_is_named_in_one_line(call):
    messages = []
    for key in call.keywords:
        for value in STRANGE:
            try:
                call(**{key: value})
            except tracker.TrackerError as error:
                messages.append(str(error))
    assert len(messages) > 10
    assert not [text for text in messages if "\n" in text]
