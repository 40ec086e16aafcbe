"""What the page of `tracker live` tells of: the newest moment, and how each camera fares."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from tracker.calibration.check import LIMIT, misses_of
from tracker.live.camera_check import (
    MOST_BLUR,
    MOST_CLIPPED,
    MOST_MISSING,
    MOST_SKEW,
    PictureLook,
)
from tracker.live.moment import Moment
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import apparent
from tracker.upkeep.check import SLOW, SURE, look_of
from tracker.upkeep.health import QUANTITIES
from tracker.upkeep.picture import LEVELS

SPAN = 10.0
"""Over which rates, skews and missing pictures are counted [s]."""

LATENCIES = 600
"""Latencies of which percentiles are told: a minute of cameras at 10 Hz."""

PERCENTILES = (50, 90, 99, 100)

LIMITS = {
    "missing": (0.0, 100 * MOST_MISSING),
    "skew": (0.0, 1e3 * MOST_SKEW),
    "level": LEVELS,
    "clipped": (0.0, 100 * MOST_CLIPPED),
    "blur": (0.0, MOST_BLUR),
    "residual": QUANTITIES["residual"].limits,
    "disagreement": (0.0, 1e3 * LIMIT),
}
"""Within which a camera is well, in the units of `PageState.message`; those of `--check` and of the health of
a recording."""


class PageState:
    """Counts moments; for one thread.

    Args:
        tracker: of the object and cameras, for looks of its own: not the one that `Live` has.
    """

    def __init__(self, tracker: ObjectTracker) -> None:
        self._tracker, self._names = tracker, tracker.rig.names
        self._latencies: deque[float] = deque(maxlen=LATENCIES)
        self._seen: deque[tuple[float, tuple[float | None, ...]]] = deque()
        self._faults: dict[str, tuple[float, str]] = {}
        self._looks: list[dict[str, float]] = [{} for _ in self._names]

    def see(self, moment: Moment) -> None:
        """Count a moment."""
        now, shot = time.monotonic(), moment.shot
        self._latencies.append(moment.latency)
        skews = tuple(
            None if image is None else 1e3 * (shot.timestamp - stamp)
            for image, stamp in zip(shot.images, shot.stamps, strict=True)
        )
        self._seen.append((now, skews))
        self._faults.update((name, (now, fault)) for name, fault in moment.faults.items())
        while self._seen[0][0] < now - SPAN:
            self._seen.popleft()

    def look(self, moment: Moment) -> None:
        """Look at the pictures themselves, which takes some tens of milliseconds."""
        images = moment.shot.images
        before = self._looks
        self._looks = [{} if image is None else _told(PictureLook.of(image)) for image in images]
        for image, look, old in zip(images, self._looks, before, strict=True):
            if image is not None and "disagreement" in old:  # known at rest only, and then for long
                look["disagreement"] = old["disagreement"]
        pose = moment.filtered_object_pose
        if pose is None or not any(image is not None for image in images):
            return
        fit = self._tracker.fit(images)
        if not isinstance(fit, Fit) or apparent(fit) < SURE:
            return
        for look, seen in zip(self._looks, fit.cameras, strict=True):
            if seen["inliers"] >= 1.0:
                look["residual"] = math.sqrt(seen["squares"] / seen["inliers"])
        speeds = np.linalg.norm(pose.velocity.reshape(2, 3), axis=1)
        if fit.own is not None and (speeds < SLOW).all():
            cameras = self._tracker.rig.cameras
            angles = np.array([camera.matrix[[0, 1], [0, 1]] for camera in cameras])
            misses = 1e3 * np.linalg.norm(misses_of([look_of(fit)], cameras)[0] / angles, axis=-1)
            for look, miss in zip(self._looks, misses.tolist(), strict=True):
                look["disagreement"] = miss

    def message(self, moment: Moment, faults: Sequence[str]) -> dict[str, Any]:
        """What the page is told of a moment; null stands for what is not known.

        Fields: `sequence`; `time` [s]; `status`; `position` [mm], `std_mm` and `std_deg` (3), and
        `confidence` of the filtered pose; `measured`, whether these images show it; `latency` [ms] and
        `latency_ms`, its percentiles `PERCENTILES`; `cameras`, of each its `name`, `use`, `fault`,
        `last_fault` of the last SPAN and how long ago that was, `last_fault_age` [s], `rate` [Hz], `missing`
        [%], `skew` [ms], median grey `level`, `clipped` [%], `blur` [px], `residual` [px], `disagreement`
        [mrad], and `beyond`, which of them are beyond `LIMITS`; `faults`, the last of them.
        """
        pose = moment.filtered_object_pose
        std = None if pose is None else np.sqrt(np.diag(pose.covariance))
        return {
            "sequence": moment.sequence,
            "time": moment.timestamp,
            "status": moment.status.value,
            "measured": moment.object_pose is not None,
            "position": None if pose is None else (1e3 * pose.position).tolist(),
            "std_mm": None if std is None else (1e3 * std[:3]).tolist(),
            "std_deg": None if std is None else np.degrees(std[3:]).tolist(),
            "confidence": None if pose is None else float(pose.confidence),
            "latency": 1e3 * moment.latency,
            "latency_ms": [float(np.percentile(self._latencies, p)) * 1e3 for p in PERCENTILES],
            "cameras": [self._camera(c, moment) for c in range(len(self._names))],
            "faults": list(faults[-5:]),
        }

    def _camera(self, c: int, moment: Moment) -> dict[str, Any]:
        skews = [each[c] for _, each in self._seen]
        there = [skew for skew in skews if skew is not None]
        seconds = self._seen[-1][0] - self._seen[0][0]
        values: dict[str, float | None] = {
            "rate": len(there) / len(skews) * (len(skews) - 1) / seconds if seconds > 0 else None,
            "missing": 100 * (1 - len(there) / len(skews)),
            "skew": float(np.median(there)) if there else None,
        }
        values |= {key: self._looks[c].get(key) for key in LIMITS if key not in values}
        known = {key: value for key, value in values.items() if value is not None and math.isfinite(value)}
        beyond = [k for k, (low, high) in LIMITS.items() if k in known and not low <= known[k] <= high]
        name, uses = self._names[c], moment.cameras
        when, last = self._faults.get(name, (-math.inf, None))
        age = self._seen[-1][0] - when
        return {
            "name": name,
            "use": uses[c].value if uses else None,
            "fault": moment.faults.get(name),
            "last_fault": last if age <= SPAN else None,
            "last_fault_age": age if age <= SPAN else None,
            **{key: known.get(key) for key in values},
            "beyond": beyond,
        }


def _told(look: PictureLook) -> dict[str, float]:
    return {"level": look.level, "clipped": 100 * look.clipped, "blur": look.blur}
