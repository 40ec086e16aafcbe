from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import make_camera
from tracker.calibration.platform_files import write_camera
from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError


def make_rig(*azimuths: float) -> CameraRig:
    return CameraRig(tuple(make_camera(azimuth) for azimuth in azimuths))


@pytest.mark.parametrize("azimuths", [(60,), (60, 180), (60, 180, 300), (0, 9, 10, 45, 100, 200, 300)])
def test_saving_and_loading_keeps_cameras_and_order(azimuths, tmp_path):
    rig = make_rig(*azimuths)
    rig.save(tmp_path / "new" / "folder")
    loaded = CameraRig.load(tmp_path / "new" / "folder")
    assert loaded.names == rig.names == tuple(f"camera{azimuth}" for azimuth in azimuths)
    assert len(loaded) == len(azimuths)
    for before, after in zip(rig, loaded, strict=True):
        np.testing.assert_array_equal(before.camera_from_world, after.camera_from_world)


def test_a_folder_is_ordered_by_number_whatever_the_file_names(tmp_path):
    for name, azimuth in (("camera_a", 300), ("camera_b", 60), ("camera_c", 180)):
        write_camera(make_camera(azimuth), tmp_path / f"{name}.yml")
    assert CameraRig.load(tmp_path).names == ("camera60", "camera180", "camera300")


def test_cameras_without_a_number_are_ordered_by_that_of_their_file(tmp_path):
    for name, number in (("left", 10), ("right", 2), ("above", 300)):
        write_camera(make_camera(60, name), tmp_path / f"camera_calib_{number}.yaml")
    assert CameraRig.load(tmp_path).names == ("right", "left", "above")


def test_cameras_without_any_number_are_ordered_by_name(tmp_path):
    CameraRig((make_camera(60, "right"), make_camera(180, "left"))).save(tmp_path)
    assert CameraRig.load(tmp_path).names == ("left", "right")


def test_listed_files_keep_their_order(tmp_path):
    make_rig(60, 180, 300).save(tmp_path)
    files = [tmp_path / f"camera{number}.yml" for number in (180, 300, 60)]
    assert CameraRig.load(files).names == ("camera180", "camera300", "camera60")
    assert CameraRig.load(map(str, files)).names == ("camera180", "camera300", "camera60")


def test_a_file_is_a_rig_of_one(tmp_path):
    make_rig(60, 180).save(tmp_path)
    assert CameraRig.load(tmp_path / "camera180.yml").names == ("camera180",)


def test_other_files_in_a_folder_do_not_disturb(tmp_path):
    make_rig(60, 180).save(tmp_path)
    (tmp_path / "info.json").write_text("{}")
    (tmp_path / "trifinger.yml").write_text("a: b")
    (tmp_path / ".camera60.yml.abc.tmp").write_text("half written")
    (tmp_path / "camera300.yml").mkdir()
    assert CameraRig.load(str(tmp_path)).names == ("camera60", "camera180")


def test_variants_of_a_camera_are_named_with_a_way_to_select(tmp_path):
    variants = ("full", "cropped", "cropped_and_downsampled")
    for variant in variants:
        for azimuth in (60, 180, 300):
            write_camera(make_camera(azimuth), tmp_path / f"camera{azimuth}_{variant}.yml")
    with pytest.raises(CalibrationError, match="3 files of camera180") as caught:
        CameraRig.load(tmp_path)
    for variant in variants:
        pattern = f"camera*_{variant}.yml"
        assert pattern in str(caught.value)
        assert CameraRig.load(tmp_path, pattern=pattern).names == ("camera60", "camera180", "camera300")
    assert len(CameraRig.load(tmp_path, pattern="*_cropped.yml")) == 3


def test_a_variant_that_has_no_suffix_can_be_selected(tmp_path):
    for azimuth in (60, 180, 300):
        write_camera(make_camera(azimuth), tmp_path / f"camera{azimuth}.yml")
        write_camera(make_camera(azimuth), tmp_path / f"camera{azimuth}_full.yml")
    with pytest.raises(CalibrationError, match=r"camera\*\[0-9\]\.yml, camera\*_full\.yml"):
        CameraRig.load(tmp_path)
    assert len(CameraRig.load(tmp_path, pattern="camera*[0-9].yml")) == 3


def test_several_robots_in_a_folder_are_told_apart(tmp_path):
    for robot in ("r1", "r2"):
        for azimuth in (60, 180):
            write_camera(make_camera(azimuth), tmp_path / f"{robot}_camera{azimuth}.yml")
    with pytest.raises(CalibrationError, match=r"r1_camera\*\.yml, r2_camera\*\.yml"):
        CameraRig.load(tmp_path)
    assert len(CameraRig.load(tmp_path, pattern="r2_camera*.yml")) == 2


def test_a_folder_without_calibrations_says_what_it_holds(tmp_path):
    with pytest.raises(CalibrationError, match=r"found no files, expected a file like camera60\.yml"):
        CameraRig.load(tmp_path)
    (tmp_path / "info.json").write_text("{}")
    with pytest.raises(CalibrationError, match=r"found info\.json"):
        CameraRig.load(tmp_path)
    with pytest.raises(CalibrationError, match=r"a file that matches '\*_cropped.yml'"):
        CameraRig.load(tmp_path, pattern="*_cropped.yml")


def test_a_missing_path_is_named(tmp_path):
    with pytest.raises(CalibrationError, match="none: cannot be read: No such file"):
        CameraRig.load(tmp_path / "none")


def test_a_broken_file_in_a_folder_is_named(tmp_path):
    make_rig(60, 180).save(tmp_path)
    (tmp_path / "camera180.yml").write_text("a: [")
    with pytest.raises(CalibrationError, match=r"camera180\.yml: not plain YAML"):
        CameraRig.load(tmp_path)


def test_no_camera_and_equal_names_are_refused(tmp_path):
    with pytest.raises(CalibrationError, match="found no camera"):
        CameraRig(())
    with pytest.raises(CalibrationError, match="found no camera"):
        CameraRig.load([])
    with pytest.raises(CalibrationError, match="camera60 twice"):
        make_rig(60, 180, 60)


def test_a_rig_is_a_sequence_of_cameras():
    rig = make_rig(60, 180, 300)
    assert rig[1] is rig.cameras[1]
    assert list(rig) == list(rig.cameras)


def test_resizing_a_rig_resizes_every_camera():
    rig = make_rig(60, 180).resized(540, 135)
    for camera, name in zip(rig, ("camera60", "camera180"), strict=True):
        assert (camera.name, camera.width, camera.height) == (name, 540, 135)
        np.testing.assert_array_equal(camera.matrix, make_camera(60).resized(540, 135).matrix)


def test_the_halved_principal_point_is_corrected_by_name(tmp_path):
    make_rig(60, 180).save(tmp_path)
    for camera in CameraRig.load(tmp_path, correct_halved_principal_point=True):
        np.testing.assert_allclose(camera.matrix[:2, 2], make_camera().matrix[:2, 2] - 0.25)


@pytest.mark.parametrize("name", ["../camera", "a/b", ".hidden", "a\0b"])
def test_a_name_that_leaves_the_folder_is_not_saved(name, tmp_path):
    with pytest.raises(CalibrationError, match="as a file's name"):
        CameraRig((make_camera(60, name),)).save(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_saving_where_a_file_stands_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CalibrationError, match="cannot be made a folder"):
        make_rig(60).save(tmp_path / "file")
