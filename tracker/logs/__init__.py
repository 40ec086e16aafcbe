"""Recordings of the platform's cameras, read frame by frame, and written."""

from tracker.logs.frame import LogFrame, RecordedPose
from tracker.logs.log import Log
from tracker.logs.opening import open_log

__all__ = ["Log", "LogFrame", "RecordedPose", "open_log"]
