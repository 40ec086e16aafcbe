"""Whole recordings: the object's pose in every frame, in several processes, and again after a break.

The tracker has a memory, so the frames of a recording are not independent. A recording is therefore cut
into parts, always in the same way; each starts without memory, after a run-up of frames whose results are
dropped. The poses are thus the same to the bit, however many processes share the work and however often
it was broken off.
"""

from tracker.recordings.job import Job
from tracker.recordings.pool import Workers
from tracker.recordings.track import Tracked, track

__all__ = ["Job", "Tracked", "Workers", "track"]
