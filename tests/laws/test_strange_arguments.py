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
NOTHING = tracker.Observation(None, None, tracker.Status.LOST)
PARTS = {"position": np.zeros(3), "orientation": np.array(UNIT), "covariance": np.eye(6), "confidence": 0.5}


def fields(one: object) -> dict[str, object]:
    return {field.name: getattr(one, field.name) for field in dataclasses.fields(one)}


POSES = random_poses(np.random.default_rng(0), 3)
TRACKER = tracker.ObjectTracker(MODEL, RIG)
CALLS = {
    "ObjectTracker": (
        tracker.ObjectTracker,
        {"model": MODEL, "rig": RIG, "colors": COLORS, "tracking": None},
    ),
    "detect": (TRACKER.detect, {"images": IMAGES}),
    "update": (TRACKER.update, {"images": IMAGES, "timestamp": 1.0}),
    "predict": (TRACKER.predict, {"timestamp": 1.0}),
    "CameraRig": (tracker.CameraRig, {"cameras": RIG.cameras, "arena": RIG.arena}),
    "CameraRig.load": (tracker.CameraRig.load, {"path": DEMO, "pattern": None}),
    "Camera": (tracker.Camera, fields(RIG[0])),
    "Camera.project": (RIG[0].project, {"points_world": [ZERO]}),
    "Camera.rays": (RIG[0].rays, {"pixels": [[1, 2]]}),
    "Arena": (tracker.Arena, fields(RIG.arena)),
    "CuboidModel": (tracker.CuboidModel, fields(MODEL)),
    "ColorModel": (tracker.ColorModel, {"name": "x", "log_posterior": COLORS.log_posterior}),
    "TrackingOptions": (tracker.TrackingOptions, fields(tracker.TrackingOptions())),
    "PoseEstimate": (tracker.PoseEstimate, {**PARTS, "size": np.ones(3)}),
    "load_object": (tracker.load_object, {"name_or_path": "cube_v2"}),
    "load_colors": (tracker.load_colors, {"name_or_path": "cube_v2"}),
    "segment": (tracker.segment, {"image": IMAGES[0], "colors": COLORS}),
    "open_log": (tracker.open_log, {"path": DEMO, "rate": 10.0}),
    "read_poses": (tracker.read_poses, {"path": "nowhere"}),
    "Hdf5LogWriter": (partial(Hdf5LogWriter, "nowhere/log.h5"), {"rig": RIG}),
    "write_poses": (partial(write_poses, "nowhere/poses.h5"), {"poses": POSES}),
    "write_csv": (partial(write_csv, "nowhere/poses.csv"), {"poses": POSES}),
    "write_tum": (partial(write_tum, "nowhere/poses.tum"), {"poses": POSES, "kind": "filtered"}),
    "write_bop": (partial(write_bop, "nowhere/bop.csv"), {"poses": POSES, "camera": RIG[0]}),
    "keypoints": (move_object.keypoints, {"position": ZERO, "orientation": UNIT, "size": MODEL.size}),
    "pose_from_keypoints": (
        move_object.pose_from_keypoints,
        {"corners": move_object.keypoints(ZERO, UNIT, MODEL.size), "size": MODEL.size, "tolerance": 1e-3},
    ),
    "reward": (
        move_object.reward,
        {"level": 4, "goal_position": ZERO, "position": ZERO}
        | {"goal_orientation": UNIT, "orientation": UNIT, "model": MODEL},
    ),
    "long_axis_error": (
        move_object.long_axis_error,
        {"goal_orientation": UNIT, "orientation": UNIT, "axis": 1},
    ),
    "trajectory_reward": (
        move_object.trajectory_reward,
        {"trajectory": [(0, ZERO)], "time": 1, "position": ZERO},
    ),
    "weighted_total": (
        move_object.weighted_total,
        {"episode_rewards": {level: [1.0] for level in (1, 2, 3, 4)}, "median": False},
    ),
    "goal_masks": (rearrange_dice.goal_masks, {"rig": RIG, "goal": GOAL}),
    "error": (rearrange_dice.error, {"goal_masks": MASKS, "dice_masks": MASKS}),
    "assign": (rearrange_dice.assign, {"goal": GOAL, "positions": GOAL}),
    "locate": (rearrange_dice.locate, {"rig": RIG, "masks": [None] * 3, "images": None, "most": 25}),
    "parse_pattern": (rearrange_dice.parse_pattern, {"text": "x"}),
    "read_goal": (rearrange_dice.read_goal, {"path": "nowhere"}),
    "sample_goal": (rearrange_dice.sample_goal, {"rng": 1}),
    "segment_dice": (rearrange_dice.segment_dice, {"image": IMAGES[0], "colors": None}),
    "push": (Pushed().push, {"images": IMAGES, "timestamp": 1.0}),
    "overlay": (viz.overlay, {"images": IMAGES, "rig": RIG, "model": MODEL, "observation": NOTHING}),
    "goal_picture": (viz.goal_picture, {"goal": GOAL}),
}


@pytest.mark.parametrize("name", CALLS)
def test_what_cannot_be_taken_is_named_in_one_line(name):
    call, arguments = CALLS[name]
    messages = []
    for key in arguments:
        for value in STRANGE:
            try:
                call(**{**arguments, key: value})
            except tracker.TrackerError as error:
                messages.append(str(error))
    assert len(messages) > 10
    assert not [text for text in messages if "\n" in text]
