import json
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers import make_camera
from tests.helpers.log_writers import CAMERAS, make_content, write_hdf5, write_picture
from tests.helpers.reading import change, put
from tracker.errors import CalibrationError, LogError
from tracker.logs.folder import write_folder
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.logs.opening import fitted_to

IMAGE = np.zeros((20, 30, 3), np.uint8)


@pytest.fixture
def folder(tmp_path) -> Path:
    for name in CAMERAS:
        write_picture(tmp_path / "images" / name / "000000.png", IMAGE)
    return tmp_path / "images"


def rig_of(*names: str, size: tuple[int, int] = (30, 20)) -> tracker.CameraRig:
    return tracker.CameraRig(tuple(make_camera(60 + k, name).resized(*size) for k, name in enumerate(names)))


def fitted(folder: Path, rig: tracker.CameraRig | None = None, **options: bool) -> tracker.CameraRig:
    with tracker.open_log(folder) as log:
        return fitted_to(folder, log, rig, **options)


def test_cameras_are_matched_by_their_names_and_in_their_order_where_none_is_known(folder):
    assert fitted(folder, rig_of("camera300", "camera60", "camera180")).names == CAMERAS
    names = ("left", "right", "above")
    assert fitted(folder, rig_of(*names)).names == names


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("camera60", "camera300", "camera240"), r"camera300, camera240; expected that of camera180"),
        (("camera60", "camera180"), r"camera60, camera180; expected that of camera300, too"),
        (("left", "right"), r"left, right; expected the same cameras"),
        ((*CAMERAS, "camera240"), r"expected the same cameras"),
    ],
)
def test_other_cameras_are_refused(folder, names, message):
    with pytest.raises(CalibrationError, match=message):
        fitted(folder, rig_of(*names))


def test_another_size_is_scaled_only_where_that_is_asked_for(folder):
    large = rig_of(*CAMERAS, size=(120, 80))
    with pytest.raises(CalibrationError, match=r"30×20 px.*ion is for 120×80; .*--resize-calibration"):
        fitted(folder, large)
    for scaled, camera in zip(fitted(folder, large, resize=True), large, strict=True):
        np.testing.assert_array_equal(scaled.matrix, camera.resized(30, 20).matrix)
    with pytest.raises(CalibrationError, match=r"30×20 px.*90×80, which is of another shape"):
        fitted(folder, rig_of(*CAMERAS, size=(90, 80)), resize=True)


@pytest.mark.parametrize("resize", [False, True])
def test_a_camera_none_of_whose_pictures_can_be_read_is_no_fault_of_the_calibration(folder, resize):
    picture = folder / "camera180" / "000000.png"
    picture.unlink()
    picture.mkdir()
    assert fitted(folder, rig_of(*CAMERAS), resize=resize)[1].width == 30
    with tracker.open_log(folder) as log, pytest.raises(LogError) as raised:
        log.frame(0)
    assert str(raised.value) == f"{picture}: cannot be read: Is a directory"


def test_a_calibration_beside_that_lacks_a_camera_names_it(folder):
    rig_of(*CAMERAS).save(folder)
    assert fitted(folder).names == CAMERAS
    file = folder / "camera180.yml"
    file.write_text(file.read_text().replace("camera180", "camera181"))
    with pytest.raises(tracker.TrackerError, match="expected camera180"):
        fitted(folder)
    file.unlink()
    with pytest.raises(LogError, match="no calibration of camera180; expe"):
        fitted(folder)
    for name in ("camera60", "camera300"):
        (folder / f"{name}.yml").rename(folder / f"top{name}.yml")
    lacking = "no calibration of camera60, camera180, camera300 in or beside it, .* like camera60.yml"
    with pytest.raises(CalibrationError, match=lacking):
        fitted(folder)


def write_hdf5_called(folder: Path, name: str) -> Path:
    path = write_hdf5(folder / "log.h5", make_content(1))
    change(path, put("camera_names", [text.encode() for text in (name, *CAMERAS[1:])]))
    return path


def write_described(folder: Path, name: str) -> Path:
    write_picture(folder / "left" / "0.png", IMAGE)
    (folder / "recording.toml").write_text(f"[cameras]\n{json.dumps(name)} = 'left/*.png'\n")
    return folder


def write_folders(folder: Path, name: str) -> Path:
    for camera in (name.replace("/", "<"), "right"):
        write_picture(folder / camera / "0.png", IMAGE)
    return folder


@pytest.mark.parametrize("write", [write_hdf5_called, write_described, write_folders])
@pytest.mark.parametrize("name", ["a/../b", "bell\x07", "two\nlines", "</script>", 101 * "a"])
def test_a_recording_whose_camera_has_no_cameras_name_is_refused(write, name, tmp_path):
    with pytest.raises(LogError, match=r"name of a camera: found .*, expected a name of up to 100") as raised:
        tracker.open_log(write(tmp_path, name))
    assert str(raised.value).isprintable()


@pytest.mark.parametrize(
    "names",
    [
        *[("links ä",), ("left-1.5",), (100 * "ö",)],
        *[("right", "left"), ("180", "60"), ("links ä", "a.5"), ("CameraB", "CameraA")],
    ],
)
def test_recordings_keep_the_names_that_cameras_can_have_and_their_order(names, tmp_path):
    rig = rig_of(*names)
    with Hdf5LogWriter(tmp_path / "log.h5", rig) as writer:
        for stamp in (1.0, 1.1):
            writer.append([IMAGE] * len(names), stamp)
    with tracker.open_log(tmp_path / "log.h5") as log:
        assert log.camera_names == names
        write_folder(tmp_path / "folder", log, rig, lambda _: None)
    with tracker.open_log(tmp_path / "folder") as log:
        assert (log.camera_names, log.rig.names) == (names, names)
        assert [frame.camera_timestamps.tolist() for frame in log] == [[1.0] * len(names), [1.1] * len(names)]
    with tracker.open_log(write_described(tmp_path / "described", names[0])) as log:
        assert log.camera_names == names[:1]
