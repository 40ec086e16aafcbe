"""`tracker info`: show what is in a recording or in a file of poses."""

import json
from pathlib import Path
from typing import Any

import click
import numpy as np

import tracker
from tracker.cli import options
from tracker.cli.options import argument, command, flag
from tracker.cli.outputs import InFile
from tracker.cli.terminal import bar, listing
from tracker.errors import TrackerError
from tracker.logs.opening import fitted_to
from tracker.poses.file import is_poses_file
from tracker.summaries.remarks import OUT_OF_VIEW, in_view

_GAP = 1.5  # a time between frames is a gap if it exceeds this multiple of the median


@command()
def info(
    source: Path = argument("RECORDING|POSES", InFile()),
    recover: bool = flag("Leave out damaged parts of a recording, and report them."),
    as_json: bool = options.as_json,
) -> None:
    """Show what is in a recording or in a file of poses.

    Reads all of it: format, frames, cameras and sizes, stamps and gaps, missing images, poses, and whether
    the calibration in or beside a recording fits its cameras and sizes.
    """
    if is_poses_file(source):
        found = _of_poses(tracker.read_poses(source))
    else:
        with tracker.open_log(source, recover=recover) as log:
            found = _of_log(source, log)
    if as_json:
        click.echo(json.dumps({"path": str(source), **found}, allow_nan=False))
    else:
        click.echo(listing([[name.replace("_", " "), _shown(value)] for name, value in found.items()]))


def _of_log(path: Path, log: tracker.Log) -> dict[str, Any]:
    stamps: list[float] = []
    without = dict.fromkeys(log.camera_names, 0)
    poses = 0
    with bar(path.name, len(log), False) as progress:
        for frame in log:
            stamps.append(frame.timestamp)
            poses += frame.recorded_pose is not None
            for name, image in zip(log.camera_names, frame.images, strict=True):
                without[name] += image is None
            progress(1)
    calibration, calibration_fault = None, None
    try:
        if log.rig is not None:
            rig = fitted_to(path, log)
            calibration, calibration_fault = list(rig.names), None if in_view(rig) else OUT_OF_VIEW
    except TrackerError as error:
        calibration_fault = str(error)
    return {
        "format": log.format,
        "frames": len(log),
        "readable": len(stamps),
        "cameras": list(log.camera_names),
        "sizes_px": [list(size) for size in log.image_sizes],
        **_times(np.array(stamps)),
        "without_image": {name: count for name, count in without.items() if count},
        "recorded_poses": poses,
        "episodes": len(log.episode_starts),
        "calibration": calibration,
        "calibration_fault": calibration_fault,
        "settings": {name: dict(values) for name, values in log.settings.items()},
        "fault": log.fault,
    }


def _of_poses(poses: tracker.Poses) -> dict[str, Any]:
    names, counts = np.unique(poses.status, return_counts=True)
    recorded = poses.recorded
    return {
        "format": "file of poses",
        "object": poses.about.object_name,
        "source": poses.about.source,
        "tracker_version": poses.about.tracker_version,
        "fingerprint": poses.about.fingerprint or None,
        "frames": len(poses),
        "first_frame": int(poses.index[0]) if len(poses) else None,
        "missing_frames": int(poses.index[-1] - poses.index[0]) + 1 - len(poses) if len(poses) else 0,
        **_times(poses.timestamp),
        "measured": int(poses.measured.has_pose.sum()),
        "filtered": int(poses.filtered.has_pose.sum()),
        "recorded_poses": 0 if recorded is None else int(recorded.has_pose.sum()),
        "statuses": dict(zip(names.tolist(), counts.tolist(), strict=True)),
        "cameras": list(poses.about.rig.names),
        "sizes_px": [[camera.width, camera.height] for camera in poses.about.rig],
        "fault": poses.about.fault or None,
    }


def _times(stamps: tracker.conventions.FloatArray) -> dict[str, Any]:
    """Return first timestamp and duration [s], usual rate [Hz], gaps, and number of repeated timestamps."""
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else None
    return {
        "first_stamp_s": round(float(stamps[0]), 6) if len(stamps) else None,
        "seconds": round(float(stamps[-1] - stamps[0]), 6) if len(stamps) else None,
        "rate_hz": None if usual is None else round(1 / usual, 3),
        "gaps": 0 if usual is None else int((steps > _GAP * usual).sum()),
        "longest_gap_s": round(float(steps.max()), 6) if len(steps) else None,
        "repeated_stamps": int((steps == 0).sum()),
    }


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join("×".join(map(str, one)) if isinstance(one, list) else str(one) for one in value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(one)}" for name, one in value.items()) or "none"
    return "none" if value is None else str(value)
