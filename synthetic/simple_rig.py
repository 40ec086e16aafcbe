"""What looks at a scene where no calibration is given: three cameras like the platform's."""

from __future__ import annotations

import numpy as np

from tracker.geometry.camera import Camera

_DISTORTIONS = (
    (-0.236, 0.112, -0.0012, 0.0003, -0.041),
    (-0.233, 0.106, -0.0021, 0.0001, -0.034),
    (-0.239, 0.121, -0.0008, -0.0002, -0.052),
)
_FOCALS_PX = ((294.2, 295.9), (293.1, 294.6), (295.0, 296.3))
_PRINCIPAL_POINTS_PX = ((138.4, 136.1), (132.7, 139.8), (140.2, 133.5))
_AZIMUTHS_DEG = (60, 180, 300)
_POSITIONS_M = ((0.345, 0.392), (0.328, 0.408), (0.339, 0.398))
_TARGETS_M = ((0.004, -0.006, 0.012), (-0.005, 0.002, 0.004), (0.002, 0.007, 0.008))


def default_cameras(width: int = 270) -> tuple[Camera, ...]:
    """Three cameras, 60, 180 and 300 degrees around the arena, with square images of `width` pixels.

    They differ a little from each other, as on a real platform, and their standard deviations are zero:
    images rendered through them obey them exactly.
    """
    return tuple(_camera(index).resized(width, width) for index in range(len(_AZIMUTHS_DEG)))


def _camera(index: int) -> Camera:
    azimuth = np.radians(_AZIMUTHS_DEG[index])
    radius, height = _POSITIONS_M[index]
    position = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    forward = np.asarray(_TARGETS_M[index]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ position

    (fx, fy), (cx, cy) = _FOCALS_PX[index], _PRINCIPAL_POINTS_PX[index]
    return Camera(
        name=f"camera{_AZIMUTHS_DEG[index]}",
        width=270,
        height=270,
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.array(_DISTORTIONS[index]),
        camera_from_world=camera_from_world,
        camera_from_world_std=np.zeros((4, 4)),
    )
