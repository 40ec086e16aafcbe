"""Seeds of the scenes.

Development scenes have a fixed seed: you may look at them and work on them. Release scenes have a seed
derived from the measured commit: nobody has seen them before, and no other commit gets them.
"""

from __future__ import annotations

import hashlib

DEVELOPMENT = 7_301_520
"""Seed of the development scenes."""


def release(commit: str) -> int:
    """Return the seed of a commit's release scenes, from its full hash."""
    return _number(f"release of {commit}")


def stream(seed: int, *names: str) -> int:
    """Return the seed for one kind of scene; different kinds share no random draws."""
    return _number("\n".join([str(seed), *names]))


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")
