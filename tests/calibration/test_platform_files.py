import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from tests.helpers import LENSES, make_camera
from tracker.calibration.files import (
    MAX_FILE_SIZE,
    Calibrated,
    calibration_text,
    focal_deviations,
    halved_by_rows,
    read_all_calibrated,
    read_calibrated,
)
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera

ARRAYS = ("matrix", "distortion", "camera_from_world", "camera_from_world_std")


def read_camera(path: str | Path) -> Camera:
    return read_calibrated(path, alone=False).camera


def written(tmp_path: Path, camera: Camera | None = None) -> tuple[Path, str]:
    file = tmp_path / "camera60.yml"
    file.write_text(calibration_text(Calibrated(camera or make_camera())))
    return file, file.read_text()


def assert_same_bits(first: Camera, second: Camera) -> None:
    assert (first.name, first.width, first.height) == (second.name, second.width, second.height)
    for key in ARRAYS:
        a, b = getattr(first, key), getattr(second, key)
        assert (a is None and b is None) or a.tobytes() == b.tobytes(), key


@pytest.mark.parametrize("coefficients", LENSES.values(), ids=map(str, LENSES))
def test_writing_and_reading_keeps_every_bit(coefficients, tmp_path):
    for azimuth in range(10, 360, 90):
        camera = dataclasses.replace(make_camera(azimuth), distortion=np.array(coefficients))
        file, _ = written(tmp_path, camera)
        assert_same_bits(read_camera(file), camera)
    silent = dataclasses.replace(camera, camera_from_world_std=None)
    file, text = written(tmp_path, silent)
    assert "_std" not in text
    assert_same_bits(read_camera(file), silent)


@pytest.mark.parametrize("name", ["camera60", "6", "2L", "22881234-1", "1.5e3", "12e4", "-a", "--", "0 b"])
def test_the_current_variant_is_written_which_opencv_reads(tmp_path, name):
    camera = dataclasses.replace(make_camera(), name=name)
    file, text = written(tmp_path, camera)
    assert text.startswith("%YAML 1.1\n---\n")
    data = yaml.safe_load(text)
    assert data["tf_world_to_camera"].keys() == {"rows", "cols", "dt", "data"}
    assert data["camera_matrix"]["dt"] == "d"
    assert data["distortion_coefficients"]["rows"] == 1
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    assert storage.getNode("camera_name").string() == name == read_camera(file).name
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), camera.matrix)
    np.testing.assert_array_equal(storage.getNode("tf_world_to_camera").mat(), camera.camera_from_world)
    storage.release()


ROS = """image_width: 270
image_height: 270
camera_name: camera60
camera_matrix: {rows: 3, cols: 3, data: [294.4, 0, 135.9, 0, 296.4, 141.5, 0, 0, 1]}
distortion_model: rational_polynomial
distortion_coefficients: {rows: 1, cols: 8, data: [0.31, -0.12, -0.00136, 0.0007, 0.021, 0.55, -0.06, 0.011]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [294.4, 0, 135.9, 0, 0, 296.4, 141.5, 0, 0, 0, 1, 0]}
"""


def test_the_camera_info_of_ros_is_a_lens_that_has_to_be_placed(tmp_path):
    file = tmp_path / "camera60.yaml"
    file.write_text(ROS)
    message = r"a lens alone; `tracker calibrate extrinsics`.*add that key: .* rvec"
    with pytest.raises(CalibrationError, match=message):
        read_camera(file)
    lens = read_calibrated(file)
    assert not lens.placed
    np.testing.assert_array_equal(lens.camera.distortion, LENSES[8])
    transform = make_camera().camera_from_world
    placed = f"{ROS}tf_world_to_camera: {{rows: 4, cols: 4, data: {transform.ravel().tolist()}}}\n"
    expected = dataclasses.replace(make_camera(), distortion=np.array(LENSES[8]), camera_from_world_std=None)
    file.write_text(placed)
    assert_same_bits(read_camera(file), expected)
    file.write_text(placed.replace("rational_polynomial", "equidistant"))
    with pytest.raises(CalibrationError, match=r"distortion_model: found 'equidistant', expected plumb_bob"):
        read_camera(file)


@pytest.mark.parametrize("number", ["294.4", "2.944e2", "2.944E+2", ".2944e3", "2944e-1", "29440e-02"])
def test_numbers_are_read_as_any_writer_prints_them(number, tmp_path):
    (tmp_path / "camera60.yml").write_text(ROS.replace("[294.4, 0, 135.9,", f"[{number}, 0, 135.9,"))
    assert read_calibrated(tmp_path / "camera60.yml").camera.matrix[0, 0] == 294.4


@pytest.mark.parametrize("suffix", ["yml", "yaml"])
@pytest.mark.parametrize("coefficients", LENSES.values(), ids=map(str, LENSES))
def test_what_opencv_writes_is_read(suffix, coefficients, tmp_path):
    camera = dataclasses.replace(make_camera(), distortion=np.array(coefficients))
    file = tmp_path / f"camera60.{suffix}"
    values = {
        "camera_name": camera.name, "image_width": camera.width, "image_height": camera.height,
        "camera_matrix": camera.matrix, "distortion_coefficients": camera.distortion[None],
        "tf_world_to_camera": camera.camera_from_world,
        "tf_world_to_camera_std": camera.camera_from_world_std,
    }  # fmt: skip
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        storage.write(key, np.array(value) if isinstance(value, np.ndarray) else value)
    storage.release()
    assert "!!opencv-matrix" in file.read_text()
    assert_same_bits(read_camera(file), camera)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("%YAML 1.1\n---\n", ""),
        ("%YAML 1.1\n---\n", "---\n"),
        ("%YAML 1.1\n---\n", "%YAML:1.0\n---\n"),
        ("%YAML 1.1\n---\n", "\ufeff%YAML 1.1\n---\n"),
        ("%YAML 1.1\n---\n", "# a comment\n"),
        ("  dt: d\n", ""),
        ("tf_world_to_camera:", "projection_matrix:"),
        ("tf_world_to_camera", "projection_matrix"),
        ("rows: 1\n  cols: 5", "rows: 5\n  cols: 1"),
        ("-5.2e-05", "-52e-6"),
        ("camera_name:", "note: [1, {a: b}]\ncamera_name:"),
        ("\n", "\r\n"),
    ],
)
def test_every_variant_is_read(old, new, tmp_path):
    file, text = written(tmp_path)
    assert old in text
    file.write_bytes(text.replace(old, new).encode())
    assert_same_bits(read_camera(file), make_camera())


def changed(tmp_path: Path, key: str, value: object, part: str | None = None) -> Path:
    """A valid file but for one value; `...` as the value takes the key away."""
    file, text = written(tmp_path)
    data = yaml.safe_load(text)
    holder = data if part is None else data[key]
    if value is ...:
        del holder[part or key]
    else:
        holder[part or key] = value
    file.write_text(yaml.safe_dump(data))
    return file


def test_four_distortion_coefficients_have_no_fifth_and_a_mean_of_rotations_is_mended(tmp_path):
    four = {"rows": 1, "cols": 4, "data": [-0.2, 0.1, 0.01, 0.02]}
    camera = read_camera(changed(tmp_path, "distortion_coefficients", four))
    np.testing.assert_array_equal(camera.distortion, [-0.2, 0.1, 0.01, 0.02, 0])
    shrunk = make_camera().camera_from_world.copy()
    shrunk[:3, :3] *= 1 - 5e-5
    camera = read_camera(changed(tmp_path, "tf_world_to_camera", shrunk.ravel().tolist(), "data"))
    np.testing.assert_allclose(camera.camera_from_world, make_camera().camera_from_world, atol=1e-12)


def test_every_real_file_survives_a_round_trip(real, tmp_path):
    files = sorted([*real.glob("calibration/*/*.yml"), *real.glob("pose/*/*.yml")])
    assert len(files) > 30
    assert 10 * max(file.stat().st_size for file in files) < MAX_FILE_SIZE
    for file in files:
        camera = read_camera(file)
        raw = np.reshape(yaml.safe_load(file.read_text())["tf_world_to_camera"]["data"], (4, 4))
        np.testing.assert_allclose(camera.camera_from_world, raw, atol=1e-4)
        assert_same_bits(read_camera(written(tmp_path, camera)[0]), camera)


MATRIX_STD = np.array([[0.5, 0, 1.2], [0, 0.6, 1.1], [0, 0, 0]])
DISTORTION_STD = np.array([0.01, 0.05, 4e-4, 3e-4, 0.1])


@pytest.fixture
def calibrated():
    return Calibrated(make_camera(), MATRIX_STD, DISTORTION_STD)


def test_deviations_are_read_as_written_and_a_lens_alone_is_no_camera_yet(calibrated, tmp_path):
    file = tmp_path / "camera60.yml"
    file.write_text(calibration_text(calibrated))
    read = read_calibrated(file)
    assert_same_bits(read.camera, calibrated.camera)
    assert np.array_equal(read.matrix_std, MATRIX_STD)
    assert np.array_equal(read.distortion_std, DISTORTION_STD)
    assert read.placed
    camera = dataclasses.replace(calibrated.camera, camera_from_world=np.eye(4), camera_from_world_std=None)
    file.write_text(calibration_text(dataclasses.replace(calibrated, camera=camera, placed=False)))
    read = read_calibrated(file)
    assert not read.placed
    assert not read_all_calibrated([tmp_path], "*.yml")[0].placed
    assert np.array_equal(read.camera.matrix, camera.matrix)
    file.write_text("height: 480\nK: [600, 0, 320, 0, 600, 240, 0, 0, 1]\n")  # a message of ROS
    with pytest.raises(CalibrationError, match=r"key \w+ is missing; found K, height$"):
        read_calibrated(file)


def test_a_calibration_is_resized_and_cropped_as_its_camera_is_and_deviations_with_it(calibrated):
    half, part = calibrated.resized(135, 135), calibrated.cropped(30, 20, 200, 150)
    assert_same_bits(half.camera, calibrated.camera.resized(135, 135))
    assert half.matrix_std == pytest.approx(MATRIX_STD / 2)
    assert_same_bits(part.camera, calibrated.camera.cropped(30, 20, 200, 150))
    with pytest.raises(CalibrationError, match=r"200x150\+100\+20.* inside of 270x270"):
        calibrated.cropped(100, 20, 200, 150)


def test_a_principal_point_halved_with_its_rows_is_distinguished_from_one_that_was_halved_right(tmp_path):
    whole = make_camera().resized(540, 540)
    matrix = whole.matrix.copy()
    matrix[:2] /= 2
    wrong = dataclasses.replace(whole, width=270, height=270, matrix=matrix)
    right = whole.resized(270, 270)
    files = {"camera60.yml": whole, "camera60_wrong.yml": wrong, "camera60_right.yml": right}
    for name, camera in files.items():
        (tmp_path / name).write_text(calibration_text(Calibrated(camera)))
    assert [halved_by_rows(tmp_path / name) for name in files] == [False, True, False]
    (tmp_path / "alone").mkdir()
    for name, std in (("a_downsampled.yml", None), ("b_downsampled.yml", np.eye(3)), ("c.yml", None)):
        (tmp_path / "alone" / name).write_text(calibration_text(Calibrated(wrong, std)))
        assert halved_by_rows(tmp_path / "alone" / name) == name.startswith("a_")


def test_the_platforms_own_halved_files_are_reported(real):
    files = sorted((real / "calibration" / "simulation").glob("*.yml"))
    assert [halved_by_rows(path) for path in files] == ["downsampled" in path.name for path in files]


def test_the_deviation_of_a_focal_length_is_that_of_the_file():
    std = np.diag([2.0, 3.0, 0.0])
    matrix = make_camera().matrix
    found = focal_deviations([Calibrated(make_camera(), std), Calibrated(make_camera(180))])
    assert found == {"camera60": pytest.approx(max(2.0 / matrix[0, 0], 3.0 / matrix[1, 1]))}


@pytest.mark.parametrize(
    ("key", "value", "part", "message"),
    [
        *[(key, ..., None, f"{key} is missing") for key in ("camera_name", "image_width", "camera_matrix")],
        ("distortion_coefficients", ..., None, "is missing"),
        ("tf_world_to_camera", ..., None, "tf_world_to_camera is missing; found camera_matrix"),
        ("camera_name", 60, None, "found 60, expected a name"),
        ("image_width", -270, None, "found -270, expected a whole number of pixels from 1"),
        ("image_height", "270 px", None, "found '270 px'"),
        ("camera_matrix", [1, 2], None, "found a list of 2, expected a mapping"),
        ("camera_matrix", ..., "data", "data is missing"),
        ("camera_matrix", ..., "rows", "rows is missing"),
        ("camera_matrix", 4, "rows", "found 4×3, expected 3×3"),
        ("camera_matrix", [3], "rows", "found a list of 1×3"),
        ("camera_matrix", [1.0] * 8, "data", "found 8 values, expected 9 numbers"),
        ("camera_matrix", "1 2 3", "data", "found '1 2 3'"),
        ("camera_matrix", [1.0, "x", *[1.0] * 7], "data", "found 'x', expected a finite number"),
        ("camera_matrix", [float("nan")] * 9, "data", "found nan"),
        ("distortion_coefficients", [float("inf")] * 5, "data", "found inf"),
        ("tf_world_to_camera", [0.0] * 16, "data", "deviates from a rotation by inf"),
        ("tf_world_to_camera", np.diag([1.0, 1, 1, 2]).ravel().tolist(), "data", "last row"),
        ("tf_world_to_camera_std", [-0.1] * 16, "data", "found -0.1"),
        ("camera_matrix_std", {"rows": 3, "cols": 3, "data": [-0.1] * 9}, None, "found -0.1, expected"),
        ("distortion_coefficients_std", {"rows": 1, "cols": 5, "data": [-0.1] * 5}, None, "found -0.1, exp"),
    ],
)
def test_a_fault_is_named_with_file_and_key(key, value, part, message, tmp_path):
    file = changed(tmp_path, key, value, part)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_camera(file)
    assert str(file) in str(caught.value)
    assert key in str(caught.value)
    assert len(str(caught.value)) < 500


UNKNOWN_TAG = "could not determine a constructor"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "found None, expected a mapping"),
        (b"- 1\n- 2\n", "found a list of 2, expected a mapping"),
        (b"just a text", "found 'just a text'"),
        (b"a: [1, 2", "not plain YAML"),
        (b"\x80\x81\x00\xff" * 50, "not plain YAML"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "not plain YAML"),
        (b"a: 2001-99-99", "not plain YAML"),
        (b"a: !!bool 2", "not plain YAML"),
        (b"a: !!timestamp 2", "not plain YAML"),
        (b"{[1]: 2}", "not plain YAML"),
        (b"a: 1\na: 2", "'a' stands twice"),
        (b"a: &a {b: 1}\nc: {<<: *a}", "merge key"),
        (b"a: 1\n---\nb: 2\n", "not plain YAML"),
        (b"[" * 1_000, "nested too deeply"),
        (b"a: 1\n" * 50_000, "more than 100000 bytes"),
        (b"!!python/object/apply:os.mkdir [made]", UNKNOWN_TAG),
        (b"camera_name: !!python/object/apply:os.mkdir [made]", UNKNOWN_TAG),
        (b"%YAML:1.0\n---\nimage_width: !!python/object/new:os.mkdir [made]", UNKNOWN_TAG),
        (b"camera_matrix: !!python/name:os.system", UNKNOWN_TAG),
    ],
)
def test_what_is_no_calibration_is_refused_and_no_code_in_it_run(content, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "bad.yml"
    file.write_bytes(content)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_camera(file)
    assert str(file) in str(caught.value)
    assert list(tmp_path.iterdir()) == [file]
