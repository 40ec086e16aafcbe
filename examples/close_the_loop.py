"""Push a cube along the goals of a trajectory by simulated fingers that know of it from late images only.

    python examples/close_the_loop.py [--seed S] [--seconds T] [--knowing NAME …] [--output FOLDER]

Three cameras take pictures at 10 Hz, which arrive 90 ms later. The fingers follow, in turn, poses predicted
from them to the moment at which they act (`Live.at`), the newest poses as they come, the true poses, and the
true ones late and with the errors of the platform's present tracker. Writes a plot of all, and a film of what
the cameras saw where poses were predicted, to the folder; prints the rewards.
"""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from cube_pusher import STEP, Pushing

import tracker
from synthetic.camera.rigs import sized, standard_rig
from synthetic.camera.sensor import Sensor
from synthetic.look.appearance import random_look
from synthetic.look.lighting import random_lighting
from synthetic.stills import take
from synthetic.world.platform import Platform
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.live import Live, Moment, Pushed
from tracker.tasks.move_object import active_goal, trajectory_reward
from tracker.viz import overlay, write_film

PERIOD, DELAY = 0.1, 0.09
"""Between sets of pictures, and from the exposure to their arrival [s], as on the platform."""

GOAL_SECONDS, FARTHEST, HEIGHT = 10.0, 0.09, 0.0325
"""How long each goal holds [s], and where goals are: on the table, this near to the arena's axis [m]."""

FILMED = 2
"""Every so many sets are in the film."""

ERROR_MM, ERROR_DEGREES, REPEATED = 1.4, 2.0, 0.1
"""Median errors of the platform's present tracker, and the share of its poses that repeat the one before."""

_SIGMA = 1.538  # median length of a vector of three normal numbers, in their standard deviation

Pose = tuple[FloatArray, FloatArray]
"""Position (3,) [m] and rotation (3, 3)."""


class Truth:
    """Knows where the cube is."""

    def __init__(self, *_: object) -> None: ...

    def __enter__(self) -> Truth:
        return self

    def __exit__(self, *_: object) -> None: ...

    def pose(self, time: float, pushing: Pushing) -> Pose | None:
        """The cube's pose as far as known at a time [s]."""
        return pushing.truth


class Predecessor(Truth):
    """Knows the true poses late, with the errors of the platform's present tracker."""

    def __init__(self, platform: Platform, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 2])
        self._coming: deque[tuple[float, Pose]] = deque()
        self._newest: Pose | None = None
        self._due = 0.0

    def pose(self, time: float, pushing: Pushing) -> Pose | None:
        """See `Truth`."""
        if time >= self._due - 1e-9:
            position, rotation = pushing.truth
            off = self._rng.normal(0.0, 1e-3 * ERROR_MM / _SIGMA, 3)
            turn = self._rng.normal(0.0, np.radians(ERROR_DEGREES) / _SIGMA, 3)
            if self._rng.random() >= REPEATED:
                self._coming.append((time + DELAY, (position + off, so3.exp(turn) @ rotation)))
            self._due += PERIOD
        while self._coming and self._coming[0][0] <= time:
            self._newest = self._coming.popleft()[1]
        return self._newest


class Newest(Truth):
    """Knows what the tracker found in the newest pictures that have arrived."""

    def __init__(self, platform: Platform, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 1])
        self._platform, self._rig = platform, sized(standard_rig(), 270)
        assert platform.model is not None
        self._model = platform.model
        self._look, self._light = random_look(self._rng, self._model), random_lighting(self._rng)
        self._coming: deque[tuple[float, list[Image]]] = deque()
        self._taken, self._moment, self._source = 0, -1, Pushed()
        self.film: list[Image] = []
        follower = tracker.ObjectTracker(self._model, self._rig)
        self._live = Live(self._source, follower, listeners=[self._hear])

    def __exit__(self, *_: object) -> None:
        self._live.close()

    def pose(self, time: float, pushing: Pushing) -> Pose | None:
        """See `Truth`."""
        if time >= self._taken * PERIOD - 1e-9:
            self._coming.append((self._taken * PERIOD, self._pictures(pushing)))
            self._taken += 1
        while self._coming and self._coming[0][0] + DELAY <= time + 1e-9:
            stamp, images = self._coming.popleft()
            self._source.push(images, stamp)
            # The simulation stands still meanwhile: the 90 ms contain the tracker's time.
            moment = self._live.wait(after=self._moment)
            assert moment is not None
            self._moment = moment.sequence
        return self._known(time)

    def _hear(self, moment: Moment) -> None: ...

    def _known(self, time: float) -> Pose | None:
        moment = self._live.latest()
        pose = None if moment is None else moment.filtered_object_pose
        return None if pose is None else (pose.position, pose.rotation)

    def _pictures(self, pushing: Pushing) -> list[Image]:
        position, rotation = pushing.truth
        states = self._platform.object_states(position[None], rotation[None])
        joints = pushing.world.joint_angles()
        scene = self._platform.scene(states, joints, self._look, self._light, {})
        return take(scene, self._rig.cameras, Sensor.realistic(), self._rng, points=1).images


class Predicted(Newest):
    """Knows what the tracker predicts, from the pictures that have arrived, for the moment of acting."""

    def _hear(self, moment: Moment) -> None:
        if moment.sequence % FILMED == 0:
            title = f"{moment.timestamp:.1f} s"
            picture = overlay(moment.shot.images, self._rig, self._model, moment.observation, title=title)
            self.film.append(picture[::2, ::2].copy())

    def _known(self, time: float) -> Pose | None:
        pose = self._live.at(time)
        return None if pose is None else (pose.position, pose.rotation)


KNOWING: dict[str, Callable[[Platform, int], Truth]] = {
    "truth": Truth,
    "predicted": Predicted,
    "newest": Newest,
    "predecessor": Predecessor,
}

parser = argparse.ArgumentParser(description="Push a cube from late images.")
parser.add_argument("--seed", type=int, default=21, help="of goals, colours, light and noise (default: 21)")
parser.add_argument("--seconds", type=float, default=50.0, help="length of the episode (default: 50)")
parser.add_argument(
    "--knowing", nargs="+", choices=KNOWING, default=list(KNOWING), help="whose poses (default: all)"
)
parser.add_argument("--output", type=Path, default=Path("demo"), help="folder to write to (default: demo)")


def main(seed: int, seconds: float, names: list[str], folder: Path) -> None:
    """Push, print, plot and film."""
    trajectory = goals(np.random.default_rng([seed, 0]), seconds)
    paths: dict[str, FloatArray] = {}
    for name in names:
        paths[name], film = episode(KNOWING[name], seed, seconds, trajectory)
        time = STEP * np.arange(len(paths[name]))
        reward = float(trajectory_reward(trajectory, time, paths[name]).mean())
        print(f"{name:12s} reward {reward:.4f} a step", flush=True)
        if name == "predicted":
            write_film(folder / "close_the_loop.mp4", iter(film), 1 / PERIOD / FILMED)
    plot(paths, trajectory, folder / "close_the_loop.png")
    print(f"pictures: {folder / 'close_the_loop.png'}, {folder / 'close_the_loop.mp4'}")


def goals(rng: np.random.Generator, seconds: float) -> list[tuple[float, FloatArray]]:
    """The times from which goals hold, and their places, spread evenly over a disc."""
    count = max(1, int(np.ceil(seconds / GOAL_SECONDS)))
    radius, angle = FARTHEST * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    places = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, HEIGHT)], axis=1)
    return list(zip(GOAL_SECONDS * np.arange(count), places, strict=True))


def episode(
    knowing: Callable[[Platform, int], Truth],
    seed: int,
    seconds: float,
    trajectory: list[tuple[float, FloatArray]],
) -> tuple[FloatArray, list[Image]]:
    """Where the cube was at each step (N, 3) [m], and the film where there is one."""
    rng = np.random.default_rng([seed, 3])
    path = []
    with ExitStack() as stack:
        platform = stack.enter_context(Platform("cube_v2"))
        start = rng.uniform(-0.06, 0.06, 2)
        pushing = stack.enter_context(Pushing(platform, start, float(rng.uniform(0, 2 * np.pi))))
        known = stack.enter_context(knowing(platform, seed))
        for number in range(round(seconds / STEP)):
            time = number * STEP
            path.append(pushing.truth[0])
            pushing.step(known.pose(time, pushing), active_goal(trajectory, time)[:2])
    return np.array(path), getattr(known, "film", [])


def plot(paths: dict[str, FloatArray], trajectory: list[tuple[float, FloatArray]], target: Path) -> None:
    """Distance from the goal over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(9, 3.5), layout="constrained")
    for (name, path), color in zip(paths.items(), ("#222222", "#3366aa", "#cc8833", "#cc3355"), strict=False):
        time = STEP * np.arange(len(path))
        distance = np.linalg.norm(path - active_goal(trajectory, time), axis=1)
        axis.plot(time, 1e3 * distance, color=color, linewidth=1.2, label=name)
    axis.set(xlabel="time [s]", ylabel="distance from the goal [mm]", ylim=(0, None))
    axis.legend(frameon=False, ncols=4)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(target, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    main(arguments.seed, arguments.seconds, arguments.knowing, arguments.output)
