"""Gymnasium's interface to the simulated platform: fingers act, and the tracker sees the result.

An action moves the nine joints by up to STEP. An observation holds the joint angles, the object's corners as
the tracker finds them in rendered images, the goal's corners, and the pose's confidence (0: no pose; then the
object's corners are zeros). The reward is that of the pose found, or -1 if there is none; `info["truth"]` is
the object's true position.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.look.appearance import random_lighting, random_look
from synthetic.stills import take
from synthetic.world.fingers import REST
from synthetic.world.placement import place
from synthetic.world.platform import Platform
from tracker.tasks import move_object

PERIOD, STEP = 0.1, 0.1
"""Time between images [s], and how far a joint moves in it [rad]."""


class MoveCube(gymnasium.Env):
    """Move a cube to a place on the table, seen by three cameras.

    Args:
        goal_position: (3,) [m].
        width: of the square images [px].
    """

    def __init__(self, goal_position: tuple[float, float, float] = (0.05, 0.05, 0.0325), width: int = 180):
        model = tracker.load_object("cube_v2")
        self.goal_position = np.array(goal_position)
        self.goal = move_object.keypoints(goal_position, (0.0, 0.0, 0.0, 1.0), model.size)
        self.action_space = spaces.Box(-1.0, 1.0, (9,))
        self.observation_space = spaces.Dict(
            joints=spaces.Box(-np.pi, np.pi, (9,)),
            keypoints=spaces.Box(-1.0, 1.0, (8, 3)),  # [m]
            goal=spaces.Box(-1.0, 1.0, (8, 3)),
            confidence=spaces.Box(0.0, 1.0, (1,)),
        )
        self.platform = Platform("cube_v2")
        self.rig = tracker.CameraRig(default_cameras(width))
        self.tracker = tracker.ObjectTracker(model, self.rig)
        self.world = self.platform.new_world()
        self.time = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """A cube at rest somewhere, fingers out of the way, new light."""
        super().reset(seed=seed)
        rng = self.np_random
        self.world.close()
        self.world = self.platform.new_world()  # contacts of the last episode would change this one
        (positions, rotations), _ = place(self.platform, rng, "rest")
        self.look, self.lighting = random_look(rng, self.platform.model), random_lighting(rng)
        self.world.set_objects(self.platform.object_states(positions, rotations))
        self.world.set_joints(np.tile(REST, 3))
        self.tracker.reset()
        self.time = 0.0
        observation, _, info = self._seen()
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """A tenth of a second of physics, then an image from each camera."""
        self.world.steer(self.world.joint_angles() + STEP * np.clip(action, -1.0, 1.0))
        self.world.step(round(PERIOD / self.world.time_step))
        self.time += PERIOD
        observation, reward, info = self._seen()
        return observation, reward, False, False, info

    def close(self) -> None:
        """Free the simulation."""
        self.world.close()
        self.platform.close()

    def _seen(self) -> tuple[dict[str, Any], float, dict[str, Any]]:
        joints = self.world.joint_angles()
        position, rotation = self.world.object_pose(0)
        states = self.platform.object_states(position[None], rotation[None])
        scene = self.platform.scene(states, joints, self.look, self.lighting, {})
        still = take(scene, self.rig.cameras, Sensor.realistic(), self.np_random)
        pose = self.tracker.update(still.images, self.time).filtered_object_pose
        seen: dict[str, Any] = {"joints": joints, "keypoints": np.zeros((8, 3)), "goal": self.goal}
        seen["confidence"], reward = np.zeros(1), -1.0
        if pose is not None:
            seen |= {"keypoints": pose.keypoints, "confidence": np.array([pose.confidence])}
            reward = float(move_object.reward(1, self.goal_position, pose.position))
        observation = {key: np.asarray(value, dtype=np.float32) for key, value in seen.items()}
        return observation, reward, {"truth": position, "images": still.images}


if __name__ == "__main__":
    environment = MoveCube()
    observation, info = environment.reset(seed=1)
    for _ in range(3):
        observation, reward, _, _, info = environment.step(environment.action_space.sample())
        off = 1e3 * np.linalg.norm(observation["keypoints"].mean(axis=0) - info["truth"])
        print(f"reward {reward:.3f}, seen {off:.2f} mm from the truth")
    environment.close()
