"""Recordings of the platform's cameras, read frame by frame, and written; the robot's states beside them."""

from tracker.logs.frame import LogFrame, RecordedPose
from tracker.logs.log import Log
from tracker.logs.opening import open_log
from tracker.logs.robot_log import Paired, RobotLog, RobotState, paired, read_robot_log

__all__ = [
    "Log",
    "LogFrame",
    "Paired",
    "RecordedPose",
    "RobotLog",
    "RobotState",
    "open_log",
    "paired",
    "read_robot_log",
]
