"""Build a rig of two cameras from numbers, write its files, and check it before use."""

import numpy as np

import tracker


def camera(name: str, position: tuple[float, float, float]) -> tracker.Camera:
    """A camera at a position [m] that looks at the arena's centre; yours come from a calibration."""
    forward = -np.array(position) / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = [right, np.cross(forward, right), forward]
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ position
    matrix = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])  # [px]
    return tracker.Camera(name, 640, 480, matrix, np.zeros(5), camera_from_world)


arena = tracker.Arena(radius=0.15, height=0.1, table_std=(0.001, 0.002))  # the table: 1 mm, 2 mrad
rig = tracker.CameraRig((camera("left", (0.5, 0.2, 0.4)), camera("right", (0.5, -0.2, 0.4))), arena)
rig.save("my_rig")

for one in tracker.CameraRig.load("my_rig"):
    corners = 0.15 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    print(one.name, "sees the arena's edge at", np.rint(one.project(corners)).tolist(), "px")
