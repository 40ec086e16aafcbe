"""Whole recordings: the object's pose in every frame of one or many recordings.

The tracker has a memory, so the frames of a recording are tracked in order. Recordings are independent of
each other, so processes and machines can work on different ones.
"""

from tracker.recordings.track import Job, Options, Reading, Recipe, Tracked, run, track

__all__ = ["Job", "Options", "Reading", "Recipe", "Tracked", "run", "track"]
