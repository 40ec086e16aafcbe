"""A word of warning where pictures look as if they were given to the wrong cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from tracker.conventions import Image
    from tracker.pipeline import ObjectTracker
    from tracker.pose.result import Observation


def warn_of_pictures(
    tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation, names: Sequence[str]
) -> None:
    """Say so of one set of pictures, with what was found in it."""
    from tracker.recordings.outcome.swapped import swapped, told

    order = swapped(tracker, images, answer)
    if order is not None:
        click.echo(f"tracker: warning: {told(order, names)}", err=True)
