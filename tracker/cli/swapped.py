"""A word of warning where pictures look as if they were of the wrong cameras, channels or object."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from tracker.conventions import Image
    from tracker.live import Moment
    from tracker.pipeline import ObjectTracker
    from tracker.pose.result import Observation

FIRST_LOOK = 1.0
"""How long cameras run before their pictures are looked at [s]."""


def warn_of_pictures(
    tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation, names: Sequence[str]
) -> None:
    """Say so of one set of pictures, with what was found in it."""
    from tracker.recordings.outcome.swapped import mistaken, swapped, told

    order = swapped(tracker, images, answer)
    said = mistaken(tracker, images, answer) if order is None else told(order, names)
    if said is not None:
        click.echo(f"tracker: warning: {said}", err=True)


class Lookout:
    """Looks, until something is surely found, whether pictures of cameras that run come from the wrong ones.

    A look takes as long as some detections, in the caller's thread; each waits twice as long as the last.

    Args:
        make_tracker: makes a tracker of the object and the cameras, for the looks alone.
        names: of the cameras.
    """

    def __init__(self, make_tracker: Callable[[], ObjectTracker], names: Sequence[str]) -> None:
        self._make, self._names = make_tracker, names
        self._tracker: ObjectTracker | None = None
        self._pause = FIRST_LOOK
        self._due = time.monotonic() + self._pause
        self._orders: Counter[tuple[int, ...]] = Counter()
        self._over = False

    def look(self, moment: Moment | None) -> str | None:
        """What is to be said after the newest moment, once; None: nothing."""
        from tracker.pose.result import CameraUse
        from tracker.recordings.outcome.swapped import SURE, swapped, told

        if self._over or moment is None:
            return None
        pose = moment.object_pose
        if pose is not None and pose.confidence >= SURE and CameraUse.CONTRADICTING not in moment.cameras:
            self._over = True
            return None
        if time.monotonic() < self._due:
            return None
        self._tracker = self._tracker or self._make()
        order = swapped(self._tracker, moment.shot.images)
        self._pause *= 2
        self._due = time.monotonic() + self._pause
        if order is None:
            return None
        self._orders[order] += 1
        # A second look may be at the same scene, but not at the same noise.
        self._over = self._orders[order] == 2
        return told(order, self._names) if self._over else None
