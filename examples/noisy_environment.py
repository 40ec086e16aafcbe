"""A Gymnasium wrapper that replaces true poses with the tracker's: late, sometimes missing, with errors.

The environment steps at 50 Hz; its observation is a dictionary with the true `position` (3,) [m] and
`orientation` (4,) xyzw of the object, and optionally `visible`, the share of it that no finger hides. The
wrapper removes `visible` and adds the `confidence` of the pose (0: none yet).
"""

from collections import deque
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

import tracker

PERIOD, STEP = 0.1, 0.02  # between images, and between actions [s]


class NoisyPoses(gymnasium.ObservationWrapper):
    """Replaces the true pose with the last one that has arrived.

    Args:
        env: the environment.
        model: name or path of a noise model.
    """

    def __init__(self, env: gymnasium.Env, model: str = "platform"):
        super().__init__(env)
        self.model = tracker.noise.NoiseModel.load(model)
        assert isinstance(env.observation_space, spaces.Dict)
        own = {key: space for key, space in env.observation_space.spaces.items() if key != "visible"}
        self.observation_space = spaces.Dict(own | {"confidence": spaces.Box(0.0, 1.0, (1,))})
        self.coming: deque[tuple[float, tracker.noise.Seen]] = deque()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """A new episode: another calibration, nothing known."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.errors = self.model.start(self.np_random, 1)
        self.steps = 0
        self.coming.clear()
        self.known = {"position": np.zeros(3), "orientation": np.array([0, 0, 0, 1.0]), "confidence": [0.0]}
        return self.observation(observation), info

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """What a policy knows."""
        now = self.steps * STEP
        visible = np.reshape(observation.get("visible", 1.0), 1)
        if self.steps % round(PERIOD / STEP) == 0:
            pose = np.array([observation["position"]]), np.array([observation["orientation"]])
            self.coming.append((now, self.errors.step(*pose, visible, PERIOD)))
        self.steps += 1
        while self.coming and self.coming[0][0] + self.coming[0][1].delay[0] <= now:
            _, seen = self.coming.popleft()
            if seen.found[0]:  # else the policy keeps what it knew
                self.known = {key: getattr(seen, key)[0] for key in ("position", "orientation")}
                self.known["confidence"] = seen.confidence
        rest = {key: value for key, value in observation.items() if key != "visible"}
        return rest | {key: np.asarray(value, np.float32) for key, value in self.known.items()}


class Pushed(gymnasium.Env):
    """A cube that moves at the speed of the action, in place of your simulator."""

    observation_space = spaces.Dict(
        position=spaces.Box(-1.0, 1.0, (3,)),
        orientation=spaces.Box(-1.0, 1.0, (4,)),
        visible=spaces.Box(0.0, 1.0, (1,)),
    )
    action_space = spaces.Box(-0.1, 0.1, (2,))  # [m/s]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """At rest in the middle."""
        super().reset(seed=seed)
        self.position = np.array([0.0, 0.0, 0.0325])
        return self._seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """A control step."""
        self.position[:2] += STEP * np.asarray(action)
        return self._seen(), 0.0, False, False, {"truth": self.position.copy()}

    def _seen(self) -> dict[str, Any]:
        seen = {"position": self.position, "orientation": [0, 0, 0, 1], "visible": [0.8]}
        return {key: np.array(value, dtype=np.float32) for key, value in seen.items()}


if __name__ == "__main__":
    environment = NoisyPoses(Pushed())
    environment.reset(seed=1)
    for _ in range(50):
        observation, reward, ended, cut, info = environment.step(np.array([0.05, 0.0]))
        off = 1e3 * np.linalg.norm(observation["position"] - info["truth"])
    print(f"{off:.1f} mm from the truth, confidence {observation['confidence'][0]:.2f}")
