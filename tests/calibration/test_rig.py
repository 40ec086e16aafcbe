import dataclasses
import errno
import os
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import yaml

from tests.helpers import ROOT, make_camera
from tests.helpers.log_writers import CAMERAS
from tracker.calibration.files import Calibrated, calibration_text
from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError
from tracker.files import claimed
from tracker.geometry.arena import Arena

DEMO = ROOT / "tracker" / "demo" / "camera60.yml"


def make_rig(*azimuths: float) -> CameraRig:
    return CameraRig(tuple(make_camera(azimuth) for azimuth in azimuths))


@pytest.mark.parametrize("azimuths", [(60,), (60, 180), (60, 180, 300), (0, 9, 10, 45, 100, 200, 300)])
def test_saving_and_loading_keeps_cameras_and_order(azimuths, tmp_path):
    rig = make_rig(*azimuths)
    rig.save(tmp_path / "new" / "folder")
    loaded = CameraRig.load(tmp_path / "new" / "folder")
    assert loaded.names == rig.names == tuple(f"camera{azimuth}" for azimuth in azimuths)
    assert len(loaded) == len(azimuths)
    assert loaded[-1] is loaded.cameras[-1] is list(loaded)[-1]
    for before, after in zip(rig, loaded, strict=True):
        np.testing.assert_array_equal(before.camera_from_world, after.camera_from_world)


@pytest.mark.parametrize(
    ("files", "order"),
    [
        ({"camera_a": "camera300", "camera_b": "camera60", "camera_c": "camera180"}, (60, 180, 300)),
        ({"camera_10": "left", "camera_2": "right", "camera_300": "above"}, ("right", "left", "above")),
        ({"camera_right": "right", "camera_left": "left"}, ("left", "right")),
        (
            {f"camera{n}": f"rig1_cam{n}" for n in (10, 11, 2)},
            ("rig1_cam2", "rig1_cam10", "rig1_cam11"),
        ),
    ],
    ids=["by the cameras' numbers", "by their files' numbers", "by name", "by all numbers of a name"],
)
def test_a_folder_has_an_order_and_listed_files_keep_theirs(files, order, tmp_path):
    for file, name in files.items():
        (tmp_path / f"{file}.yaml").write_text(calibration_text(Calibrated(make_camera(60, name))))
    assert CameraRig.load(tmp_path).names == tuple(n if isinstance(n, str) else f"camera{n}" for n in order)
    paths = [tmp_path / f"{file}.yaml" for file in files]
    for listed in (paths, map(str, paths)):
        assert CameraRig.load(listed).names == tuple(files.values())
    assert CameraRig.load(paths[0]).names == (next(iter(files.values())),)
    with pytest.raises(CalibrationError, match=rf"found 2 files of \w+ \({paths[0]}, {paths[0]}\).*camera$"):
        CameraRig.load([paths[0], *paths])


def test_other_files_in_a_folder_do_not_disturb(tmp_path):
    make_rig(60, 180).save(tmp_path)
    (tmp_path / "info.json").write_text("{}")
    (tmp_path / "trifinger.yml").write_text("a: b")
    (tmp_path / ".camera60.yml.abc.tmp").write_text("half written")
    (tmp_path / "camera300.yml").mkdir()
    assert CameraRig.load(str(tmp_path)).names == ("camera60", "camera180")


@pytest.mark.parametrize(
    ("names", "message", "patterns"),
    [
        (
            ("camera{}_full", "camera{}_cropped", "camera{}_cropped_and_downsampled"),
            "3 files of camera180",
            ("camera*_full.yml", "camera*_cropped.yml", "camera*_cropped_and_downsampled.yml"),
        ),
        (("camera{}", "camera{}_full"), "2 files", ("camera*[0-9].yml", "camera*_full.yml")),
        (("r1_camera{}", "r2_camera{}"), "2 files", ("r1_camera*.yml", "r2_camera*.yml")),
    ],
    ids=["three sizes", "a variant without a suffix", "two robots"],
)
def test_variants_of_a_camera_are_named_with_patterns_that_select_them(names, message, patterns, tmp_path):
    for name in names:
        for azimuth in (60, 180, 300):
            file = tmp_path / f"{name.format(azimuth)}.yml"
            file.write_text(calibration_text(Calibrated(make_camera(azimuth))))
            (tmp_path / f"._{file.name}").touch()  # of a file system for Macs
    with pytest.raises(CalibrationError, match=f"{message}.*select with") as caught:
        CameraRig.load(tmp_path)
    for pattern in patterns:
        assert pattern in str(caught.value)
        for given in (pattern, f"*{pattern}"):
            assert CameraRig.load(tmp_path, pattern=given).names == CAMERAS


@pytest.mark.parametrize(
    ("files", "options", "message"),
    [
        ({}, {}, r"found no files, expected a file like camera60\.yml"),
        ({"info.json": "{}"}, {}, r"found info\.json"),
        ({"info.json": "{}"}, {"pattern": "*_cropped.yml"}, r"a file that matches '\*_cropped.yml'"),
        ({"camera180.yml": "a: ["}, {}, r"camera180\.yml: not plain YAML"),
        (None, {}, "none: cannot be read: No such file"),
    ],
)
def test_a_folder_that_holds_no_rig_is_named_with_what_it_holds(files, options, message, tmp_path):
    for name, text in (files or {}).items():
        (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message):
        CameraRig.load(tmp_path / "none" if files is None else tmp_path, **options)


def test_a_folder_that_may_not_be_read_is_named(tmp_path, monkeypatch):
    refused = PermissionError(errno.EACCES, "Permission denied", str(tmp_path))
    monkeypatch.setattr(Path, "iterdir", Mock(side_effect=refused))
    with pytest.raises(CalibrationError, match="cannot be read: Permission denied"):
        CameraRig.load(tmp_path)


def test_files_that_are_not_named_after_cameras_are_taken_if_none_is(tmp_path):
    for name in ("left", "right"):
        (tmp_path / f"{name}.yml").write_text(calibration_text(Calibrated(make_camera(60, name))))
    assert CameraRig.load(tmp_path).names == ("left", "right")
    (tmp_path / "camera60.yml").write_text(calibration_text(Calibrated(make_camera(60))))
    assert CameraRig.load(tmp_path).names == ("camera60",)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CameraRig(()), "found no camera"),
        (lambda: CameraRig.load([]), "found no camera"),
        (lambda: make_rig(60, 180, 60), "camera60 twice"),
        *[
            (lambda given=given: CameraRig(given), "expected tracker.Cameras")
            for given in ("abc", 5, None, [1, 2], (make_camera(), None), {"camera60": 1})
        ],
        *[
            (lambda given=given: CameraRig.load(given), "expected cameras' files, or their folder")
            for given in (5, None, [5], b"abc")
        ],
        (lambda: CameraRig.load("a" * 5000), "cannot be read"),
        (lambda: CameraRig.load([".", "."]), "cannot be read: Is a directory"),
        (lambda: CameraRig.load("a\0b"), "found a null byte in it, expected cameras' files"),
        (lambda: CameraRig.load(".", pattern=5), "pattern: found 5, expected a text"),
        (lambda: CameraRig.load(DEMO, pattern="*.yml"), r"pattern: found '\*.yml' beside single files"),
    ],
)
def test_what_is_no_rig_is_refused(make, message):
    with pytest.raises(CalibrationError, match=message):
        make()


def test_rigs_agree_whose_cameras_and_arenas_are_bitwise_the_same():
    rig = make_rig(0.0, 120.0, 240.0)
    assert rig.agrees_with(CameraRig(tuple(dataclasses.replace(camera) for camera in rig)))
    moved = dataclasses.replace(rig[0], distortion=rig[0].distortion + 1e-9)
    for other in (
        CameraRig(rig.cameras[:2]),
        CameraRig(rig.cameras[::-1]),
        CameraRig((moved, *rig.cameras[1:])),
        CameraRig(rig.cameras, Arena(table=0.01)),
    ):
        assert not rig.agrees_with(other)
        assert not other.agrees_with(rig)


@pytest.mark.parametrize(
    "name",
    ["../x", "a/b", ".hidden", "a.", " a", "a\0b", "a\nb", "a\x1b[31m", "</script>", "$(id)", "a" * 101, ""],
)
def test_a_name_that_could_be_more_than_a_name_is_refused_where_it_is_read_and_where_it_is_made(
    name, tmp_path
):
    message = "camera_name: found .* expected a name of up to 100 letters"
    with pytest.raises(CalibrationError, match=message):
        dataclasses.replace(make_camera(), name=name)
    file = tmp_path / "camera60.yml"
    file.write_text(calibration_text(Calibrated(make_camera())))
    file.write_text(yaml.safe_dump({**yaml.safe_load(file.read_text()), "camera_name": name}))
    with pytest.raises(CalibrationError, match=message):
        CameraRig.load(tmp_path)


def test_a_rig_that_cannot_be_saved_is_reported_and_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", "a\0b", 5):
        with pytest.raises(CalibrationError, match=r"cannot be written|expected a path"):
            make_rig(60).save(folder)
    rig = CameraRig((make_camera(60, "left"), make_camera(180, "camera_left")))
    with pytest.raises(CalibrationError, match=r"found two cameras for camera_left\.yml"):
        rig.save(tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_files_that_two_runs_write_at_once_do_not_mix(tmp_path):
    make_rig(60, 180).save(tmp_path)
    with claimed(tmp_path / "arena.toml"), pytest.raises(CalibrationError, match="another run is writing it"):
        make_rig(60, 300).save(tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["camera180.yml", "camera60.yml"]


def test_a_rig_is_saved_whole_or_not_at_all(tmp_path, monkeypatch):
    make_rig(60, 180, 300).save(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    write, left = Path.write_bytes, iter(range(2))

    def filling(path, content):
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", filling)
    other = CameraRig(tuple(make_camera(azimuth + 5, f"camera{azimuth}") for azimuth in (60, 180, 300)))
    with pytest.raises(CalibrationError, match=r"camera300\.yml: cannot be written: No space left"):
        other.save(tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_resizing_and_correcting_a_rig_changes_every_camera(tmp_path):
    rig = make_rig(60, 180).resized(540, 135)
    for camera, name in zip(rig, ("camera60", "camera180"), strict=True):
        assert (camera.name, camera.width, camera.height) == (name, 540, 135)
        np.testing.assert_array_equal(camera.matrix, make_camera(60).resized(540, 135).matrix)
    make_rig(60, 180).save(tmp_path)
    for camera in CameraRig.load(tmp_path, correct_halved_principal_point=True):
        np.testing.assert_allclose(camera.matrix[:2, 2], make_camera().matrix[:2, 2] - 0.25)


@pytest.mark.parametrize("robot", [1, 3, 4, 5, 6, 7, 8])
def test_cameras_of_every_robot_look_at_the_arena_from_half_a_metre(robot, real):
    rig = CameraRig.load(real / "calibration" / "robots", pattern=f"r{robot}_*.yml")
    assert rig.names == CAMERAS
    for camera in rig:
        assert 0.4 < np.linalg.norm(camera.position) < 0.6
        assert camera.position[2] > 0.3
        (pixel,) = camera.project([[0.0, 0.0, 0.0]])
        assert (np.abs(pixel - camera.width / 2) < 30).all()


def test_cropping_the_full_camera_gives_the_cropped_one(real):
    folder = real / "calibration" / "simulation"
    full = CameraRig.load(folder, pattern="*_full.yml")
    cropped = CameraRig.load(folder, pattern="*_cropped.yml")
    for first, second in zip(full, cropped, strict=True):
        np.testing.assert_allclose(first.cropped(88, 0, 540, 540).matrix, second.matrix, atol=1e-9)
