"""Silhouettes of the robot in the cameras' images, from its joint angles."""

from collections.abc import Sequence

import cv2
import numpy as np

from synthetic.camera.lens import Lens
from synthetic.closing import Closing
from synthetic.render.raster import paint
from synthetic.scene import Mesh
from synthetic.world.assets import find_assets
from synthetic.world.simulation import World, robot_meshes
from tracker.calibration.rig import CameraRig
from tracker.checks import float_array, is_whole, of_kind
from tracker.conventions import Array, FloatArray
from tracker.errors import TrackerError, shown


class FingerMasks(Closing):
    """Silhouettes of the platform's robot in a rig's images; a context manager.

    They ignore objects, so they include anything that covers a finger. Remove pixels in the object's colours
    before you pass them to `detect` or `update` as `hidden`: `examples/hidden_fingers.py`.

    Args:
        rig: the cameras, as given by their calibration.
        margin: how far the masks extend beyond the robot [px].

    Raises:
        AssetError: the robot's meshes are not available.
        TrackerError: the rig is not a CameraRig, or the margin is not a whole number of pixels from 0.
    """

    def __init__(self, rig: CameraRig, margin: int = 0) -> None:
        of_kind(rig, CameraRig, "rig", TrackerError)
        if not is_whole(margin) or margin < 0:
            raise TrackerError(f"margin: found {shown(margin)}, expected a whole number of pixels from 0")
        self._lenses = [Lens(camera, 1) for camera in rig.cameras]
        size = 2 * margin + 1
        self._brush = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)
        assets = find_assets()
        self._world = World(assets, np.ones(3), 0)
        self._meshes = robot_meshes(self._world, assets)

    def close(self) -> None:
        """Free the simulation."""
        self._world.close()

    def __call__(self, joints: Sequence[float] | Array) -> list[Array | None]:
        """Return, for each camera, the pixels (H, W) bool that the robot covers.

        joints: angles (9,) [rad] in the order of the platform's logs, see `tracker.logs.paired`; if one is
            NaN, as before the first step of a log, each mask is None.

        Raises:
            TrackerError: they are not nine numbers.
        """
        angles = float_array(joints, (9,), "joints", TrackerError, finite=False)
        if not np.isfinite(angles).all():
            return [None] * len(self._lenses)
        self._world.set_joints(angles)
        bodies = [(link, mesh, self._world.link_pose(link)) for link, mesh in self._meshes.items()]
        return [self._mask(lens, bodies) for lens in self._lenses]

    def _mask(self, lens: Lens, bodies: Sequence[tuple[int, Mesh, FloatArray]]) -> Array:
        _, nearness = paint(lens.view, bodies)
        return np.asarray(cv2.dilate(lens.to_camera(nearness > 0, "label"), self._brush), dtype=bool)
