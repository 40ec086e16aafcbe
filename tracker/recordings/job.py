"""What is to be done with one recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tracker.recordings.recipe import Recipe


@dataclass(frozen=True, eq=False)
class Job:
    """A recording, what to look for in it, and where the poses go."""

    log: Path
    """The recording."""
    output: Path
    """The file of poses."""
    recipe: Recipe
    """What is looked for and how."""
