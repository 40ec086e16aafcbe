"""What recorded triplets say without any truth: do the cameras agree, and the sizes of the pictures?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import tracker
from benchmarks.data.recorded import triplets
from benchmarks.score.errors import placed, projected
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners

FOCAL = 295.0
"""Of the pictures in whose pixels misses are told, whatever the size of the recorded ones [px]."""

Rows = list[dict[str, Any]]


def agreement_rows(real: Path) -> Rows:
    """Rows of the parts `third camera` and `two sizes`.

    third camera: the pose from two cameras against the one that the third finds alone, in the third's
    picture: root mean square of the corners' distances `px` (at FOCAL) and, across the line of sight, `mm`;
    and against the pose of all cameras together, `shift_mm`, `turn_deg`.

    two sizes: the pose of the triplet as recorded against that of its pictures at 540 or 270 px.
    """
    rows: Rows = []
    for name, group, detector, images in triplets(real):
        about = {"object": name, "group": group, "n": 1}
        pixels = [image.image for image in images]
        whole = detector.detect(pixels).object_pose
        for k, camera in enumerate(detector.rig):
            two = detector.detect([None if j == k else image for j, image in enumerate(pixels)]).object_pose
            own = detector.detect([image if j == k else None for j, image in enumerate(pixels)]).object_pose
            row = {"part": "third camera", **about, "bin": camera.name, **_apart(two, whole)}
            rows.append(row | third_camera_miss(camera, detector.model, two, own))
        other, resized = _other_size(detector, pixels)
        rows.append({"part": "two sizes", **about, **_apart(whole, other.detect(resized).object_pose)})
    return rows


def _apart(one: tracker.PoseEstimate | None, other: tracker.PoseEstimate | None) -> dict[str, float]:
    if one is None or other is None:
        return {}
    return {
        "shift_mm": 1e3 * float(np.linalg.norm(one.position - other.position)),
        "turn_deg": float(np.degrees(so3.angle_between(one.rotation, other.rotation))),
    }


def third_camera_miss(
    camera: Camera,
    model: tracker.CuboidModel,
    two: tracker.PoseEstimate | None,
    own: tracker.PoseEstimate | None,
) -> dict[str, float]:
    """How far apart two poses are in a camera's picture: `px` at FOCAL, and across the line of sight `mm`."""
    if two is None or own is None:
        return {}
    ends = [_corners(camera, model, pose) for pose in (two, own)]
    apart = np.linalg.norm(ends[0] - ends[1], axis=1)
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    miss = float(np.sqrt(np.mean(apart**2)))
    distance = float(np.linalg.norm(two.position - camera.position))
    return {"px": miss * FOCAL / focal, "mm": 1e3 * miss * distance / focal}


def _corners(camera: Camera, model: tracker.CuboidModel, pose: tracker.PoseEstimate) -> FloatArray:
    return projected(camera, placed(corners(model.size), pose.position, pose.rotation))


def _other_size(
    detector: tracker.ObjectTracker, images: Sequence[Image]
) -> tuple[tracker.ObjectTracker, list[Image]]:
    """The same triplet at half the size if it is large, else at twice the size."""
    height = detector.rig[0].height
    size = height // 2 if height > 400 else 2 * height
    method = cv2.INTER_AREA if size < height else cv2.INTER_CUBIC
    rig = tracker.CameraRig(tuple(camera.resized(size, size) for camera in detector.rig), detector.rig.arena)
    shape = (size, size)
    resized = [np.asarray(cv2.resize(image, shape, interpolation=method), np.uint8) for image in images]
    return tracker.ObjectTracker(detector.model, rig), resized
