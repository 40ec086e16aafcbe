from __future__ import annotations

import numpy as np
import pytest
import yaml

from tests.helpers import make_camera
from tracker.calibration.files.platform import read_camera
from tracker.errors import CalibrationError


def malformed(key: str, value: object, part: str | None = None) -> str:
    """A valid file but for one value; `...` as the value takes the key away."""
    camera = make_camera()
    data = {
        "camera_name": camera.name,
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix.ravel().tolist()},
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": camera.distortion.tolist()},
        "tf_world_to_camera": {"rows": 4, "cols": 4, "data": camera.camera_from_world.ravel().tolist()},
        "tf_world_to_camera_std": {"rows": 4, "cols": 4, "data": [0.001] * 16},
    }
    holder = data if part is None else data[key]
    if value is ...:
        del holder[part or key]
    else:
        holder[part or key] = value
    return yaml.safe_dump(data)


@pytest.mark.parametrize(
    ("key", "value", "part", "message"),
    [
        *[(key, ..., None, f"{key} is missing") for key in ("camera_name", "image_width", "camera_matrix")],
        ("distortion_coefficients", ..., None, "is missing"),
        ("tf_world_to_camera", ..., None, "tf_world_to_camera is missing; found camera_matrix"),
        ("camera_name", 60, None, "found 60, expected a text"),
        ("camera_name", "", None, "found '', expected a text of up to 100 letters"),
        ("image_width", -270, None, "found -270, expected a whole number from 1"),
        ("image_width", True, None, "found True"),
        ("image_width", 270.5, None, "found 270.5"),
        ("image_height", "270 px", None, "found '270 px'"),
        pytest.param("image_height", 10**4000, None, "found a whole number above", id="huge height"),
        ("image_height", None, None, "found None"),
        ("camera_matrix", [1, 2], None, "found a list of 2, expected a mapping"),
        ("camera_matrix", ..., "data", "data is missing"),
        ("camera_matrix", ..., "rows", "rows is missing"),
        ("camera_matrix", 4, "rows", "found 4×3, expected 3×3"),
        ("camera_matrix", [3], "rows", "found a list of 1×3"),
        ("camera_matrix", [1.0] * 8, "data", "found 8 values, expected 9 numbers"),
        ("camera_matrix", [], "data", "found 0 values"),
        ("camera_matrix", "1 2 3", "data", "found '1 2 3'"),
        ("camera_matrix", [1.0, "x", *[1.0] * 7], "data", "found 'x', expected a finite number"),
        ("camera_matrix", [1.0, True, *[1.0] * 7], "data", "found True"),
        ("camera_matrix", [1.0, [1.0], *[1.0] * 7], "data", "found a list of 1"),
        ("camera_matrix", [float("nan")] * 9, "data", "found nan"),
        pytest.param("camera_matrix", [10**400] * 9, "data", "above 10", id="huge focal length"),
        ("camera_matrix", [1.0, 0, 1, 0, 1, 1, 0, 0, 2], "data", "last row"),
        ("distortion_coefficients", [float("inf")] * 5, "data", "found inf"),
        ("tf_world_to_camera", [0.0] * 16, "data", "deviates from a rotation by inf"),
        ("tf_world_to_camera", np.diag([1.0, 1, -1, 1]).ravel().tolist(), "data", "by inf"),
        ("tf_world_to_camera", np.diag([1.0, 1, 1, 2]).ravel().tolist(), "data", "last row"),
        ("tf_world_to_camera_std", [-0.1] * 16, "data", "found -0.1"),
    ],
)
def test_a_fault_is_named_with_file_and_key(key, value, part, message, tmp_path):
    file = tmp_path / "bad.yml"
    file.write_text(malformed(key, value, part))
    with pytest.raises(CalibrationError, match=message) as caught:
        read_camera(file)
    assert str(file) in str(caught.value)
    assert key in str(caught.value)
    assert len(str(caught.value)) < 500


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
        (b"[" * 5_000, "nested too deeply"),
        (b"a: 1\n" * 50_000, "more than 100000 bytes"),
    ],
)
def test_what_is_no_calibration_is_refused(content, message, tmp_path):
    file = tmp_path / "bad.yml"
    file.write_bytes(content)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_camera(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    "payload",
    [
        "!!python/object/apply:os.mkdir [{target}]",
        "camera_name: !!python/object/apply:os.mkdir [{target}]",
        "%YAML:1.0\n---\ncamera_name: !!python/object/new:os.mkdir [{target}]",
        "camera_matrix: !!python/name:os.system",
    ],
)
def test_code_in_a_file_is_refused_and_not_run(payload, tmp_path):
    target = tmp_path / "made"
    file = tmp_path / "bad.yml"
    file.write_text(payload.format(target=target))
    with pytest.raises(CalibrationError, match="could not determine a constructor"):
        read_camera(file)
    assert not target.exists()


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(CalibrationError, match=r"none\.yml: cannot be read: No such file"):
        read_camera(tmp_path / "none.yml")
    with pytest.raises(CalibrationError, match=r"cannot be read: Is a directory"):
        read_camera(tmp_path)
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_camera("a\0b")
