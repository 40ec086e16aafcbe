"""A frame: one image of each camera, and the ground truth."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np

from synthetic.camera.miscalibration import Calibrated
from synthetic.render.renderer import NAME
from synthetic.scene import ObjectState, PlatformScene
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One image of each camera, and the ground truth."""

    renderer: ClassVar[str] = NAME

    index: int
    timestamp: float
    """[s]"""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR, distorted, as cameras return them; raw ones are RGGB mosaics (H, W)."""
    labels: tuple[Image, ...]
    """(H, W) uint8 label map, by majority: 0 other, 1 red … 6 yellow; of dice their number."""
    visible_fraction: FloatArray
    """(cameras,) share of the object's pixels that the robot leaves visible; 0 where there are none."""
    visible_px: Array
    """(cameras,) visible pixels of the object."""
    scene: PlatformScene
    """The scene itself, in the simulation's world."""
    calibrated: Calibrated
    """The true cameras and what their calibration states."""
    stamps: FloatArray
    """(cameras,) timestamp of each image: the middle of its exposure [s]; the latest is `timestamp`."""
    scenes: tuple[PlatformScene, ...]
    """The scene at each camera's timestamp."""
    alone: tuple[Image, ...]
    """(H, W) uint8 label map of the objects alone, without robot or surroundings."""

    @property
    def objects(self) -> tuple[ObjectState, ...]:
        """Exact states of the object or all dice at `timestamp`, in the calibrated world; empty: none."""
        return tuple(self.calibrated.in_calibrated_world(state) for state in self.scene.objects)

    @property
    def objects_at_stamps(self) -> tuple[tuple[ObjectState, ...], ...]:
        """Exact states of the objects at each camera's timestamp."""
        return tuple(
            tuple(self.calibrated.in_calibrated_world(state) for state in scene.objects)
            for scene in self.scenes
        )

    @property
    def rig(self) -> CameraRig:
        """The true cameras."""
        return self.calibrated.rig

    @property
    def given(self) -> CameraRig:
        """The calibration that a user is given."""
        return self.calibrated.given

    def truth(self) -> dict[str, Any]:
        """Return the entry for `ground_truth.json`."""
        cameras: dict[str, dict[str, Any]] = {}
        for c, camera in enumerate(self.rig):
            own = cameras[camera.name] = {
                "visible_fraction": float(self.visible_fraction[c]),
                "visible_px": int(self.visible_px[c]),
            }
            # True calibration if the stated one differs; timestamp and poses if they are the camera's own.
            if self.calibrated.calibrated_from_world is not None:
                for key in ("matrix", "distortion", "camera_from_world"):
                    own[key] = getattr(camera, key).tolist()
            if any(stamp != self.timestamp for stamp in self.stamps):
                own["timestamp"], own["object"] = float(self.stamps[c]), _told(self.objects_at_stamps[c])
        return {
            "frame": f"{self.index:06d}",
            "timestamp": self.timestamp,
            "object": _told(self.objects),
            "robot_position": np.asarray(self.scene.robot_position).tolist(),
            "cameras": cameras,
            "scene": self.scene.about,
        }


def _told(states: tuple[ObjectState, ...]) -> Any:
    """Return None, one pose, or the poses of all dice."""
    poses = [
        {
            "position": state.position.tolist(),
            "orientation_xyzw": so3.quaternion_from_matrix(state.rotation).tolist(),
        }
        for state in states
    ]
    return None if not poses else poses[0] if len(poses) == 1 else poses
