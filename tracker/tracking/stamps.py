"""When a set of pictures was taken: at once, or by one camera after another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import TrackerError


class Stamps(NamedTuple):
    """The moment for which a pose is asked, and how much older the pictures are."""

    latest: float
    """[s]"""
    delays: FloatArray
    """(C,) [s], zero for cameras without a picture."""


def check_stamps(timestamp: float | Sequence[float], given: Sequence[bool]) -> Stamps:
    """The stamps of C cameras' pictures, from one [s] for all or one for each; given: who gave a picture.

    Raises:
        TrackerError: they are not numbers, not one for each camera, or not finite where there is a picture.
    """
    try:
        stamps = np.asarray(timestamp, dtype=np.float64)
    except (TypeError, ValueError):
        raise TrackerError(f"timestamp: found {timestamp!r}, expected seconds") from None
    if stamps.ndim == 0:
        return Stamps(float(stamps), np.zeros(len(given)))
    if stamps.shape != (len(given),):
        found = f"{len(stamps)} stamps" if stamps.ndim == 1 else f"an array of shape {stamps.shape}"
        raise TrackerError(f"timestamp: found {found}, expected one, or one for each of {len(given)} cameras")
    seen = np.array(given)
    if not np.isfinite(stamps[seen if seen.any() else slice(None)]).all():
        raise TrackerError(f"timestamp: found {stamps.tolist()}, expected finite numbers of seconds")
    latest = float(stamps[seen].max()) if seen.any() else float(np.max(stamps))
    return Stamps(latest, np.where(seen, latest - np.where(seen, stamps, latest), 0.0))
