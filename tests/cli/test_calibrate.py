"""`tracker calibrate`: from a printed board to the cameras of a rig."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import tracker
from tests.calibration.test_extrinsics import GIVEN, PLACES, TRUE
from tests.helpers.boards import LENS, photo, pose_towards
from tests.helpers.command import assert_one_line_error
from tracker.calibration.calibrated import read_calibrated
from tracker.geometry.camera import Camera

BOARD = ("--squares", "5x7", "--square", "0.04", "--marker", "0.03")
NAMES = ("camera60", "camera180", "camera300")


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Ten photos for a lens, the last two of them blurred and mirrored."""
    folder, rng = tmp_path_factory.mktemp("photos"), np.random.default_rng(91)
    paths = [folder / f"{number:02}.png" for number in range(10)]
    for path in paths:
        image = photo(pose_towards(rng), rng)
        if path is paths[8]:
            image = cv2.GaussianBlur(image, (0, 0), 4)
        cv2.imwrite(str(path), image[:, ::-1] if path is paths[9] else image)
    return paths


@pytest.fixture(scope="module")
def triplets(tmp_path_factory):
    """Two places of the board before three cameras, and lenses of these."""
    root, rng = tmp_path_factory.mktemp("triplets"), np.random.default_rng(92)
    matrix, distortion = LENS.arrays
    (root / "lenses").mkdir()
    for place in range(2):
        (root / f"{place}").mkdir()
        for name, true in zip(NAMES, TRUE, strict=True):
            cv2.imwrite(str(root / f"{place}" / f"{name}.png"), photo(true @ PLACES[place], rng))
    cameras = [Camera(name, LENS.width, LENS.height, matrix, distortion, np.eye(4)) for name in NAMES]
    tracker.CameraRig(tuple(cameras)).save(root / "lenses")
    return root


def test_a_lens_is_written_with_its_deviations_and_smaller_images(photos, tmp_path, run_here):
    target = tmp_path / "camera60.yml"
    arguments = (*BOARD, "--name", "camera60", "-o", target, "--crop", "270x270+44+0", "--halve")
    result = run_here("calibrate", "intrinsics", *arguments, "--picture", tmp_path / "r.png", *photos)
    assert result.returncode == 0, result.stderr
    assert "08.png: the photo is blurred" in result.stdout
    assert "09.png: the photo is mirrored" in result.stdout
    assert "photos used      8" in result.stdout
    lens = read_calibrated(target)
    assert not lens.placed
    error = np.abs(lens.camera.matrix[(0, 1), (0, 1)] - LENS.matrix[:2])
    assert (error < 4 * lens.matrix_std[(0, 1), (0, 1)]).all()
    part = read_calibrated(tmp_path / "camera60_cropped.yml").camera
    half = read_calibrated(tmp_path / "camera60_cropped_and_downsampled.yml").camera
    assert part.matrix[0, 2] == pytest.approx(lens.camera.matrix[0, 2] - 44)
    assert half.matrix[0, 2] == pytest.approx(part.matrix[0, 2] / 2 - 0.25)
    assert (half.width, half.height) == (135, 135)
    picture = cv2.imread(str(tmp_path / "r.png"))
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def test_cameras_are_placed_and_make_a_rig(triplets, tmp_path, run_here):
    yaw = np.rad2deg(np.arctan2(GIVEN[1, 0], GIVEN[0, 0]))
    place = ("--center", *GIVEN[:2, 3], "--height", GIVEN[2, 3], "--yaw", yaw)
    arguments = (*BOARD, "--intrinsics", triplets / "lenses", *place, "-o", tmp_path / "rig")
    result = run_here(
        "calibrate", "extrinsics", *arguments, "--pictures", tmp_path, triplets / "0", triplets / "1"
    )
    assert result.returncode == 0, result.stderr
    rig = tracker.CameraRig.load(tmp_path / "rig")
    assert rig.names == NAMES
    for camera, true in zip(rig, TRUE, strict=True):
        error = np.abs(camera.camera_from_world - true)[:3, 3]
        assert (error < 4 * camera.camera_from_world_std[:3, 3]).all()
        assert error.max() < 2e-3
        assert (tmp_path / f"{camera.name}.png").is_file()


def test_a_board_is_printed(tmp_path, run_here):
    for suffix in ("pdf", "svg", "png"):
        result = run_here("calibrate", "board", *BOARD, "-o", tmp_path / f"board.{suffix}")
        assert result.returncode == 0, result.stderr
        assert "on a page of 210x297 mm" in result.stdout
        assert (tmp_path / f"board.{suffix}").stat().st_size > 5000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--squares", "5by7"], ["--squares", "5x7"]),
        (["--squares", "7x5"], ["found in none of 10 photos", "a board of 5x7 squares, expected 7x5"]),
        (["--squares", "5x5"], ["a board of 5x7 squares, expected 5x5"]),
        (["--squares", "5x9"], ["no more than 5x7 squares", "mirrored"]),
        (["--dictionary", "DICT_4X4_50"], ["in none", "no marker of DICT_4X4_50", "--squares"]),
        (["--marker", "0.05"], ["markers of 0.05", "less than"]),
        (["-o", "camera.txt"], [".txt", ".yml"]),
        (["--crop", "540"], ["--crop", "540x540+88+0"]),
        (["--crop", "300x300+0+0"], ["300x300+0+0", "360x270"]),
    ],
)
def test_a_fault_of_a_lens_is_named(arguments, words, photos, tmp_path, run_here):
    given = (*BOARD, "--name", "camera60", "-o", "camera60.yml", *arguments)
    assert_one_line_error(run_here("calibrate", "intrinsics", *given, *photos, folder=tmp_path), *words)
    assert not list(tmp_path.iterdir())


def test_too_few_photos_are_named_with_what_is_wrong_with_the_others(photos, tmp_path, run_here):
    arguments = (*BOARD, "--name", "camera60", "-o", tmp_path / "camera60.yml")
    result = run_here("calibrate", "intrinsics", *arguments, *photos[5:])
    assert_one_line_error(result, "found 3 photos", "at least 6", "08.png: the photo is blurred", "mirrored")


@pytest.mark.parametrize(
    ("folders", "words"),
    [
        (["nowhere"], ["nowhere", "no such folder"]),
        (["lenses"], ["found no photo of camera60", "camera60.png"]),
        (["one"], ["camera180, camera300", "found no photo of the board in its given place"]),
        (["two"], ["camera60.png, camera60b.png", "one photo of camera60"]),
    ],
)
def test_a_fault_of_photos_of_the_arena_is_named(folders, words, triplets, tmp_path, run_here):
    for name, files in {"one": ["camera60.png"], "two": ["camera60.png", "camera60b.png"]}.items():
        (triplets / name).mkdir(exist_ok=True)
        for file in files:
            (triplets / name / file).write_bytes((triplets / "0" / "camera60.png").read_bytes())
    arguments = (*BOARD, "--intrinsics", triplets / "lenses", "-o", tmp_path / "rig")
    result = run_here("calibrate", "extrinsics", *arguments, *(triplets / one for one in folders))
    assert_one_line_error(result, *words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["-o", "board.doc"], [".doc", ".pdf"]), (["--square", "0.4", "-o", "board.pdf"], ["at most 1200 mm"])],
)
def test_a_board_that_cannot_be_printed_is_named(arguments, words, tmp_path, run_here):
    assert_one_line_error(run_here("calibrate", "board", *BOARD, *arguments, folder=tmp_path), *words)
    assert not list(tmp_path.iterdir())
