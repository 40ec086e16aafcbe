import dataclasses
import functools
import json
import re
import shutil

import cv2
import numpy as np
import pytest

import tracker
from tests.calibration.board.test_extrinsics import GIVEN, PLACES, TRUE
from tests.helpers import RIG, nudged
from tests.helpers.boards import LENS, photo, pose_towards, write_photos
from tests.helpers.command import assert_refused, well
from tests.helpers.filmed import write_recording
from tests.helpers.kept_stills import bare
from tests.helpers.moving_cube import carried, knocked, relative_errors, rests
from tracker.calibration.by_object.table import TablePlane, moved
from tracker.calibration.files import Calibrated, calibration_text, file_name, read_calibrated
from tracker.calibration.rig import save_rig
from tracker.cli.board import Smaller
from tracker.cli.calibrate import object_text
from tracker.errors import CalibrationError

CUBE = ("--object", "cube_v2")
BOARD = ("--squares", "5x7", "--square", "0.04", "--marker", "0.03")
NAMES = ("camera60", "camera180", "top")


@pytest.fixture
def run_here(run_here):
    return functools.partial(run_here, "calibrate")


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
    root, places = tmp_path_factory.mktemp("triplets"), {"0": PLACES[0], "1": PLACES[1]}
    write_photos(root, dict(zip(NAMES, TRUE, strict=True)), places, np.random.default_rng(92))
    return root


def test_a_lens_is_written_with_its_deviations_and_smaller_images(photos, tmp_path, run_here):
    target = tmp_path / "lenses" / "camera60.yml"
    arguments = (*BOARD, "--name", "camera60", "-o", target, "--crop", "270x270+44+0", "--halve")
    result = well(run_here("intrinsics", *arguments, "--plot", tmp_path / "r.png", *photos))
    assert "08.png: the photo is blurred" in result.stdout
    assert "09.png: the photo is mirrored" in result.stdout
    assert "photos used      8" in result.stdout
    lens = read_calibrated(target)
    assert not lens.placed
    error = np.abs(lens.camera.matrix[(0, 1), (0, 1)] - LENS.matrix[(0, 1), (0, 1)])
    assert (error < 4 * lens.matrix_std[(0, 1), (0, 1)]).all()
    part = read_calibrated(target.parent / "camera60_cropped.yml").camera
    half = read_calibrated(target.parent / "camera60_cropped_and_downsampled.yml").camera
    assert part.matrix[0, 2] == pytest.approx(lens.camera.matrix[0, 2] - 44)
    assert half.matrix[0, 2] == pytest.approx(part.matrix[0, 2] / 2 - 0.25)
    assert (half.width, half.height) == (135, 135)
    picture = cv2.imread(str(tmp_path / "r.png"))
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def test_cameras_are_placed_and_make_a_rig(triplets, tmp_path, run_here):
    (triplets / "0" / "._camera60.png").touch()  # of a file system for Macs
    yaw = np.rad2deg(np.arctan2(GIVEN[1, 0], GIVEN[0, 0]))
    place = ("--center", ",".join(map(str, GIVEN[:2, 3])), "--height", GIVEN[2, 3], "--yaw", yaw)
    arguments = (*BOARD, "--intrinsics", triplets / "lenses", *place, "-o", tmp_path / "rig")
    well(run_here("extrinsics", *arguments, "--plot", tmp_path / "plots", triplets / "0", triplets / "1"))
    rig = tracker.CameraRig.load(tmp_path / "rig")
    assert rig.names == NAMES
    for camera, true in zip(rig, TRUE, strict=True):
        error = np.abs(camera.camera_from_world - true)[:3, 3]
        assert (error < 4 * camera.camera_from_world_std[:3, 3]).all()
        assert error.max() < 2e-3
        assert (tmp_path / "plots" / f"{camera.name}.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "first", "words"),
    [
        ("--squares 7x5", 0, ["found in none of 10 photos", "do not lie as on a board of 7x5 squares"]),
        ("--crop 300x300+0+0", 0, ["300x300+0+0", "360x270"]),
        ("", 5, ["found 3 usable photos", "at least 6", "08.png: the photo is blurred", "mirrored"]),
    ],
)
def test_a_fault_of_a_lens_and_of_photos_is_named(arguments, first, words, photos, tmp_path, run_here):
    given = (*BOARD, "--name", "camera60", "-o", "camera60.yml", *arguments.split(), *photos[first:])
    assert_refused(run_here, tmp_path, ["intrinsics", *given], *words)


def test_cameras_whose_files_would_have_one_name_are_refused(tmp_path):
    cameras = [Calibrated(dataclasses.replace(RIG[0], name=name)) for name in ("left", "camera_left")]
    with pytest.raises(CalibrationError, match=r"camera_left\.yml: found two cameras for it"):
        Smaller(None, False).write((one, tmp_path / file_name(one.camera.name)) for one in cameras)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("files", "folder", "words"),
    [
        ([], "nowhere", ["nowhere", "no such folder"]),
        ([], "lenses", ["found no photo of camera60", "camera60.png"]),
        (["camera60"], "one", ["camera180, top", "found no photo of the board in its given place"]),
        (["camera60", "camera60b"], "two", ["camera60.tif, camera60b.tif", "one photo of camera60"]),
        (["camera60", "camera90"], "other", ["camera90.tif: named after camera90", ", ".join(NAMES)]),
        (["camera60", "cam180"], "stray", ["cam180.tif: named after no camera", ", ".join(NAMES)]),
        ([], "0 -o lenses", ["lenses: in use, expected a new or an empty folder"]),
        ([], "0 --plot lenses", ["lenses: in use, expected a new or an empty folder"]),
    ],
)
def test_a_fault_of_photos_of_the_arena_is_named(files, folder, words, triplets, run_here):
    for file in files:
        (triplets / folder).mkdir(exist_ok=True)
        shutil.copy(triplets / "0" / "camera60.png", triplets / folder / f"{file}.tif")
    given = (*BOARD, "--intrinsics", "lenses", "-o", "rig", *folder.split())
    assert_refused(run_here, triplets, ["extrinsics", *given], *words)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Folder of a recording, `right`, and of a calibration with camera180 knocked; files of the pictures."""
    folder = tmp_path_factory.mktemp("check")
    write_recording(folder / "right", [bare("cube_v2", RIG.cameras, [71, k]) for k in range(6)])
    nudged(RIG, 1, [0.012, -0.009, 0.0]).save(folder / "wrong")
    return folder, [folder / "right" / f"{k:06d}" / f"{name}.png" for k in range(6) for name in RIG.names]


def test_a_right_calibration_fits(pictures, run_here):
    folder, files = pictures
    result = well(run_here("check", *files, *CUBE, "--calibration", folder / "right"))
    assert "the calibration fits" in result.stdout
    assert re.search(r"2 mm need its focal length right to 0\.\d\d %", result.stdout)
    # The simulated rig has the focal lengths of the platform's files.
    assert re.search(r"warning +camera60: fy/fx is 1\.0058, expected 1", result.stdout)


def test_files_that_are_not_used_are_not_judged(pictures, tmp_path, run_here):
    recording = shutil.copytree(pictures[0] / "right", tmp_path / "recording")
    shutil.copy(pictures[0] / "wrong" / "camera180.yml", tmp_path / "other_downsampled.yml")
    check = ("check", recording, "--stills", *CUBE)
    result = well(run_here(*check))
    assert "the calibration fits" in result.stdout
    assert "principal point was halved" not in result.stdout
    for name in RIG.names:
        (recording / f"{name}.yml").rename(recording / f"{name}_downsampled.yml")
    used = ("--calibration", recording, "--pattern", "*_downsampled.yml")
    assert well(run_here(*check, *used)).stdout.count("principal point was halved") == 3


def test_a_camera_that_never_sees_the_object_is_no_part_of_the_verdict(pictures, run_here):
    folder, files = pictures
    blank = folder / "blank-camera300.bmp"
    cv2.imwrite(str(blank), np.full_like(cv2.imread(str(files[0])), 110))
    given = [blank if k % 3 == 2 else file for k, file in enumerate(files)]
    result = well(run_here("check", *given, *CUBE, "--calibration", folder / "right"))
    assert "the calibration fits: " in result.stdout
    assert "; not checked: camera300" in result.stdout
    result = run_here("check", *given, *CUBE, "--calibration", folder / "wrong")
    assert "does not fit: camera60 or camera180 has moved; only a third camera could tell" in result.stdout


def test_inverted_transforms_are_pointed_out(pictures, tmp_path, run_here):
    back = (dataclasses.replace(one, camera_from_world=np.linalg.inv(one.camera_from_world)) for one in RIG)
    tracker.CameraRig(tuple(back)).save(tmp_path)
    result = run_here("check", *pictures[1][:3], *CUBE, "--calibration", tmp_path)
    assert result.returncode == 2
    assert "warning: the calibration shows the arena in few or no images" in result.stderr


def test_a_camera_without_a_first_image_is_scaled_by_its_next(pictures, tmp_path, run_here):
    RIG.resized(540, 540).save(tmp_path)
    given = ("none", *pictures[1][1:], *CUBE, "--calibration", tmp_path, "--resize-calibration")
    assert "the calibration fits" in well(run_here("check", *given)).stdout


def test_a_camera_that_was_knocked_is_named_and_drawn(pictures, run_here, tmp_path):
    folder, files = pictures
    check = ("check", *files, *CUBE, "--calibration", folder / "wrong")
    result = run_here(*check, "--json", "--plot", tmp_path / "check.png")
    assert result.returncode == 1, result.stderr
    found = json.loads(result.stdout)
    assert not found["fits"]
    assert [one["moved"] for one in found["cameras"]] == [False, True, False]
    assert found["cameras"][1]["turn_deg"] == pytest.approx(np.degrees(0.015), abs=0.15)
    assert found["cameras"][1]["corners_seen_px"] > 2 * found["cameras"][1]["corners_shape_px"]
    assert found["cameras"][1]["focal_needed_percent"] == pytest.approx(0.4, abs=0.1)
    assert all("fy/fx" in one for one in found["warnings"])
    picture = cv2.imread(str(tmp_path / "check.png"))
    assert picture.shape[1] == 3 * picture.shape[0] * 420 // 496
    assert "does not fit: camera180 has moved" in run_here(*check).stdout


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("carried") / "recording", list(carried()))


def test_the_refined_calibration_is_written_and_summarised(moving, tmp_path, run_here):
    target, wrong, rig = tmp_path / "mended", tmp_path / "wrong", knocked(RIG, seed=4)
    save_rig(rig, wrong, {one.name: Calibrated(one, distortion_std=np.full(5, 2e-3)) for one in rig})
    tracker.load_colors("cube_v2").save(tmp_path / "own.npz")
    arguments = (moving, *CUBE, "--stills", "--calibration", wrong, "--focal", "-o", target)
    result = well(run_here("refine", *arguments, "--colors", tmp_path / "own.npz"))
    mine = tracker.load_object(target / "object.toml")
    assert (mine.name, mine.colors) == ("cube_v2", str(tmp_path / "own.npz"))
    assert f"{1e3 * mine.rim:.2f} ± {1e3 * mine.rim_std:.2f} mm" in result.stdout
    assert abs(mine.rim) < 3 * mine.rim_std < 1e-3  # drawn boxes are sharp
    for words in ("camera60", "against the mean", "in held-out frames", "x, y and yaw", "focal"):
        assert words in result.stdout
    for camera in RIG:
        lens, off = read_calibrated(target / f"{camera.name}.yml"), np.zeros((3, 3))
        off[:2] = np.abs(lens.camera.matrix - camera.matrix)[:2]
        assert (off <= 4 * lens.matrix_std).all()
        assert 0.0 < lens.matrix_std[0, 0] < 0.01 * camera.matrix[0, 0]
        assert (lens.distortion_std == 2e-3).all()  # it is not fitted
    rigs = (tracker.CameraRig.load(folder) for folder in (target, wrong))
    mended, before = (abs(relative_errors(rig, RIG)[:, :3]).max() for rig in rigs)
    assert mended < 0.5 * before


def test_a_rim_below_nothing_is_written_as_none_and_colours_are_found_from_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tracker.load_colors("cube_v2").save(tmp_path / "mine.npz")
    mine = dataclasses.replace(tracker.load_object("cube_v2"), colors="mine.npz")
    (tmp_path / "mended").mkdir()
    (tmp_path / "mended" / "object.toml").write_text(object_text(mine, (-2e-5, 5e-5)))
    found = tracker.load_object(tmp_path / "mended" / "object.toml")
    assert (found.rim, found.rim_std) == (0.0, 5e-5)
    monkeypatch.chdir("/")
    assert tracker.load_colors(found.colors)


def test_without_a_gain_nothing_is_written(moving, tmp_path, run_here):
    arguments = ("refine", moving, *CUBE, "--stills", "-o", tmp_path / "mended")
    assert_refused(run_here, tmp_path, arguments, "refused: edges in 9 frames held out", "as good as", code=1)


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    folder = write_recording(tmp_path_factory.mktemp("rests") / "recording", list(rests()))
    high = np.eye(4)
    high[2, 3] = -0.004
    for camera in moved(RIG, high):
        known = Calibrated(camera, np.full((3, 3), 0.3), np.full(5, 1e-3))
        (folder / f"{camera.name}.yml").write_text(calibration_text(known))
    return folder


def test_a_calibration_on_the_table_is_written_and_summarised(resting, tmp_path, run_here):
    target = tmp_path / "mended"
    result = well(run_here("table", resting, "--stills", *CUBE, "-o", target))
    assert "in 6 of 6 places" in result.stdout
    assert re.search(r"height \[mm\] +\+(3\.9|4\.0)", result.stdout)
    rig = tracker.CameraRig.load(target)
    assert rig.names == RIG.names
    assert rig.arena.table == 0.0
    assert rig.arena.table_std != RIG.arena.table_std
    for one, true in zip(rig, RIG, strict=True):
        np.testing.assert_allclose(one.position, true.position, atol=1e-3)
        kept, before = (read_calibrated(folder / f"{one.name}.yml") for folder in (target, resting))
        np.testing.assert_array_equal(kept.matrix_std, before.matrix_std)
        np.testing.assert_array_equal(kept.distortion_std, before.distortion_std)


def test_places_that_make_up_the_table_are_the_places_at_rest(resting, tmp_path, run_here, monkeypatch):
    doubted = np.array([1.0, 1.0, 1.0, 1.0, 0.4, 0.0])
    plane = TablePlane((0.0, 0.0), 0.004, np.zeros(2), 1e-8 * np.eye(3), doubted, 1e-4)
    monkeypatch.setattr("tracker.cli.calibrate.find_table", lambda *_: (RIG, plane, 6))
    result = well(run_here("table", resting, "--stills", *CUBE, "-o", tmp_path / "mended"))
    assert "in 5 of 6 places" in result.stdout


def test_pictures_may_be_named_moment_by_moment(resting, tmp_path, run_here):
    ordered = [frame / f"{name}.png" for frame in sorted(resting.glob("0*")) for name in RIG.names]
    target = tmp_path / "mended"
    result = run_here("table", *ordered, *CUBE, "--calibration", resting, "-o", target, "-q")
    assert (result.returncode, result.stdout) == (0, ""), result.stderr
    assert (target / "arena.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("check {resting} {cube} --plot {one}/a.png", ["a folder of images"]),
        ("refine {resting} {cube} -o {used}/camera60.yml", ["found a file, expected a folder"]),
        ("board {board} --square 0.4 --marker 0.3 -o board.pdf", ["at most 1200 mm"]),
        ("extrinsics {board} --intrinsics {resting} --height nan -o new {one}", ["--height", "nan"]),
        ("extrinsics {board} --intrinsics {resting} --yaw inf -o new {one}", ["--yaw", "inf"]),
        ("check {one}/camera60.png {cube} --calibration {resting}/camera60.yml", ["alone"]),
        ("refine {resting} {cube} --stills --frames 3 -o new", ["--frames", "18"]),
        ("table {resting} {cube} -o {used}", ["in use", "new or an empty folder"]),
        ("table {resting} {cube} -o new", ["found 0 places", "expected 5 or more"]),
        ("table {one} {cube} -o new", ["found 1 places in which the object rests"]),
        ("table {one}/camera60.png {cube} -o new", ["no calibration", "--calibration"]),
        ("table {one}/camera60.png {cube} --calibration {resting} -o new", ["multiple of 3", "camera180"]),
        ("table nowhere {cube} -o new", ["nowhere"]),
        ("check {resting} {fewer} {cube}", ["fewer", "another calibration or arena"]),
        ("check {one} {one}/../000000 {cube}", ["000000 again"]),
        ("extrinsics {board} --intrinsics {resting} -o new {one} {one}", ["000000 again"]),
        ("intrinsics {board} --name left -o new.yml {one}/camera60.png {one}/camera60.png", ["60.png again"]),
        ("check {fewer} {resting} {cube}", ["another calibration or arena"]),
        ("table {resting} {cube}", ["-o"]),
    ],
)
def test_what_cannot_be_done_is_reported_in_a_line(arguments, words, resting, tmp_path, run_here):
    used = tmp_path / "used"
    used.mkdir()
    (used / "camera60.yml").write_text("old")
    fewer = tmp_path / "fewer"
    (fewer / "camera60").mkdir(parents=True)
    shutil.copy(resting / "000000" / "camera60.png", fewer / "camera60" / "000000.png")
    shutil.copy(resting / "camera60.yml", fewer)
    folders = {"resting": resting, "one": resting / "000000", "used": used, "fewer": fewer}
    given = arguments.format(**folders, cube=" ".join(CUBE), board=" ".join(BOARD)).split()
    assert_refused(run_here, tmp_path, given, *words)
