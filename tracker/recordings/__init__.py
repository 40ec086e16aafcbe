"""Whole recordings: the object's pose in every frame of one, or of ten thousand.

The tracker has a memory, so the frames of a recording follow one another; recordings do not depend on each
other, and are what processes and machines share. Each has one file of poses, which says what it was made
from: what is there and whole is not made again.
"""

from tracker.recordings.recipe import Job, Options, Reading, Recipe
from tracker.recordings.track import Tracked, run, track

__all__ = ["Job", "Options", "Reading", "Recipe", "Tracked", "run", "track"]
