"""Renders scenes with the platform's own simulation package, in an environment that has it.

    python script.py cube|cuboid SEED SCALE MARGIN OUT.npz NUMBER…

SCALE 1 samples each pixel with one ray, as the package does; SCALE 4 takes the mean of 4×4. Images extend by
MARGIN pixels on each side. They are rendered without distortion: the package distorts finished images by
whole pixels.
"""

# The package and its own dependencies are not dependencies of this project.
from __future__ import annotations

import sys

import numpy as np
import pybullet
import trifinger_simulation
from scipy.spatial.transform import Rotation
from trifinger_simulation import camera, trifingerpro_limits

SIZE = 270
HALF = {"cube": np.full(3, 0.0325), "cuboid": np.array([0.01, 0.04, 0.01])}
TURNS = (
    Rotation.identity(),
    *(Rotation.from_euler("x", angle, degrees=True) for angle in (90, -90, 180)),
    *(Rotation.from_euler("y", angle, degrees=True) for angle in (90, -90)),
)
"""Rotations that turn each face down."""

FINGERS = np.array([0.0, 0.9, -1.7] * 3)
"""Mean of the fingers' drawn joint angles [rad]."""

CLEARANCE = 0.012
"""Smallest distance of a joint from the object [m]."""


class Studio:
    """The simulated platform with one object, and its cameras."""

    def __init__(self, kind: str, scale: int, margin: int) -> None:
        self.half, self.scale, self.size = HALF[kind], scale, SIZE + 2 * margin
        self.robot = trifinger_simulation.SimFinger("trifingerpro", enable_visualization=False)
        self.client = {"physicsClientId": self.robot._pybullet_client_id}
        data = trifinger_simulation.get_data_dir()
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            fileName=str(data / "cube_v2/cube_v2.obj"),
            meshScale=list(self.half / HALF["cube"]),
            **self.client,
        )
        self.body = pybullet.createMultiBody(baseVisualShapeIndex=shape, **self.client)
        texture = pybullet.loadTexture(str(data / "cube_v2/cube_v2_texture.png"), **self.client)
        pybullet.changeVisualShape(
            self.body, -1, textureUniqueId=texture, rgbaColor=[1, 1, 1, 1], **self.client
        )
        stated = camera.load_camera_parameters(
            data / "camera_params", "camera{id}_cropped_and_downsampled.yml"
        )
        self.cameras = [self._camera(parameters, scale, margin) for parameters in stated]

    def _camera(
        self, parameters: camera.CameraParameters, scale: int, margin: int
    ) -> camera.CalibratedCamera:
        matrix = parameters.camera_matrix.copy()
        matrix[:2, 2] += margin
        matrix[:2] *= scale
        matrix[:2, 2] += (scale - 1) / 2
        result = camera.CalibratedCamera(
            matrix,
            np.zeros(5),
            parameters.tf_world_to_camera,
            (scale * self.size, scale * self.size),
            0.02,
            2.0,
            self.robot._pybullet_client_id,
        )
        result.distort_image = lambda image: image
        return result

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, Rotation]:
        """Place object and fingers at random; return the object's position [m] and rotation."""
        while True:
            position, rotation = self._pose(rng)
            joints = np.clip(
                FINGERS + rng.normal(0, 0.35, 9),
                trifingerpro_limits.robot_position.low,
                trifingerpro_limits.robot_position.high,
            )
            self.robot.reset_finger_positions_and_velocities(joints)
            pybullet.resetBasePositionAndOrientation(self.body, position, rotation.as_quat(), **self.client)
            if self._clearance(position, rotation) >= CLEARANCE:
                return position, rotation

    def _pose(self, rng: np.random.Generator) -> tuple[np.ndarray, Rotation]:
        angle, radius = rng.uniform(0, 2 * np.pi), 0.15 * np.sqrt(rng.random())
        rests = rng.random() < 0.5
        if rests:
            turn = Rotation.from_rotvec([0, 0, rng.uniform(0, 2 * np.pi)])
            rotation = turn * TURNS[int(rng.integers(len(TURNS)))]
        else:
            rotation = Rotation.from_quat(rng.normal(size=4))
        height = np.abs(rotation.as_matrix()[2]) @ self.half + (0.0 if rests else rng.uniform(0, 0.08))
        return np.array([radius * np.cos(angle), radius * np.sin(angle), height]), rotation

    def _clearance(self, position: np.ndarray, rotation: Rotation) -> float:
        finger = self.robot.finger_id
        links = range(pybullet.getNumJoints(finger, **self.client))
        places = np.array(
            [
                pybullet.getLinkState(finger, link, computeForwardKinematics=1, **self.client)[0]
                for link in links
            ]
        )
        return float((np.abs(rotation.inv().apply(places - position)) - self.half).max(axis=1).min())

    def images(self) -> np.ndarray:
        """Return images (3, H, W, 3) uint8 BGR."""
        pictures = [one.get_image(renderer=pybullet.ER_TINY_RENDERER)[:, :, 2::-1] for one in self.cameras]
        return np.stack([np.rint(self._shrunk(picture)) for picture in pictures]).astype(np.uint8)

    def _shrunk(self, picture: np.ndarray) -> np.ndarray:
        size, scale = self.size, self.scale
        result: np.ndarray = picture.reshape(size, scale, size, scale, -1).mean(axis=(1, 3))
        return result

    def masks(self) -> np.ndarray:
        """Return masks (3, H, W) bool: pixels of which the object covers more than half."""
        return np.stack([self._mask(one) for one in self.cameras])

    def _mask(self, one: camera.CalibratedCamera) -> np.ndarray:
        width, height, _, _, bodies = pybullet.getCameraImage(
            one._render_width,
            one._render_height,
            one._view_matrix,
            one._proj_matrix,
            renderer=pybullet.ER_TINY_RENDERER,
            **self.client,
        )
        edge = one._padding
        shown = np.asarray(bodies).reshape(height, width)[edge[1] : -edge[1], edge[0] : -edge[0]]
        return self._shrunk((shown & 0xFFFFFF) == self.body)[:, :, 0] > 0.5


def main(kind: str, seed: int, scale: int, margin: int, out: str, numbers: list[int]) -> None:
    """Write the scenes of these numbers; scene k depends on seed and k alone."""
    studio = Studio(kind, scale, margin)
    scenes = []
    for k in numbers:
        position, rotation = studio.draw(np.random.default_rng([seed, k]))
        scenes.append((studio.images(), studio.masks(), position, rotation.as_matrix()))
    images, masks, positions, rotations = map(np.array, zip(*scenes, strict=True))
    np.savez_compressed(out, images=images, masks=masks, position=positions, rotation=rotations)


if __name__ == "__main__":
    kind, seed, scale, margin, out, *numbers = sys.argv[1:]
    main(kind, int(seed), int(scale), int(margin), out, [int(number) for number in numbers])
