import contextlib
import dataclasses
import json
import os
import re
import runpy
import shutil
import signal
import sys
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from synthetic import cli
from synthetic.camera.rigs import choose_rig, standard_rig
from synthetic.export.dataset import DatasetOptions, make_dataset
from synthetic.frames import DatasetError, FrameOptions
from tests.helpers import contents, nudged, opencv_pixels, run_python
from tests.helpers.command import begin, until, well, workers_of
from tests.helpers.log_writers import CAMERAS
from tests.helpers.synthetic_needs import skip_without_platform
from tracker import CameraRig, load_object, open_log
from tracker.errors import CalibrationError
from tracker.geometry.arena import Arena
from tracker.geometry.cuboid import corners
from tracker.logs.pictures import from_bayer

skip_without_platform()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "set"
    make_dataset(DatasetOptions(FrameOptions("cube_v2", 4, "fast"), 3, "perturbed", bop=True), folder)
    return folder


@pytest.fixture
def generate(run_here):
    """Runs the command that makes this data set."""
    options = ("--object", "cube_v2", "--quality", "fast", "--bop", "--calibration", "perturbed")
    return partial(run_here, "dataset", "--frames", 3, "--seed", 4, *options, "--out", main=cli.main)


def read(path: Path):
    """A file's JSON, or its picture as it is."""
    if path.suffix == ".json":
        return json.loads(path.read_text())
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def truth_of(folder: Path) -> dict:
    return read(folder / "ground_truth.json")


def test_the_layout_is_complete(made):
    truth = truth_of(made)
    assert truth["seed"] == 4
    assert truth["object"] == "cube_v2"
    assert truth["renderer"] == "raster"
    assert [entry["frame"] for entry in truth["frames"]] == ["000000", "000001", "000002"]
    assert CameraRig.load(made).names == CAMERAS
    for entry in truth["frames"]:
        assert set(entry) == {"frame", "timestamp", "object", "robot_position", "cameras", "scene"}
        assert len(entry["robot_position"]) == 9
        assert np.linalg.norm(entry["object"]["orientation_xyzw"]) == pytest.approx(1)
        for name in CAMERAS:
            seen = entry["cameras"][name]
            image, labels = (read(made / entry["frame"] / f"{kind}{name}.png") for kind in ("", "labels_"))
            assert image.dtype == labels.dtype == np.uint8
            assert (image.shape, labels.shape) == ((270, 270, 3), (270, 270))
            assert labels.max() <= 6
            assert np.count_nonzero(labels) == seen["visible_px"]
            assert 0 <= seen["visible_fraction"] <= 1
    assert not list(made.glob(".*"))


@pytest.mark.slow
def test_the_pixels_do_not_depend_on_the_number_of_workers(made, generate, tmp_path):
    well(generate(tmp_path / "two", "--workers", 2))
    assert contents(made) == contents(tmp_path / "two")


@pytest.mark.process
@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_workers_end_with_a_run_that_is_ended(number, code, tmp_path):
    options = ("--object", "cube_v2", "--seed", 4, "--quality", "fast", "--workers", 2)
    process = begin("dataset", "--frames", 999, *options, "--out", tmp_path / "set", program="synthetic")
    try:
        until((tmp_path / "set" / "000001").exists, process)
        os.kill(process.pid, number)
        _, err = process.communicate(timeout=60)
        assert process.returncode == code
        assert err.endswith(b"continues\n") == (code > 0)
        until(lambda: not workers_of(process))
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


INTERRUPTED = """
import signal, sys
class Finder:
    def find_spec(name, *_):
        if name == "networkx":  # which trimesh looks for, ready to do without it
            signal.raise_signal(signal.SIGTERM)
sys.meta_path.insert(0, Finder)
from synthetic.cli import main
main(["dataset", "--object", "cube_v2", "--frames", "1", "--seed", "4", "--out", sys.argv[1]])
"""


def test_a_signal_that_comes_while_libraries_are_imported_ends_the_run(tmp_path):
    run = run_python(["-c", INTERRUPTED, tmp_path / "set"])
    assert (run.returncode, run.stderr) == (143, "synthetic: interrupted; the same command continues\n")


def test_an_interrupted_run_continues_where_it_stopped(made, generate, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(made, folder)
    truth = truth_of(folder)
    for others in (".5.mine", ".000001.notes", f".000001.{os.getppid()}"):  # the last of a run that goes on
        (folder / others).mkdir()
    expected = contents(folder)
    # As after a kill: one frame whose truth was not noted, one that is not there, one half written.
    del truth["frames"][1]
    (folder / "ground_truth.json").write_text(json.dumps(truth))
    shutil.rmtree(folder / "000002")
    (folder / ".000002.999999999").mkdir()
    untouched = (folder / "000000" / "camera60.png").stat().st_mtime_ns
    assert "2 frames made, 1 kept" in well(generate(folder)).stdout
    assert contents(folder) == expected
    assert (folder / "000000" / "camera60.png").stat().st_mtime_ns == untouched


def test_a_folder_of_other_options_is_refused(made, generate):
    before = contents(made)
    refused = {"--seed": (5, "made with seed 4, expected 5"), "--frames": (2, "fewer than the 2 asked for")}
    for option, (number, message) in refused.items():
        result = generate(made, option, number)
        assert result.returncode == 2
        assert message in result.stderr
        assert contents(made) == before


def test_a_data_set_may_be_chosen_by_numbers_of_numpy_and_continued_by_others(tmp_path):
    options = FrameOptions("cube_v2", np.int64(4), "fast", size=np.int64(270), rate=np.float32(10))
    assert make_dataset(DatasetOptions(options, 1), tmp_path) == 1
    assert make_dataset(DatasetOptions(FrameOptions("cube_v2", 4, "fast"), 1), tmp_path) == 0


@pytest.mark.parametrize("name", ["camera60", "north_camera0"])
def test_a_data_set_has_frames_of_one_calibration(name, tmp_path):
    rig = CameraRig((dataclasses.replace(standard_rig()[0], name=name),))
    for folder, shift in (("one", 0.0), ("other", 0.02)):
        nudged(rig, 0, shift=(shift, 0, 0)).save(tmp_path / folder)
    options = FrameOptions("cube_v2", 4, "fast")
    make_dataset(DatasetOptions(options, 1, str(tmp_path / "one")), tmp_path / "set")
    before = contents(tmp_path / "set")
    with pytest.raises(DatasetError, match="found frames of another calibration"):
        make_dataset(DatasetOptions(options, 2, str(tmp_path / "other")), tmp_path / "set")
    assert contents(tmp_path / "set") == before
    make_dataset(DatasetOptions(options, 2, str(tmp_path / "one")), tmp_path / "set")


def test_a_run_in_this_process_leaves_opencv_its_threads(tmp_path):
    threads = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        make_dataset(DatasetOptions(FrameOptions("cube_v2", 4, "fast"), 1), tmp_path)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(threads)


def test_a_run_that_ended_before_its_first_frame_ties_a_folder_to_no_calibration(tmp_path):
    (camera,) = standard_rig().cameras[:1]
    folded = dataclasses.replace(camera, name="north_camera0", distortion=np.array([-2.0, 0, 0, 0, 0]))
    for folder, one in (("folded", folded), ("right", camera)):
        CameraRig((one,)).save(tmp_path / folder)
    options = FrameOptions("cube_v2", 4, "fast")
    with pytest.raises(CalibrationError, match="no inverse"):
        make_dataset(DatasetOptions(options, 1, str(tmp_path / "folded")), tmp_path / "set")
    assert make_dataset(DatasetOptions(options, 1, str(tmp_path / "right")), tmp_path / "set") == 1
    assert CameraRig.load(tmp_path / "set").names == (camera.name,)


def test_errors_are_one_line_with_exit_code_2(tmp_path, run_here, monkeypatch):
    (tmp_path / "letter.txt").write_text("not a data set")
    options = ("--object", "cube_v2", "--frames", "3", "--seed", "4", "--out", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["synthetic", "dataset", *options])
    result = run_here(main=lambda _: runpy.run_module("synthetic", run_name="__main__"))
    assert result.returncode == 2
    assert re.fullmatch("cube_v2\nsynthetic: .* expected an empty folder or none.*\n", result.stderr)
    refused = run_here("dataset", "--object", "cube", main=cli.main)
    assert refused.stderr.endswith("(see python -m synthetic dataset --help)\n")


def test_the_bop_files_agree_with_the_truth(made):
    rig = {camera.name: camera for camera in CameraRig.load(made)}
    scene, size = made / "bop" / "test" / "000001", load_object("cube_v2").size
    models = read(made / "bop" / "models" / "models_info.json")
    assert models["1"]["size_x"] == pytest.approx(65.0)
    assert models["1"]["diameter"] == pytest.approx(65.0 * np.sqrt(3))
    for name in CAMERAS:
        cameras, poses, infos = (
            read(scene / f"scene_{kind}_{name}.json") for kind in ("camera", "gt", "gt_info")
        )
        for entry in truth_of(made)["frames"]:
            key = str(int(entry["frame"]))
            if entry["object"] is None:
                assert poses[key] == []
                continue
            (pose,), (info,) = poses[key], infos[key]
            assert pose["obj_id"] == 1
            bop = seen_in_bop(cameras[key], pose, size)
            # The truth by another way: the camera's file, and scipy's quaternions.
            expected = project_truth(rig[name], entry["object"], corners(size))
            assert np.abs(bop - expected).max() < 1e-6
            mask = mask_within(scene, name, key, bop)
            visible = read(scene / f"mask_visib_{name}" / f"{int(key):06d}_000000.png")
            assert not (visible[mask == 0]).any()
            assert info["px_count_all"] == np.count_nonzero(mask)
            assert info["px_count_visib"] == np.count_nonzero(visible)


def seen_in_bop(camera, pose, size):
    """Pixels (8, 2) of the corners of a box, by what the layout says of camera and pose."""
    rotation, _ = cv2.Rodrigues(np.reshape(pose["cam_R_m2c"], (3, 3)))
    matrix, shift = np.reshape(camera["cam_K"], (3, 3)), np.array(pose["cam_t_m2c"])
    return cv2.projectPoints(1000 * corners(size), rotation, shift, matrix, np.zeros(5))[0][:, 0]


def mask_within(scene, name, key, points):
    """The mask of a frame, which fills the outline of these pixels."""
    outline = cv2.convexHull(points.astype(np.float32))
    mask = read(scene / f"mask_{name}" / f"{int(key):06d}_000000.png")
    for row, column in np.argwhere(mask > 0)[::7]:
        assert cv2.pointPolygonTest(outline, (float(column), float(row)), True) > -1.0
    assert np.count_nonzero(mask) == pytest.approx(cv2.contourArea(outline), rel=0.03)
    return mask


def project_truth(camera, state, points):
    world = points @ Rotation.from_quat(state["orientation_xyzw"]).as_matrix().T + state["position"]
    return opencv_pixels(dataclasses.replace(camera, distortion=np.zeros(5)), world)


def test_the_bop_files_tell_true_cameras_each_picture_at_its_own_moment_and_colours_of_mosaics(tmp_path):
    effects = ("calibration", "timing")
    film = {"sequence": True, "kind": "drop", "length": 3, "raw": True, "path": "old"}
    options, made = FrameOptions("cube_v1", 0, "fast", effects=effects, **film), tmp_path / "set"
    make_dataset(DatasetOptions(options, 2, bop=True), made)
    scene, size = made / "bop" / "test" / "000001", load_object("cube_v1").size
    apart = []
    for name, usual in zip(CAMERAS, standard_rig(), strict=True):
        cameras, poses = (read(scene / f"scene_{kind}_{name}.json") for kind in ("camera", "gt"))
        for entry in truth_of(made)["frames"]:
            key, taken = str(int(entry["frame"])), entry["cameras"][name]
            own = {part: np.array(taken[part]) for part in ("matrix", "camera_from_world")}
            true = dataclasses.replace(usual, **own)
            (pose,) = poses[key]
            bop = seen_in_bop(cameras[key], pose, size)
            np.testing.assert_allclose(bop, project_truth(true, taken["object"], corners(size)), atol=1e-6)
            apart.append(np.abs(bop - project_truth(true, entry["object"], corners(size))).max())
            mask_within(scene, name, key, bop)
            assert read(scene / f"rgb_{name}" / f"{int(key):06d}.png").shape == (270, 270, 3)
            assert read(made / entry["frame"] / f"{name}.png").shape == (270, 270)
    # Somewhere the object had moved on by the frame's stamp.
    assert max(apart) > 1.0
    assert read(made / "bop" / "dataset_info.json")["mosaic"] == "removed"
    with open_log(made) as log:
        frame, given = log.frame(1), CameraRig.load(made / "000000")
        for mosaic, image, name in zip(frame.raw, frame.images, CAMERAS, strict=True):
            np.testing.assert_array_equal(mosaic, read(made / "000001" / f"{name}.png"))
            np.testing.assert_array_equal(image, from_bayer(mosaic))
        # Commands take the calibration that the film states, not the cameras that it was made with.
        for camera, own in zip(log.rig, given, strict=True):
            np.testing.assert_array_equal(camera.camera_from_world, own.camera_from_world)


def test_the_bop_counts_of_a_die_hold_what_other_dice_hide_and_what_is_beyond_the_image(tmp_path):
    options, near = FrameOptions("dice", 1, "fast", kind="dice_thrown"), tmp_path / "near"
    CameraRig(tuple(camera.cropped(90, 90, 360, 360) for camera in standard_rig())).save(near)
    make_dataset(DatasetOptions(options, 1, str(near), bop=True), tmp_path / "set")
    hidden = cut = 0
    for name in CAMERAS:
        (dice,) = read(tmp_path / "set/bop/test/000001" / f"scene_gt_info_{name}.json").values()
        for die in dice:
            left, top, width, height = die["bbox_obj"]
            inside = left > 1 and top > 1 and left + width < 269 and top + height < 269
            # The hull of a box's corners fills half of the rectangle around it, or more.
            assert die["px_count_all"] >= 0.45 * width * height
            assert die["px_count_visib"] <= die["px_count_valid"] <= die["px_count_all"]
            assert not inside or die["px_count_valid"] == die["px_count_all"]
            hidden, cut = hidden + (inside and die["visib_fract"] < 0.2), cut + (not inside)
    assert min(hidden, cut) > 5


def test_scenes_that_state_another_calibration_each_have_none_together(tmp_path):
    options = FrameOptions("cube_v2", 1, "fast", effects=("calibration",))
    make_dataset(DatasetOptions(options, 2), tmp_path / "set")
    with open_log(tmp_path / "set") as log:
        assert log.rig is None
    # What a folder says of its arena changes nothing that is rendered.
    dataclasses.replace(standard_rig(), arena=Arena(table=0.05)).save(tmp_path)
    assert choose_rig(str(tmp_path), 0).arena == standard_rig().arena
