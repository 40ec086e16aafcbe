import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import ROOT
from tests.helpers.command import assert_one_line_error
from tracker.cli.stills import of_cameras

DEMO = ROOT / "tracker" / "demo"
PHOTOS = DEMO / "000003"
NAMES = ("camera60", "camera180", "camera300")


def photos(*names):
    return [PHOTOS / f"{name}.jpg" for name in names]


@pytest.fixture
def detect(run_here, tmp_path):
    """Answers of `tracker detect --json` on the recording that comes with the package."""

    def found(*arguments: object):
        result = run_here("detect", "--object", "cube_v2", "--json", *arguments, folder=tmp_path)
        return result, json.loads(result.stdout) if result.returncode == 0 else None

    return found


@pytest.mark.parametrize(
    "given",
    [
        [DEMO, "--frame", "3"],
        ["--calibration", DEMO, *photos(*sorted(NAMES))],
        ["--calibration", DEMO, "a.jpg", "b.jpg", "c.jpg"],
        [*(f"--calibration={DEMO}/{name}.yml" for name in NAMES[::-1]), "c.jpg", "b.jpg", "a.jpg"],
    ],
    ids=["a folder's frame", "named in another order", "without names", "in the order of calibrations"],
)
def test_pictures_are_those_of_their_cameras_however_they_are_given(given, detect, tmp_path):
    for name, letter in zip(NAMES, "abc", strict=True):
        shutil.copy(PHOTOS / f"{name}.jpg", tmp_path / f"{letter}.jpg")
    _, expected = detect("--calibration", DEMO, *photos(*NAMES))
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
        for name, other in (NAMES[:2], NAMES[1::-1]):
            shutil.copy(DEMO / frame / f"{other}.jpg", tmp_path / "log" / frame / f"{name}.jpg")
    result, found = detect("--calibration", DEMO, tmp_path / "log")
    warning = "the images of camera60 and camera180 look swapped"
    assert result.stderr.splitlines() == [f"tracker: warning: {warning}"]
    assert found["pose"] is None or found["pose"]["confidence"] < 0.5
    more = ("--object", "cube_v2", "--calibration", DEMO, "--quiet", "-o", "poses.h5")
    tracked = run_here("track", "log", *more, folder=tmp_path)
    assert tracked.stderr.splitlines() == [f"tracker: warning: log: {warning}"]


def test_a_calibration_of_another_size_is_scaled_where_that_is_asked_for(detect, tmp_path):
    for name in NAMES:
        whole = cv2.imread(str(PHOTOS / f"{name}.jpg"))
        large = cv2.resize(whole, (540, 540), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(tmp_path / f"{name}.png"), large)
    _, small = detect("--calibration", DEMO, *photos(*NAMES))
    given = ["--calibration", DEMO, *(f"{name}.png" for name in NAMES)]
    assert_one_line_error(detect(*given)[0], "540×540 px", "calibrated for 270×270", "--resize-calibration")
    _, large = detect("--resize-calibration", *given)
    # A principal point that is off by the quarter pixel is off by 0.4 mm.
    np.testing.assert_allclose(large["pose"]["position"], small["pose"]["position"], atol=2e-4)


def test_the_likely_cause_is_printed_and_drawn(detect, tmp_path):
    for name in NAMES:
        image = cv2.imread(str(PHOTOS / f"{name}.jpg"))
        cv2.imwrite(str(tmp_path / f"{name}.png"), cv2.GaussianBlur(image, (0, 0), 15))
    given = ["--calibration", DEMO, *(f"{name}.png" for name in NAMES), "--overlay", "drawn.png"]
    result, found = detect(*given)
    assert found["pose"] is None
    (line,) = result.stderr.splitlines()
    assert line.startswith("tracker: warning: camera60: blurred by ")
    result, _ = detect("--calibration", DEMO, *photos(*NAMES), "--overlay", "good.png")
    assert result.stderr == ""
    heights = [len(cv2.imread(str(tmp_path / name))) for name in ("drawn.png", "good.png")]
    assert heights[0] > 540 + 100
    assert heights[0] != heights[1]


def test_twelve_bits_in_sixteen_are_named_and_not_taken_for_black(detect, tmp_path):
    for name in NAMES:
        image = cv2.imread(str(PHOTOS / f"{name}.jpg")).astype(np.uint16)
        cv2.imwrite(str(tmp_path / f"{name}.png"), image * 16)
        cv2.imwrite(str(tmp_path / f"whole_{name}.png"), image * 256)
    given = ["--calibration", DEMO]
    result, _ = detect(*given, *(f"{name}.png" for name in NAMES))
    assert_one_line_error(result, "16 bits, as of a camera of 12 bits", "image >> 4")
    assert detect(*given, *(f"whole_{name}.png" for name in NAMES))[1]["pose"] is not None
    images = [cv2.imread(str(tmp_path / f"{name}.png"), cv2.IMREAD_UNCHANGED) for name in NAMES]
    with pytest.raises(tracker.TrackerError, match=r"uint8 is needed: \(image >> 4\)"):
        tracker.ObjectTracker("cube_v2", DEMO).detect(images)


def test_cameras_that_contradict_each_other_get_a_warning_beside_the_pose(detect, tmp_path):
    rig = tracker.CameraRig.load(DEMO)
    moved = rig[0].camera_from_world.copy()
    moved[:3, 3] += [8e-3, 0.0, 0.0]
    first = dataclasses.replace(rig[0], camera_from_world=moved)
    tracker.CameraRig((first, *rig.cameras[1:])).save(tmp_path / "moved")
    result, found = detect("--calibration", tmp_path / "moved", *photos(*NAMES))
    assert found["pose"] is not None
    assert "tracker calibrate check" in result.stderr
    assert detect("--calibration", DEMO, *photos(*NAMES))[0].stderr == ""
