"""Which scenes are measured: their seeds, how many there are, and where they are cached.

Development scenes have a fixed seed: you may look at them and work on them. Release scenes have a seed
derived from the measured commit: nobody has seen them before, and no other commit gets them.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.data.fingerprint import ROOT

CACHE = ROOT / "build" / "scenes"
"""Default folder of rendered scenes; not in the repository."""

DEVELOPMENT = 7_301_520
"""Seed of the development scenes."""

FULL = 200
"""Number of scenes per object in a full run."""

EFFECT, LOOK_ALIKE, RIG = "effect: ", "look-alike: ", "rig: "
"""Prefixes of the sets of scenes with a single effect, with one kind of look-alike, and with another rig; the
workloads on these sets have the same names."""

SHARES: Mapping[str, float] = {
    "realistic": 1.0,
    "world": 1.0,
    "absent": 0.5,
    "large": 0.1,
    "other cubes": 0.15,
    "package": 0.1,
    "smooth package": 0.1,
    "lens package": 0.1,
    LOOK_ALIKE: 0.1,
    EFFECT: 0.1,
    RIG: 0.02,
    "film": 0.5,
    "motion": 0.2,
    "thrown": 0.2,
    "laid": 0.1,
}
"""Size of each set relative to a full run, by its name or prefix: scenes, or frames of each film."""


@dataclass(frozen=True)
class Plan:
    """Which scenes are rendered, how many, and where they are cached."""

    scenes: int = FULL
    """Number of scenes of an object."""
    seed: int = DEVELOPMENT
    workers: int = 2
    """Number of processes that render missing scenes."""
    cache: Path = CACHE
    """Folder of rendered scenes."""
    shares: Mapping[str, float] = field(default_factory=lambda: SHARES)
    """Size of each set relative to `scenes`."""

    def count(self, base: str) -> int:
        """Return the number of scenes of a set, or of frames of a film."""
        kind = base if base in self.shares else base[: base.index(": ") + 2]
        return max(1, round(self.shares[kind] * self.scenes))


def release(commit: str) -> int:
    """Return the seed of a commit's release scenes, from its full hash."""
    return _number(f"release of {commit}")


def stream(seed: int, *names: str) -> int:
    """Return the seed for one kind of scene; different kinds share no random draws."""
    return _number("\n".join([str(seed), *names]))


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")
