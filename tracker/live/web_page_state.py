"""What the page of `tracker live` tells of: the newest moment, and how each camera fares."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from tracker.calibration.by_object.health import LEVELS, MOST_CLIPPED, QUANTITIES, disagreement, sample, slow
from tracker.live.camera_check import MOST_BLUR, MOST_MISSING, MOST_SKEW, PictureLook
from tracker.live.moment import Moment
from tracker.pipeline import ObjectTracker

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
    **{key: QUANTITIES[key].limits for key in ("residual", "disagreement")},
}
"""Within which a camera is well, in the units of `WebPageState.message`; those of `--check` and of the health
of a recording."""


class WebPageState:
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
        self._disagreement = [math.nan] * len(self._names)

    def see(self, moment: Moment) -> None:
        """Count a moment."""
        now, taken = time.monotonic(), moment.taken
        self._latencies.append(moment.latency)
        skews = tuple(
            None if image is None else 1e3 * (taken.timestamp - stamp)
            for image, stamp in zip(taken.images, taken.stamps, strict=True)
        )
        self._seen.append((now, skews))
        self._faults.update((name, (now, fault)) for name, fault in moment.faults.items())
        while self._seen[0][0] < now - SPAN:
            self._seen.popleft()

    def look(self, moment: Moment) -> None:
        """Look at the pictures themselves, which takes some tens of milliseconds."""
        images, pose, rig = moment.taken.images, moment.filtered_object_pose, self._tracker.rig
        self._looks = [{} if image is None else PictureLook.of(image)._asdict() for image in images]
        found = None if pose is None else sample(self._tracker, images, still=slow(pose.velocity))
        if found is not None and found.look is not None and len(rig) > 1:
            self._disagreement = disagreement([found.look], rig)[0].tolist()
        for c, look in enumerate(self._looks):
            look["disagreement"] = self._disagreement[c]  # known at rest only, and then for long
            look["residual"] = math.nan if found is None else float(found.values["residual"][c])

    def message(self, moment: Moment, faults: Sequence[str]) -> dict[str, Any]:
        """What the page is told of a moment; null stands for what is not known.

        Fields: `sequence`; `time` [s]; `status`; `position` [mm], `std_mm` and `std_deg` (3), and
        `confidence` of the filtered pose; `measured`, whether these images show it; `latency` [ms] and
        `latency_ms`, its `percentiles`; `cameras`, of each its `name`, `use`, `fault`,
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
            "percentiles": PERCENTILES,
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
