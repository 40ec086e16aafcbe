"""How a recording is cut into parts that can be tracked by themselves."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

PART = 300
"""Frames in a part: half a minute at 10 Hz, a second or so of work, which a break costs at most."""

RUN_UP = 20
"""Frames before a part that are tracked as well, so that the filter has settled where the part starts."""


@dataclass(frozen=True)
class Part:
    """Consecutive frames."""

    number: int
    """From 0 on."""
    run_up: int
    """Number of the first frame that is tracked."""
    start: int
    """Number of the first frame whose result is kept."""
    stop: int
    """Number of the first frame of the next part."""


def cut(first: int, last: int, episode_starts: Sequence[int] = (0,)) -> list[Part]:
    """The parts of frames `first` ≤ number < `last`; none has a run-up from another episode.

    Args:
        first: number of the first frame.
        last: number after that of the last frame.
        episode_starts: increasing numbers of frames before which memory ends.
    """
    parts = []
    for number, start in enumerate(range(first, last, PART)):
        before = bisect_right(episode_starts, start)
        episode = episode_starts[before - 1] if before else first
        run_up = max(first, episode, start - RUN_UP)
        parts.append(Part(number, run_up, start, min(start + PART, last)))
    return parts


def runs(parts: Sequence[Part], *, count: int, sequential: bool) -> list[list[Part]]:
    """Parts that one process tracks one after the other.

    Args:
        parts: all that are left to do.
        count: number of processes.
        sequential: whether to read a frame is to read all before it, so that it is better done once.
    """
    if not sequential:
        return [[part] for part in parts]
    size = -(-len(parts) // count) if parts else 1
    return [list(parts[k : k + size]) for k in range(0, len(parts), size)]
