import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.helpers.command import assert_one_line_error, run, well
from tests.helpers.dice_scenes import EDGE, RIG, painted
from tracker.calibration.rig import CameraRig
from tracker.tasks import rearrange_dice

NAMES = ("camera60", "camera180", "camera300")
GOAL = rearrange_dice.sample_goal(0)
MISPLACED = 3
"""So many dice of the scene are not where the goal wants them."""


def dice_poses() -> list[tuple[np.ndarray, float]]:
    """Position [m] and yaw [rad] of the scene's dice."""
    free = [cell for cell in rearrange_dice.cells() if np.linalg.norm(GOAL - cell, axis=1).min() > 0.03]
    elsewhere = [free[0], free[len(free) // 2], free[-1]]
    return [*((place, 0.0) for place in GOAL[MISPLACED:]), *((place, 0.5) for place in elsewhere)]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an image and a calibration of each camera, goal.json and goal.txt."""
    folder = tmp_path_factory.mktemp("dice")
    RIG.save(folder)
    rng = np.random.default_rng(5)
    dice = np.array([[*place[:2], place[2] - EDGE / 2, yaw] for place, yaw in dice_poses()])
    for camera in RIG:
        cv2.imwrite(str(folder / f"{camera.name}.png"), painted(camera, dice, rng)[0])
    rearrange_dice.write_goal(folder / "goal.json", GOAL)
    rearrange_dice.write_goal(folder / "goal.txt", GOAL)
    return folder


def arguments(scene: Path, *more: object, **replaced: object) -> list[object]:
    """Arguments of a good `tracker dice`, with the images of some cameras replaced."""
    images = [replaced.get(name, scene / f"{name}.png") for name in NAMES]
    return ["dice", "--calibration", scene, *more, *images]


@pytest.fixture
def truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command gets the scene's own dice, and as their masks what is blue."""

    def segment_dice(image: np.ndarray) -> np.ndarray:
        return np.where(image[:, :, 0].astype(int) - image[:, :, 2] > 25, 255, 0).astype(np.uint8)

    def locate(rig: CameraRig, masks, images=None) -> tuple[SimpleNamespace, ...]:
        assert len(rig) == len(masks) == len(images)
        return tuple(SimpleNamespace(position=p, yaw=yaw, probability=0.9) for p, yaw in dice_poses())

    monkeypatch.setattr(rearrange_dice, "segment_dice", segment_dice)
    monkeypatch.setattr(rearrange_dice, "locate", locate)


def test_dice_prints_one_json_object_for_programs(scene, run_here):
    result = well(run_here(*arguments(scene, "--goal", scene / "goal.json", "--json")))
    found = json.loads(result.stdout)
    assert list(found) == ["error", "error_per_camera", "reward", "dice", "assignment", "timing_ms"]
    assert list(found["error_per_camera"]) == list(NAMES)
    assert found["error"] == sum(found["error_per_camera"].values()) == -found["reward"]
    # A die has 150 to 350 pixels; those that are not in their places are seen outside the goal.
    assert 3 * 100 * MISPLACED < found["error"] < 3 * 500 * MISPLACED
    for die in found["dice"]:
        assert set(die) == {"position", "yaw", "probability"}
        assert len(die["position"]) == 3
        assert 0 <= die["probability"] <= 1
    assert len(found["assignment"]) == min(25, len(found["dice"]))
    for pair in found["assignment"]:
        place, die = GOAL[pair["goal"]], found["dice"][pair["die"]]["position"]
        assert pair["distance"] == pytest.approx(np.linalg.norm(place - die))
    assert found["timing_ms"]["total"] > 0


def test_an_error_of_the_process_is_one_line_too(scene):
    assert_one_line_error(run(*arguments(scene, "--goal", scene / "camera60.yml")), "camera60.yml", "row 1")


@pytest.mark.usefixtures("truth")
def test_the_error_is_the_tasks_and_placed_dice_are_assigned_to_their_places(scene, run_here):
    found, pattern, exact = (
        json.loads(run_here(*arguments(scene, "--goal", scene / goal, "--json", *more)).stdout)
        for goal, more in (("goal.json", ()), ("goal.txt", ()), ("goal.json", ("--exact",)))
    )
    masks = [rearrange_dice.segment_dice(cv2.imread(str(scene / f"{name}.png"))) for name in NAMES]
    expected = rearrange_dice.error_per_camera(rearrange_dice.goal_masks(RIG, GOAL), masks)
    assert list(found["error_per_camera"].values()) == list(expected)
    assert found["error"] == sum(expected)
    assert pattern["error_per_camera"] == found["error_per_camera"]
    areas = rearrange_dice.goal_masks(RIG, GOAL, exact=True)
    assert exact["error"] == rearrange_dice.error(areas, masks) != found["error"]
    placed = [pair for pair in found["assignment"] if pair["distance"] < 1e-6]
    assert sorted(pair["goal"] for pair in placed) == list(range(MISPLACED, 25))
    text = run_here(*arguments(scene, "--goal", scene / "goal.json")).stdout
    first, second, third = text.splitlines()[:3]
    assert first.startswith("error [px]")
    assert all(name in first for name in NAMES)
    assert f"25 found, {25 - MISPLACED} within 4 mm" in second
    assert third.startswith("time [ms]")
    header, *rows = text.split("\n\n")[1].splitlines()
    assert len(rows) == 25
    assert header.split()[-3:] == ["place", "distance", "[mm]"]


@pytest.mark.usefixtures("truth")
def test_without_a_goal_there_is_no_error_and_a_camera_without_an_image_does_not_count(scene, run_here):
    goal = ("--goal", scene / "goal.json")
    everything = json.loads(run_here(*arguments(scene, *goal, "--json")).stdout)["error_per_camera"]
    without = json.loads(run_here(*arguments(scene, *goal, "--json", camera180="none")).stdout)
    assert without["error_per_camera"] == {**everything, "camera180": None}
    assert without["error"] == everything["camera60"] + everything["camera300"]
    assert "camera180 none" in run_here(*arguments(scene, *goal, camera180="none")).stdout
    found = json.loads(run_here(*arguments(scene, "--json")).stdout)
    for key in ("error", "error_per_camera", "reward", "assignment"):
        assert found[key] is None
    assert len(found["dice"]) == 25
    text = run_here(*arguments(scene)).stdout
    assert "error" not in text.splitlines()[0]
    assert "25 found" in text


@pytest.mark.usefixtures("truth")
def test_overlay_and_masks_are_written(scene, tmp_path, run_here):
    written = ("--overlay", tmp_path / "out.png", "--masks", tmp_path / "new" / "masks")
    well(run_here(*arguments(scene, "--goal", scene / "goal.json", *written, camera300="none")))
    assert cv2.imread(str(tmp_path / "out.png")).shape[1] == 3 * 540 + 2 * 6
    names = {path.name for path in (tmp_path / "new" / "masks").iterdir()}
    assert names == {*(f"goal_{name}.png" for name in NAMES), "dice_camera60.png", "dice_camera180.png"}
    goals = rearrange_dice.goal_masks(RIG, GOAL)
    for name, expected in zip(NAMES, goals, strict=True):
        path = tmp_path / "new" / "masks" / f"goal_{name}.png"
        np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), expected)
    assert run_here(*arguments(scene, "--overlay", tmp_path / "plain.jpg")).returncode == 0
    assert (tmp_path / "plain.jpg").is_file()
