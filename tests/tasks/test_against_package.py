"""The tasks' errors against the platform's own simulation package.

The package lives in an environment of its own, which `make package` sets up in a minute or two; these tests
are skipped where there is none.
"""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.data.package.environment import PackageError, interpreter, run
from synthetic.camera.rigs import standard_rig
from tests.helpers import ROOT
from tests.helpers.needs import lack
from tracker.calibration.rig import CameraRig
from tracker.objects.model import load_object
from tracker.tasks import move_object, rearrange_dice

SCRIPT = ROOT / "tests" / "helpers" / "package_tasks_script.py"
MODELS = {"cube": load_object("cube_v2"), "cuboid": load_object("cuboid_2x2x8_v2")}

ROUNDING = 5e-11 + 1e-15
"""By how much the package's cosine of the angle between long axes is off: it rounds it to ten digits."""

Package = Callable[..., dict[str, np.ndarray]]


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    """What the package says: a function of the script's command and further arguments."""
    try:
        python = interpreter(install=False)
    except PackageError as error:
        lack("package", f"{error}; `make package` sets it up")
    folder = tmp_path_factory.mktemp("package")

    def ask(command: str, *arguments: Path) -> dict[str, np.ndarray]:
        out = folder / f"{command}.npz"
        run([str(python), str(SCRIPT), command, str(out), *map(str, arguments)])
        with np.load(out) as data:
            return dict(data)

    return ask


def assert_same_masks(answer: dict[str, np.ndarray], files: list[Path], first: int = 0) -> None:
    """Of an answer's cameras those from `first` on are a rig's, which has these files."""
    rig = CameraRig.load(files)
    drawn = []
    for k in range(first, first + len(rig)):
        shape = tuple(answer[f"shape{k}"])
        bits = np.unpackbits(answer[f"mask{k}"], count=int(np.prod(shape)))
        drawn.append(np.where(bits.reshape(shape), np.uint8(255), np.uint8(0)))
    assert len(answer["goal"]) >= 100
    for number, goal in enumerate(answer["goal"]):
        masks = rearrange_dice.goal_masks(rig, goal)
        for camera, mask, expected in zip(rig, masks, drawn, strict=True):
            assert mask.dtype == np.uint8
            assert mask.any()
            different = np.count_nonzero(mask != expected[number])
            assert different == 0, f"goal {number}, {camera.name}: {different} pixels"


def test_goal_masks_of_the_simulated_platform_are_the_packages_to_the_pixel(package, tmp_path):
    standard_rig().save(tmp_path)
    files = [tmp_path / f"{name}.yml" for name in standard_rig().names]
    assert_same_masks(package("masks", *files), files)


ROBOTS = (1, 3, 4, 5, 6, 7, 8)


@pytest.fixture(scope="session")
def robots(package: Package, real: Path) -> tuple[list[list[Path]], dict[str, np.ndarray]]:
    """Calibrations of the robots, and what the package draws for all their cameras."""
    folder, cameras = real / "calibration" / "robots", (60, 180, 300)
    files = [[folder / f"r{robot}_camera{angle}.yml" for angle in cameras] for robot in ROBOTS]
    return files, package("masks", *itertools.chain(*files))


@pytest.mark.parametrize("robot", ROBOTS)
def test_goal_masks_of_every_robot_are_the_packages_to_the_pixel(robot, robots):
    files, answer = robots
    number = ROBOTS.index(robot)
    assert_same_masks(answer, files[number], 3 * number)


@pytest.fixture(scope="session")
def tasks(package: Package) -> dict[str, np.ndarray]:
    return package("tasks")


def test_the_error_of_dice_is_the_packages(tasks):
    for goal, dice, cost in zip(tasks["goal"], tasks["dice"], tasks["cost"], strict=True):
        assert rearrange_dice.error(goal, dice) == cost
        assert rearrange_dice.error(list(goal), list(dice)) == cost


def rewards(tasks: dict[str, np.ndarray], name: str, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Our rewards of the package's poses, and by how much they and its costs do not cancel."""
    goal, state = tasks[f"{name}{level}_goal"], tasks[f"{name}{level}_state"]
    assert len(goal) >= 1000
    ours = move_object.reward(level, goal[:, :3], state[:, :3], goal[:, 3:], state[:, 3:], model=MODELS[name])
    assert (ours[np.all(goal == state, axis=1)] == 0).sum() >= 20
    return ours, np.abs(ours + tasks[f"{name}{level}_cost"])


@pytest.mark.parametrize(("name", "level"), [*[(n, k) for n in MODELS for k in (1, 2, 3)], ("cube", 4)])
def test_rewards_are_the_packages_costs_with_the_sign_changed(name, level, tasks):
    _, difference = rewards(tasks, name, level)
    assert difference.max() < 1e-9


def test_rewards_of_the_long_axis_are_the_packages_but_for_its_rounding(tasks):
    _, difference = rewards(tasks, "cuboid", 4)
    goal, state = tasks["cuboid4_goal"], tasks["cuboid4_state"]
    angle = np.pi * move_object.long_axis_error(goal[:, 3:], state[:, 3:])
    away = np.sin(angle) > 0.01
    assert away.sum() >= 1000
    assert difference[away].max() < 1e-9
    # The arccosine changes fastest at 1, where a step of δ is an angle of √2δ.
    assert (~away).sum() >= 50
    assert difference[~away].max() < 1.001 * np.sqrt(2 * ROUNDING) / (2 * np.pi)


def test_goals_and_rewards_along_trajectories_are_the_packages(tasks):
    for starts, goals, times, states, active, cost in zip(
        *(tasks[key] for key in ("start", "goals", "time", "position", "active", "costs")), strict=True
    ):
        trajectory = list(zip(starts, goals, strict=True))
        np.testing.assert_array_equal(move_object.active_goal(trajectory, times), active)
        np.testing.assert_allclose(
            move_object.trajectory_reward(trajectory, times, states), -cost, rtol=0, atol=1e-9
        )
