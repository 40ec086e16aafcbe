"""Push a cube to a sequence of goals with simulated fingers that know its pose from late images only.

    python examples/close_the_loop.py [--seed S] [--seconds T] [--episodes N] [--knowing NAME …]

Three cameras take images at 10 Hz, which arrive 90 ms later. The fingers use, in turn, true poses, poses
predicted from the images for the moment at which the fingers act (`Live.at`), the newest poses received, and
true poses with the delay and errors of the platform's own tracker. Of the first episode, writes a plot of all
four and a film of what the cameras saw with predicted poses; prints the rewards and, for several episodes,
what each costs relative to true poses.
"""

import argparse
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
from cube_pusher import STEP, Pushing
from late_poses import FILMED, PERIOD, Newest, Predecessor, Predicted, Truth

from synthetic.world.platform import Platform
from tracker.conventions import FloatArray, Image
from tracker.tasks.move_object import active_goal, trajectory_reward
from tracker.viz import write_film

BEFORE = 0.3
"""How long the cameras run before the episode begins and the fingers may move [s]."""

GOAL_SECONDS, FARTHEST, HEIGHT = 10.0, 0.09, 0.0325
"""How long each goal holds [s]; the goals' greatest distance from the arena's axis, and their height [m]."""

KNOWING: dict[str, Callable[[Platform, int], Truth]] = {
    "truth": Truth,
    "predicted": Predicted,
    "newest": Newest,
    "predecessor": Predecessor,
}

parser = argparse.ArgumentParser(description="Push a cube from late images.")
parser.add_argument("--seed", type=int, default=21, help="of goals, colours, light and noise (default: 21)")
parser.add_argument("--seconds", type=float, default=50.0, help="length of an episode (default: 50)")
parser.add_argument("--episodes", type=int, default=1, help="how many, of seeds that follow (default: 1)")
parser.add_argument(
    "--knowing", nargs="+", choices=KNOWING, default=list(KNOWING), help="whose poses (default: all)"
)
parser.add_argument("--output", type=Path, default=Path("demo"), help="folder to write to (default: demo)")


def main(seeds: range, seconds: float, names: list[str], folder: Path) -> None:
    """Push and print; plot and film the first episode."""
    rewards = np.zeros((len(seeds), len(names)))
    for row, seed in zip(rewards, seeds, strict=True):
        trajectory = goals(np.random.default_rng([seed, 0]), seconds)
        paths: dict[str, FloatArray] = {}
        for k, name in enumerate(names):
            paths[name], film = episode(KNOWING[name], seed, seconds, trajectory)
            row[k] = trajectory_reward(trajectory, STEP * np.arange(len(paths[name])), paths[name]).mean()
            print(f"seed {seed}: {name:12s} reward {row[k]:.5f} a step", flush=True)
            if film and seed == seeds[0] and name == "predicted":
                write_film(folder / "close_the_loop.mp4", iter(film), 1 / PERIOD / FILMED)
                print(f"film: {folder / 'close_the_loop.mp4'}")
        if seed == seeds[0]:
            plot(paths, trajectory, folder / "close_the_loop.png")
            print(f"plot: {folder / 'close_the_loop.png'}")
    if len(seeds) > 1 and "truth" in names:
        print(table(rewards, names))


def table(rewards: FloatArray, names: list[str]) -> str:
    """Mean rewards of the episodes, from rewards (N, K), and each kind of pose's cost relative to the truth.

    The cost in an episode is reward / reward with the truth - 1: rewards are negative, and both have the
    same start and goals.
    """
    costs = 100 * (rewards / rewards[:, [names.index("truth")]] - 1)
    lines = [f"{'':12s}   reward  cost [%]: mean ± standard error, least, greatest of an episode"]
    for name, reward, cost in zip(names, rewards.mean(axis=0), costs.T, strict=True):
        error = cost.std(ddof=1) / np.sqrt(len(cost))
        spread = f"{cost.mean():6.1f} ± {error:.1f} {cost.min():6.1f} {cost.max():6.1f}"
        lines.append(f"{name:12s} {reward:8.5f} {spread}")
    return "\n".join(lines)


def goals(rng: np.random.Generator, seconds: float) -> list[tuple[float, FloatArray]]:
    """The goals' start times, and their places, spread evenly over a disc."""
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
    """The cube's position at each step (N, 3) [m], and the film, if any."""
    rng = np.random.default_rng([seed, 3])
    path = []
    with ExitStack() as stack:
        platform = stack.enter_context(Platform("cube_v2"))
        start = rng.uniform(-0.06, 0.06, 2)
        pushing = stack.enter_context(Pushing(platform, start, float(rng.uniform(0, 2 * np.pi))))
        known = stack.enter_context(closing(knowing(platform, seed)))
        for number in range(-round(BEFORE / STEP), round(seconds / STEP)):
            time = number * STEP
            pose = known.pose(time, pushing)
            if number >= 0:
                path.append(pushing.truth[0])
                pushing.step(pose, active_goal(trajectory, time)[:2])
    return np.array(path), getattr(known, "film", [])


def plot(paths: dict[str, FloatArray], trajectory: list[tuple[float, FloatArray]], target: Path) -> None:
    """Distance from the goal over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(9, 3.5), layout="constrained")
    colors = {"truth": "#222222", "predicted": "#3366aa", "newest": "#cc8833", "predecessor": "#cc3355"}
    for name, path in paths.items():
        time = STEP * np.arange(len(path))
        distance = np.linalg.norm(path - active_goal(trajectory, time), axis=1)
        axis.semilogy(time, 1e3 * distance, color=colors[name], linewidth=1.2, label=name)
    axis.set(xlabel="time [s]", ylabel="distance from the goal [mm]", ylim=(0.03, 200))
    axis.yaxis.set_major_formatter("{x:g}")
    axis.legend(frameon=False, ncols=len(paths), loc="lower right", bbox_to_anchor=(1.0, 1.0))
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(target, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    arguments = parser.parse_args()
    for name, least in (("seed", 0), ("seconds", 1), ("episodes", 1)):
        if not least <= getattr(arguments, name) < np.inf:
            parser.error(f"--{name}: found {getattr(arguments, name)}, expected at least {least}")
    arguments.output.mkdir(parents=True, exist_ok=True)
    seeds = range(arguments.seed, arguments.seed + arguments.episodes)
    main(seeds, arguments.seconds, arguments.knowing, arguments.output)
