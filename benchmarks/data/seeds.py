"""Which scenes are drawn.

Development scenes come from a seed that stays: they may be looked at and worked on. Release scenes come from
a seed drawn from the commit that is measured: nobody has seen them before, and no other commit gets them.
"""

from __future__ import annotations

import hashlib

DEVELOPMENT = 7_301_520
"""Seed of scenes that may be looked at."""


def release(commit: str) -> int:
    """Seed of the scenes that judge a commit, by its full hash."""
    return _number(f"release of {commit}")


def stream(seed: int, *names: str) -> int:
    """Seed of one kind of scenes: no two kinds share any draw."""
    return _number("\n".join([str(seed), *names]))


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")
