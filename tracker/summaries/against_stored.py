"""Compares poses with those stored in a data set: differences, delay, and flips."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.poses.columns import PoseColumns
from tracker.poses.poses import KINDS, Kind, Poses, compare
from tracker.summaries.summary import best_kind

NEAR = 0.005  # distance [m] below which a stored position counts as near

FLIP = np.radians(45)
"""Angle [rad] above which orientations show different faces; no turn between images is as large."""

LAGS = np.linspace(-0.1, 0.5, 61)  # candidate delays [s]
MOVING = 0.005
"""Smallest standard deviation of the positions [m] that shows a delay."""
UNSURE = 0.02
"""Smallest standard deviation of a delay [s] that leaves it unknown."""

_LONGEST = 0.25  # time between poses [s] up to which positions are interpolated: one may be missing
_GROSS = 0.1  # distance [m] above which a stored pose is not used to estimate the delay


def differences(parts: Sequence[tuple[Poses, FloatArray]]) -> dict[str, Any]:
    """Compare poses over the episodes of one robot; unknown values are None.

    Args:
        parts: poses of each episode, with the stored ones as the recorded poses, and the delays (n,) that are
            stored with them [s].

    Returns:
        The fields of `compare`; `bias_mm`, medians of ours minus stored along x, y, z; `share_within_5mm` and
        `share_turned`, the shares of frames with both poses in which these are nearer than NEAR, or turned by
        more than FLIP; `flips` and `stored_flips`, the numbers of turns by more than FLIP between consecutive
        frames; `delay_s`, see `delay`; `stored_delay_s`, the median of the stored delays.
    """
    episodes, delays = zip(*parts, strict=True)
    kind: Kind = "filtered" if "filtered" in map(best_kind, episodes) else "measured"
    ours = KINDS[kind].joined([poses.columns(kind) for poses in episodes])
    theirs = PoseColumns.joined([poses.columns("recorded") for poses in episodes])
    both = ours.has_pose & theirs.has_pose
    shift = (ours.position - theirs.position)[both]
    angle = so3.angle_between(ours.rotation[both], theirs.rotation[both])
    stated = np.concatenate(delays)
    stated = stated[np.isfinite(stated)]
    some = len(shift) > 0
    return {
        **compare(ours, theirs),
        "bias_mm": (1e3 * np.median(shift, axis=0)).tolist() if some else None,
        "share_within_5mm": float(np.mean(np.linalg.norm(shift, axis=1) < NEAR)) if some else None,
        "share_turned": float(np.mean(angle > FLIP)) if some else None,
        "flips": sum(_flips(poses.columns(kind)) for poses in episodes),
        "stored_flips": sum(_flips(poses.columns("recorded")) for poses in episodes),
        "delay_s": delay(episodes),
        "stored_delay_s": float(np.median(stated)) if len(stated) else None,
    }


def delay(parts: Sequence[Poses]) -> float | None:
    """Estimate how far recorded positions lag behind ours [s], from the maximum of their cross-correlation.

    Deviations from each part's mean are correlated, so neither bias nor scale matters. None if the object
    hardly moves, or so evenly that the delay is UNSURE, or the maximum is not inside LAGS.
    """
    products, ours_squared = np.zeros(len(LAGS)), np.zeros(len(LAGS))
    theirs_squared, count = 0.0, 0
    for poses in parts:
        ours, theirs, times = poses.columns(best_kind(poses)), poses.columns("recorded"), poses.timestamp
        seen = ours.has_pose & (poses.status != "coasting")  # predictions show no delay
        if not seen.any():
            continue
        own = ours.position[seen], times[seen]
        window, known = theirs.has_pose, np.concatenate([[-np.inf], own[1], [np.inf]])
        for gap in np.flatnonzero(np.diff(known) > _LONGEST):
            window = window & ((times <= known[gap] + LAGS[0]) | (times >= known[gap + 1] + LAGS[-1]))
        window[window] = np.linalg.norm(_at(times[window], *own) - theirs.position[window], axis=1) < _GROSS
        if not window.any():
            continue
        shown = _centred(theirs.position[window])
        shifted = [_centred(_at(times[window] - lag, *own)) for lag in LAGS]
        products += [np.sum(one * shown) for one in shifted]
        ours_squared += [np.sum(one * one) for one in shifted]
        theirs_squared, count = theirs_squared + float(np.sum(shown * shown)), count + len(shown)
    if not count or min(theirs_squared, ours_squared.min()) < count * MOVING**2:
        return None
    agreement = products / np.sqrt(ours_squared * theirs_squared)
    best = int(np.argmax(agreement))
    if best in (0, len(LAGS) - 1):
        return None
    near = slice(max(best - 10, 0), best + 11)  # a period: interpolated between images, errors are smaller
    bend = -2 * float(np.polyfit(LAGS[near] - LAGS[best], agreement[near], 2)[0])
    # The Cramér-Rao bound with errors of the size that the maximum shows.
    if max(1 - agreement[best] ** 2, 1e-6) >= UNSURE**2 * 3 * count * agreement[best] * bend:
        return None
    before, at, after = agreement[best - 1 : best + 2]
    curve = before - 2 * at + after
    return float(LAGS[best] + (0.5 * (before - after) / curve if curve else 0.0) * (LAGS[1] - LAGS[0]))


def _at(times: FloatArray, positions: FloatArray, stamps: FloatArray) -> FloatArray:
    return np.stack([np.interp(times, stamps, positions[:, k]) for k in range(3)], axis=1)


def _centred(positions: FloatArray) -> FloatArray:
    return np.asarray(positions - positions.mean(axis=0))


def _flips(columns: PoseColumns) -> int:
    rotations, has_pose = columns.rotation, columns.has_pose
    follow = has_pose[1:] & has_pose[:-1]
    return int(np.sum(so3.angle_between(rotations[1:][follow], rotations[:-1][follow]) > FLIP))
