"""A word of warning where pictures look as if they were given to the wrong cameras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from tracker.conventions import Image
    from tracker.logs import Log
    from tracker.pipeline import ObjectTracker
    from tracker.pose.result import Observation
    from tracker.recordings import Recipe

_MEASURED, _CONTRADICTED = 0.8, 0.1
"""Share of the frames below which, or above which, a recording is looked at again."""

_LOOKS = 7


def warn_of_pictures(
    tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation, names: Sequence[str]
) -> None:
    """The same of one set of pictures, with what was found in it."""
    from tracker.upkeep.swapped import swapped, told

    order = swapped(tracker, images, answer)
    if order is not None:
        _say(told(order, names))


def warn_of_recording(result: dict[str, Any], recipe: Recipe) -> None:
    """The same of a tracked recording, see `tracker.recordings.summary`, if little came of it."""
    from tracker.logs import open_log
    from tracker.pipeline import ObjectTracker
    from tracker.recordings import Job
    from tracker.recordings.track import chosen, rig_for
    from tracker.upkeep.swapped import lastingly_swapped, told

    if not _is_odd(result):
        return
    path = Path(result["log"])
    job = Job(path, path, recipe)
    with open_log(path, recover=True) as log:
        rig = rig_for(job, log)
        order = lastingly_swapped(
            ObjectTracker(recipe.model, rig, recipe.colors), _sets(log, *chosen(log, job))
        )
    if order is not None:
        _say(f"{path}: {told(order, rig.names)}")


def _is_odd(result: dict[str, Any]) -> bool:
    if not result["frames"]:
        return False
    shares = [uses["contradicting"] or 0.0 for uses in (result["cameras"] or {}).values()]
    return result["measured"] < _MEASURED or max(shares, default=0.0) > _CONTRADICTED


def _sets(log: Log, first: int, last: int) -> Iterator[Sequence[Image | None]]:
    """Pictures of some frames; of a recording that has to be read through, of the first ones."""
    step = max(1, (last - first) // _LOOKS) if log.random_access else 1
    return (frame.images for frame in log[first:last:step])


def _say(message: str) -> None:
    click.echo(f"tracker: warning: {message}", err=True)
