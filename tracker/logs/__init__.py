"""Reads and writes recordings of the platform's cameras frame by frame, and reads the robot's logs."""

from tracker.logs.frame import LogFrame as LogFrame
from tracker.logs.frame import RecordedPose as RecordedPose
from tracker.logs.log import Log as Log
from tracker.logs.opening import open_log as open_log
from tracker.logs.robot_log import Paired as Paired
from tracker.logs.robot_log import RobotLog as RobotLog
from tracker.logs.robot_log import RobotState as RobotState
from tracker.logs.robot_log import paired as paired
from tracker.logs.robot_log import read_robot_log as read_robot_log
