"""What the tracker does on rendered scenes, whose pose is known exactly."""

from __future__ import annotations

import numpy as np

import tracker
from synthetic.raycast import render
from synthetic.sensor import Sensor
from synthetic.simple import random_scene
from synthetic.simple_rig import default_cameras
from tracker.conventions import FloatArray
from tracker.geometry import so3

SEED = 2026
OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")


def answers(name: str, scenes: int, *, present: bool = True) -> FloatArray:
    """(N, 5): visible fraction, errors [m] and [rad], confidence, NEES; NaN where there is no pose."""
    model, rig = tracker.load_object(name), tracker.CameraRig(default_cameras())
    detector = tracker.ObjectTracker(model, rig)
    rows = []
    for k in range(scenes):
        rng = np.random.default_rng([SEED, k])
        scene = random_scene(model, rng, object_present=present)
        truth = render(scene, rig.cameras, model, Sensor.realistic(), rng)
        pose = detector.detect(truth.images).object_pose
        visible = float(np.mean(truth.visible_fraction))
        if pose is None or truth.position is None or truth.rotation is None:
            rows.append([visible, np.nan, np.nan, 0.0 if pose is None else pose.confidence, np.nan])
            continue
        error = np.concatenate([pose.position - truth.position, so3.log(pose.rotation @ truth.rotation.T)])
        nees = float(error @ np.linalg.solve(pose.covariance, error))
        rows.append([visible, np.linalg.norm(error[:3]), np.linalg.norm(error[3:]), pose.confidence, nees])
    return np.array(rows)


def accuracy_table(scenes: int) -> str:
    """Errors over all scenes, fingers and sensor included; misses and wrong answers by themselves."""
    rows = [
        "| object | median position, rotation | p90 | within 5 mm and 5° | no pose | wrong | "
        "wrong and sure (> 0.5) | NEES, median (ideal 5.35) | found where there is none |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in OBJECTS:
        result = answers(name, scenes)
        found = np.isfinite(result[:, 1])
        position, rotation = 1e3 * result[found, 1], np.degrees(result[found, 2])
        right = (position < 5) & (rotation < 5)
        empty = answers(name, scenes // 4, present=False)
        rows.append(
            f"| {name} | {np.median(position):.3f} mm, {np.median(rotation):.2f}° | "
            f"{np.quantile(position, 0.9):.2f} mm, {np.quantile(rotation, 0.9):.2f}° | "
            f"{100 * right.sum() / scenes:.1f} % | {100 * np.mean(~found):.1f} % | "
            f"{100 * np.sum(~right) / scenes:.1f} % | "
            f"{100 * np.sum(~right & (result[found, 3] > 0.5)) / scenes:.1f} % | "
            f"{np.median(result[found, 4]):.1f} | {np.sum(empty[:, 3] > 0)} of {len(empty)} |"
        )
    return "\n".join(rows)
