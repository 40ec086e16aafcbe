"""What `tracker live` tells of: a line each second, and a summary."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tracker.cli.table import listing

if TYPE_CHECKING:
    from tracker.live import Moment

_LATENCIES = 100_000
"""Latencies that are kept for percentiles."""

_NEVER = "never found: is it this object, these colours, this calibration? --check looks at the cameras"
_NO_IMAGE = "no camera ever gave an image"

_STAMPS = ""
"""Stands for the stamps of all cameras where faults stand by cameras' names, none of which is empty."""


class Told:
    """Counts moments, in the tracking thread, for what is told in another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._statuses: Counter[str] = Counter()
        self._faults: Counter[str] = Counter()
        self._lately: Counter[str] = Counter()
        self._reasons: dict[str, str] = {}
        self._posed = self._seen = False
        self._order: dict[str, None] = {}
        self._latencies: deque[float] = deque(maxlen=_LATENCIES)
        self._newest: Moment | None = None
        self._told_count = 0
        self.begin()

    def begin(self) -> None:
        """Count the time from now."""
        self._told_at = self._begin = time.monotonic()

    def hear(self, moment: Moment) -> None:
        """A listener of `Live`."""
        with self._lock:
            self._statuses[moment.status.value] += 1
            self._latencies.append(moment.latency)
            self._newest = moment
            self._posed |= moment.object_pose is not None
            self._seen |= any(image is not None for image in moment.shot.images)
            faults = dict(moment.faults)
            if moment.jump is not None:
                faults[_STAMPS] = moment.jump
            self._order |= dict.fromkeys([_STAMPS, *moment.fault_counts, *faults])
            self._faults.update(faults.keys())
            self._lately.update(faults.keys())
            self._reasons.update(faults)

    @property
    def only_faults(self) -> bool:
        """Whether there were sets of images, and not one image in them."""
        return bool(self._statuses) and not self._seen

    def due(self) -> str | None:
        """A line about the last second, once it has passed."""
        now = time.monotonic()
        if now - self._told_at < 1.0:
            return None
        with self._lock:
            count, moment = sum(self._statuses.values()), self._newest
            lately, self._lately = self._lately, Counter()
            reasons = dict(self._reasons)
        sets = count - self._told_count
        rate = sets / (now - self._told_at)
        self._told_at, self._told_count = now, count
        parts = [f"{now - self._begin:7.1f} s", f"{rate:5.1f} Hz"]
        if moment is None:
            return "  ".join([*parts, "no images yet"])
        parts.append(f"{moment.status.value:10}")
        pose = moment.filtered_object_pose
        if pose is not None:
            place = " ".join(f"{1000 * value:7.1f}" for value in pose.position)
            parts.append(f"{place} mm  confidence {pose.confidence:.2f}")
        parts.append(f"latency {1000 * moment.latency:.1f} ms")
        faults = [f"{name or 'stamps'}: {reasons[name]} ({n} of {sets} sets)" for name, n in lately.items()]
        return "  ".join([*parts, *faults])

    def summary(self, left_out: int, faults: Sequence[str], recorder: Any = None) -> str:
        """What there was in all."""
        import numpy as np

        count = sum(self._statuses.values())
        rows = [["sets of images", f"{count}, and {left_out} that came while others were worked on"]]
        if count:
            statuses = ", ".join(
                f"{name} {100 * n / count:.1f} %" for name, n in self._statuses.most_common()
            )
            median, late = np.percentile(1e3 * np.array(self._latencies), [50, 99])
            rows.append(["status", statuses])
            if not self._posed:
                rows.append(["", _NEVER if self._seen else _NO_IMAGE])
            rows.append(["latency", f"{median:.1f} ms in the median, {late:.1f} ms in the 99th percentile"])
        for name in filter(self._faults.__contains__, self._order):
            times, reason = self._faults[name], self._reasons[name]
            rows.append([name or "stamps", f"amiss in {times} of {count} sets; last: {reason}"])
        if recorder is not None:
            recorded = f"{recorder.recorded} sets in {recorder.path}" if recorder.recorded else "nothing"
            rows.append(["recorded", recorded])
            if recorder.left_out:
                rows.append(["", f"{recorder.left_out} left out, which the disk did not take in time"])
            if recorder.fault is not None:
                rows.append(["", f"ended before its time: {recorder.fault}"])
        known = {f"{name}: {last}" if name else f"stamps {last}" for name, last in self._reasons.items()}
        more = [fault for fault in faults if fault not in known]
        rows += [["fault", fault] for fault in more[-5:]]
        return listing(rows)
