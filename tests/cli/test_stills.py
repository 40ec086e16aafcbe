import dataclasses
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import RIG, nudged
from tests.helpers.command import assert_one_line_error, well
from tests.helpers.dice_scenes import EDGE, painted
from tests.helpers.log_writers import CAMERAS
from tracker.calibration.rig import CameraRig
from tracker.cli.demo import DATA as DEMO
from tracker.inputs import of_cameras
from tracker.tasks import rearrange_dice

PHOTOS = DEMO / "000003"


def photos(*names):
    return [PHOTOS / f"{name}.jpg" for name in names]


def write_changed(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> list[str]:
    """Write the photos as changed images; return their names."""
    for name in CAMERAS:
        cv2.imwrite(str(folder / f"{name}.png"), change(cv2.imread(str(PHOTOS / f"{name}.jpg"))))
    return [f"{name}.png" for name in CAMERAS]


@pytest.fixture
def detect(run_here, tmp_path):
    """Answers of `tracker detect --json` on the recording that comes with the package."""

    def found(*arguments: object):
        result = run_here("detect", "--object", "cube_v2", "--json", *arguments, folder=tmp_path)
        return result, json.loads(result.stdout) if result.returncode == 0 else None

    return found


def test_detect_prints_one_json_object_for_programs_and_draws_it(detect, tmp_path):
    _, found = detect(DEMO, "--frame", 3, "--overlay", "out.png")
    assert list(found) == ["object", "status", "pose", "timing_ms"]
    assert (found["object"], found["status"]) == ("cube_v2", "found")
    assert set(found["pose"]) == {"position", "orientation", "covariance", "confidence"}
    covariance = np.array(found["pose"]["covariance"])
    assert covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert 0 < found["pose"]["confidence"] <= 1
    assert found["timing_ms"]["total"] > 0
    assert cv2.imread(str(tmp_path / "out.png")).shape[1] == 3 * 540 + 2 * 6
    first, _, third = photos(*CAMERAS)
    _, without = detect("--calibration", DEMO, first, "none", third)
    np.testing.assert_allclose(without["pose"]["position"], found["pose"]["position"], atol=2e-3)


def test_nothing_found_is_an_answer_and_no_error(detect, tmp_path, run_here):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((270, 270, 3), 90, np.uint8))
    grey = ["--calibration", DEMO, *["grey.png"] * 3]
    _, found = detect(*grey, "--overlay", "out.jpg")
    assert (found["pose"], found["status"]) == (None, "no_object_colors")
    assert (tmp_path / "out.jpg").is_file()
    asked = ("detect", "--object", "cube_v2", "--exit-code")
    shown = run_here(*asked, *grey, folder=tmp_path)
    assert "no_object_colors" in shown.stdout
    assert shown.returncode == 1
    assert run_here(*asked, DEMO).returncode == 0


@pytest.mark.parametrize(
    "given",
    [
        [DEMO, "--frame", "3"],
        ["folder.png", "--frame", "3"],
        ["--calibration", DEMO, *photos(*sorted(CAMERAS))],
        ["--calibration", DEMO, "a.jpg", "b.jpg", "c.jpg"],
        [*(f"--calibration={DEMO}/{name}.yml" for name in CAMERAS[::-1]), "c.jpg", "b.jpg", "a.jpg"],
    ],
    ids=["a folder's frame", "of an image's name", "in another order", "without names", "by calibrations"],
)
def test_pictures_are_those_of_their_cameras_however_they_are_given(given, detect, tmp_path):
    (tmp_path / "folder.png").symlink_to(DEMO)
    for name, letter in zip(CAMERAS, "abc", strict=True):
        shutil.copy(PHOTOS / f"{name}.jpg", tmp_path / f"{letter}.jpg")
    _, expected = detect("--calibration", DEMO, *photos(*CAMERAS))
    result, found = detect(*given)
    np.testing.assert_allclose(found["pose"]["position"], expected["pose"]["position"], atol=1e-3)
    assert result.stderr == ""
    assert detect(DEMO)[1]["pose"] != found["pose"]


@pytest.mark.parametrize(
    ("paths", "expected"),
    [
        (["b/camera180.png", "b/camera60.png"], ["b/camera60.png", "b/camera180.png"]),
        (["camera180/7.png", "camera60/7.png"], ["camera60/7.png", "camera180/7.png"]),
        (["camera60/a.png", "camera60/b.png"], ["camera60/a.png", "camera60/b.png"]),
        (["camera300_run/camera180.png", "camera300_run/camera60.png"], ["camera60", "camera180"]),
        (["camera60/camera180.png", "x/camera60_crop.png"], ["x/camera60_crop", "camera60/camera180"]),
        (["camera180.png", "none"], ["none", "camera180.png"]),
        (["none", "b.png"], ["none", "b.png"]),
    ],
)
def test_files_go_to_the_cameras_that_they_or_their_folders_are_named_after(paths, expected):
    found = of_cameras(paths, ("camera60", "camera180"))
    assert all(part in one for one, part in zip(found, expected, strict=True))


def test_swapped_pictures_are_reported_and_taken_as_they_are(detect, tmp_path, run_here):
    for frame in ("000000", "000001", "000002", "000003"):
        shutil.copytree(DEMO / frame, tmp_path / "log" / frame)
        for name, other in (CAMERAS[:2], CAMERAS[1::-1]):
            shutil.copy(DEMO / frame / f"{other}.jpg", tmp_path / "log" / frame / f"{name}.jpg")
    result, found = detect("--calibration", DEMO, tmp_path / "log")
    warning = "the images of camera60 and camera180 look swapped"
    assert result.stderr.splitlines() == [f"tracker: warning: {warning}"]
    assert found["pose"] is None or found["pose"]["confidence"] < 0.5
    more = ("--object", "cube_v2", "--calibration", DEMO, "--quiet", "-o", "poses.h5")
    tracked = run_here("track", "log", *more, folder=tmp_path)
    assert tracked.stderr.splitlines() == [f"tracker: warning: log: {warning}"]


def test_a_calibration_of_another_size_is_scaled_where_that_is_asked_for(detect, tmp_path):
    _, small = detect("--calibration", DEMO, *photos(*CAMERAS))
    large = write_changed(tmp_path, lambda one: cv2.resize(one, (540, 540), interpolation=cv2.INTER_CUBIC))
    given = ["--calibration", DEMO, *large]
    words = "540×540 px", "its calibration is for 270×270", "--resize-calibration"
    assert_one_line_error(detect(*given)[0], *words)
    _, large = detect("--resize-calibration", *given)
    # A principal point that is off by the quarter pixel is off by 0.4 mm.
    np.testing.assert_allclose(large["pose"]["position"], small["pose"]["position"], atol=2e-4)


def test_the_likely_cause_is_printed_and_drawn(detect, tmp_path):
    blurred = write_changed(tmp_path, lambda image: cv2.GaussianBlur(image, (0, 0), 15))
    result, found = detect("--calibration", DEMO, *blurred, "--overlay", "drawn.png")
    assert found["pose"] is None
    (line,) = result.stderr.splitlines()
    assert line.startswith("tracker: warning: camera60: blurred by ")
    result, _ = detect("--calibration", DEMO, *photos(*CAMERAS), "--overlay", "good.png")
    assert result.stderr == ""
    heights = [len(cv2.imread(str(tmp_path / name))) for name in ("drawn.png", "good.png")]
    assert heights[0] > 540 + 100
    assert heights[0] != heights[1]


def test_all_bits_of_sixteen_are_taken(detect, tmp_path):
    sixteen = write_changed(tmp_path, lambda image: image.astype(np.uint16) << 8)
    assert detect("--calibration", DEMO, *sixteen)[1]["pose"] is not None


@pytest.mark.parametrize(("bits", "remedy"), [(8, "image."), (10, "(image >> 2)."), (12, "(image >> 4).")])
def test_fewer_bits_in_sixteen_are_named_and_not_taken_for_black(bits, remedy, detect, tmp_path):
    named = write_changed(tmp_path, lambda image: image.astype(np.uint16) << (bits - 8))
    result, _ = detect("--calibration", DEMO, *named)
    assert_one_line_error(result, "16-bit values up to", f"as from a {bits}-bit camera", f": {remedy}astype")
    images = [cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED) for name in named]
    with pytest.raises(tracker.TrackerError, match=re.escape(f"expected uint8: {remedy}astype")):
        tracker.ObjectTracker("cube_v2", DEMO).detect(images)


def test_images_without_colours_are_named(detect, tmp_path):
    grey = write_changed(tmp_path, lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    result, _ = detect("--calibration", DEMO, *grey)
    assert "warning: the images have no colours: raw Bayer images must be demosaicked" in result.stderr
    black = write_changed(tmp_path, lambda image: 0 * image)
    result, _ = detect("--calibration", DEMO, *black)
    assert "no colours" not in result.stderr
    assert "is the lens covered?" in result.stderr


def test_cameras_that_contradict_each_other_get_a_warning_beside_the_pose(detect, tmp_path):
    rig = tracker.CameraRig.load(DEMO)
    nudged(rig, 0, shift=[8e-3, 0.0, 0.0]).save(tmp_path / "moved")
    result, found = detect("--calibration", tmp_path / "moved", *photos(*CAMERAS))
    assert found["pose"] is not None
    assert "tracker calibrate check" in result.stderr
    assert detect("--calibration", DEMO, *photos(*CAMERAS))[0].stderr == ""


@pytest.mark.parametrize(
    "wrong",
    [
        np.linalg.inv,
        lambda pose: pose * [[1.0, 1, 1, 1e3]],
        lambda pose: np.diag([1.0, -1, -1, 1]) @ pose,
        lambda pose: pose @ np.diag([1.0, -1, -1, 1]),
        lambda pose: pose + 0.4 * pose[:, :1] * [0.0, 0, 0, 1],
    ],
    ids=["inverse", "mm", "axes of OpenGL", "z down", "arena elsewhere, in one image"],
)
def test_cameras_that_cannot_have_the_arena_in_view_get_a_warning(wrong, detect, tmp_path):
    rig = tracker.CameraRig.load(DEMO)
    poses = [wrong(camera.camera_from_world) for camera in rig]
    for pose in poses:
        pose[3, 3] = 1.0
    cameras = [dataclasses.replace(c, camera_from_world=pose) for c, pose in zip(rig, poses, strict=True)]
    tracker.CameraRig(tuple(cameras)).save(tmp_path / "wrong")
    result, _ = detect("--calibration", tmp_path / "wrong", *photos(*CAMERAS))
    assert "the arena in few or no images" in result.stderr


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


def dice_arguments(scene: Path, *more: object, **replaced: object) -> list[object]:
    """Arguments of a good `tracker dice`, with the images of some cameras replaced."""
    images = [replaced.get(name, scene / f"{name}.png") for name in CAMERAS]
    return ["dice", "--calibration", scene, *more, *images]


@pytest.fixture
def dice(scene, run_here):
    """Answers of `tracker dice --json` on the scene."""

    def found(*more: object, **replaced: object):
        return json.loads(well(run_here(*dice_arguments(scene, "--json", *more, **replaced))).stdout)

    return found


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


def test_dice_prints_one_json_object_for_programs(scene, dice):
    found = dice("--goal", scene / "goal.json")
    assert list(found) == ["error", "error_per_camera", "reward", "dice", "assignment", "timing_ms"]
    assert list(found["error_per_camera"]) == list(CAMERAS)
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


@pytest.mark.usefixtures("truth")
def test_the_error_is_the_tasks_and_placed_dice_are_assigned_to_their_places(scene, dice, run_here):
    found, pattern = (dice("--goal", scene / f"goal.{suffix}") for suffix in ("json", "txt"))
    exact = dice("--goal", scene / "goal.json", "--exact")
    masks = [rearrange_dice.segment_dice(cv2.imread(str(scene / f"{name}.png"))) for name in CAMERAS]
    expected = rearrange_dice.error_per_camera(rearrange_dice.goal_masks(RIG, GOAL), masks)
    assert list(found["error_per_camera"].values()) == list(expected)
    assert found["error"] == sum(expected)
    assert pattern["error_per_camera"] == found["error_per_camera"]
    areas = rearrange_dice.goal_masks(RIG, GOAL, exact=True)
    assert exact["error"] == rearrange_dice.error(areas, masks) != found["error"]
    placed = [pair for pair in found["assignment"] if pair["distance"] < 1e-6]
    assert sorted(pair["goal"] for pair in placed) == list(range(MISPLACED, 25))
    text = run_here(*dice_arguments(scene, "--goal", scene / "goal.json")).stdout
    first, second, third = text.splitlines()[:3]
    assert first.startswith("error [px]")
    assert all(name in first for name in CAMERAS)
    assert f"25 found, {25 - MISPLACED} within 4 mm" in second
    assert third.startswith("time [ms]")
    header, *rows = text.split("\n\n")[1].splitlines()
    assert len(rows) == 25
    assert header.split()[-3:] == ["place", "distance", "[mm]"]


@pytest.mark.usefixtures("truth")
@pytest.mark.parametrize(("missing", "noise"), [("none", 0), ("camera180.png", 0), ("camera180.png", 11)])
def test_without_a_goal_there_is_no_error_and_a_camera_without_an_image_does_not_count(
    missing, noise, scene, tmp_path, dice, run_here
):
    goal = ("--goal", scene / "goal.json")
    if missing != "none":  # black, as in HDF5 logs, or but for the noise of a covered camera
        black = write_changed(tmp_path, lambda image: image % (noise + 1))
        missing = tmp_path / missing
        refused = run_here("dice", "--calibration", scene, *goal, *black, folder=tmp_path)
        assert_one_line_error(refused, "images: found only black ones, expected at least one")
    everything, without = dice(*goal)["error_per_camera"], dice(*goal, camera180=missing)
    assert without["error_per_camera"] == {**everything, "camera180": None}
    assert without["error"] == everything["camera60"] + everything["camera300"]
    assert "camera180 none" in run_here(*dice_arguments(scene, *goal, camera180=missing)).stdout
    found = dice()
    assert all(found[key] is None for key in ("error", "error_per_camera", "reward", "assignment"))
    assert len(found["dice"]) == 25
    text = run_here(*dice_arguments(scene)).stdout
    assert "error" not in text.splitlines()[0]
    assert "25 found" in text


@pytest.mark.usefixtures("truth")
def test_overlay_and_masks_are_written(scene, tmp_path, run_here):
    written = ("--overlay", tmp_path / "out.png", "--masks", tmp_path / "new" / "masks")
    (tmp_path / "new" / "masks").mkdir(parents=True)
    (tmp_path / "new" / "masks" / "dice_camera60.png").touch()  # replaced
    well(run_here(*dice_arguments(scene, "--goal", scene / "goal.json", *written, camera300="none")))
    assert cv2.imread(str(tmp_path / "out.png")).shape[1] == 3 * 540 + 2 * 6
    names = {path.name for path in (tmp_path / "new" / "masks").iterdir()}
    assert names == {*(f"goal_{name}.png" for name in CAMERAS), "dice_camera60.png", "dice_camera180.png"}
    goals = rearrange_dice.goal_masks(RIG, GOAL)
    for name, expected in zip(CAMERAS, goals, strict=True):
        path = tmp_path / "new" / "masks" / f"goal_{name}.png"
        np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), expected)
    assert run_here(*dice_arguments(scene, "--overlay", tmp_path / "plain.jpg")).returncode == 0
    assert (tmp_path / "plain.jpg").is_file()


@pytest.mark.parametrize("kind", ["dice", "goal"])
def test_a_mask_of_another_run_is_left_as_it_is_and_refused_if_it_would_stay(kind, scene, tmp_path, run_here):
    file = tmp_path / f"{kind}_camera300.png"
    file.write_text("years of work")
    without = {"dice": ("--goal", scene / "goal.json", "none"), "goal": (scene / "camera300.png",)}
    *more, image = without[kind]
    refused = run_here(*dice_arguments(scene, *more, "--masks", tmp_path, camera300=image))
    assert_one_line_error(refused, f"--masks {tmp_path}: found {file.name} of another run, expected none")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["years of work"]
