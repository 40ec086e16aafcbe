"""What is published of a moment: one JSON object."""

from __future__ import annotations

import json
from typing import Any

from tracker.live.moment import Moment

VERSION = 2
"""Of the message; it grows when a field changes its meaning or goes, not when one is added."""


def message_of(moment: Moment) -> bytes:
    """The message, UTF-8: the filtered pose of the newest images, or null where the object is lost.

    Fields: `version`; `sequence`, of the set of images; `timestamp`, of its latest image [s]; `status`;
    `pose`, with `position` (3) [m], `orientation` (4) xyzw, `covariance` (6, 6) of (δp, δθ) along world
    axes [m, rad] and `confidence`, or null; `velocity` (6) [m/s, rad/s] or null; `latency_ms`, from the
    latest image to the pose; `faults`, what was wrong with this set, texts by the camera's name; `jump`, how
    all stamps jumped before it, or null; `fault_counts`, in how many sets since the start something was wrong
    with each camera, and `jump_count`: of sets that a subscriber never fetched, they tell.
    """
    pose = moment.filtered_object_pose
    content: dict[str, Any] = {
        "version": VERSION,
        "sequence": moment.sequence,
        "timestamp": moment.timestamp,
        "status": moment.status.value,
        "pose": None if pose is None else pose.as_json(),
        "velocity": None if pose is None else pose.velocity.tolist(),
        "latency_ms": 1e3 * moment.latency,
        "faults": dict(moment.faults),
        "jump": moment.jump,
        "fault_counts": dict(moment.fault_counts),
        "jump_count": moment.jump_count,
    }
    return json.dumps(content, allow_nan=False).encode()
