"""Recordings of the platform's cameras, read frame by frame, and the poses that were found in them."""

from tracker.logs.frame import LogFrame, RecordedPose
from tracker.logs.log import Log
from tracker.logs.opening import open_log

__all__ = ["Log", "LogFrame", "RecordedPose", "open_log"]
