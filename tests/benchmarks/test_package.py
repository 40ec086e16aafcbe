import dataclasses
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.data.package import environment as package
from benchmarks.data.package.environment import PACKAGE, VARIABLE, VERSION, PackageError, interpreter, run
from benchmarks.data.package.scenes import LENS_MARGIN, Drawing, as_drawn, bend_map, bent, face_map
from benchmarks.data.plan import Plan
from benchmarks.data.sets import PACKAGES, scene_set
from benchmarks.data.workloads import BY_NAME
from tests.helpers import make_camera, opencv_pixels
from tracker.errors import CalibrationError
from tracker.geometry.cuboid import corners
from tracker.objects.model import load_object


@pytest.fixture(autouse=True)
def _no_interpreter_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands that were asked for; of these, only those that make environments were run."""
    asked: list[list[str]] = []

    def run_some(command: list[str]) -> str:
        asked.append(command)
        return run([*command, "--without-pip"]) if "venv" in command else ""

    monkeypatch.setattr(package, "run", run_some)
    return asked


def test_an_interpreter_that_is_chosen_has_to_be_there(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, sys.executable)
    assert interpreter(tmp_path) == Path(sys.executable)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    for use in (interpreter, lambda folder: scene_set("cube_v2", "package", Plan(3, 5, 1, folder))):
        with pytest.raises(PackageError, match="nowhere: no such file"):
            use(tmp_path)


def test_an_environment_is_made_if_requested_once_and_again_where_its_python_has_gone(tmp_path, commands):
    with pytest.raises(PackageError, match="not installed"):
        interpreter(tmp_path, install=False)
    assert not list(tmp_path.iterdir())
    python = interpreter(tmp_path)
    assert python.is_file()
    assert python.is_relative_to(tmp_path)
    assert any(f"{PACKAGE}=={VERSION}" in command for command in commands)
    commands.clear()
    assert interpreter(tmp_path, install=False) == python
    assert commands == []
    python.unlink()
    with pytest.raises(PackageError, match="not installed"):
        interpreter(tmp_path, install=False)
    assert interpreter(tmp_path).is_file()


def test_what_an_interruption_left_unfinished_is_made_again(tmp_path, commands, monkeypatch):
    def interrupted(command: list[str]) -> str:
        if "install" in command:
            raise KeyboardInterrupt
        return run([*command, "--without-pip"])

    with monkeypatch.context() as patch:
        patch.setattr(package, "run", interrupted)
        with pytest.raises(KeyboardInterrupt):
            interpreter(tmp_path)
    root = tmp_path / f"{PACKAGE}-{VERSION}"
    (root / "half a package").mkdir()
    with pytest.raises(PackageError, match="not installed"):
        interpreter(tmp_path, install=False)
    assert interpreter(tmp_path).is_file()
    assert not (root / "half a package").exists()


def test_a_command_that_fails_says_why_in_one_line():
    assert run([sys.executable, "-c", "print('printed')"]) == "printed\n"
    with pytest.raises(PackageError, match=f"^{PACKAGE}: the reason$"):
        run([sys.executable, "-c", "import sys; sys.exit('more\\nthe reason')"])
    with pytest.raises(PackageError, match="No such file"):
        run(["/nowhere/python"])


def test_a_bent_picture_shows_points_where_opencv_projects_them(rng):
    camera = make_camera()
    straight = dataclasses.replace(camera, distortion=np.zeros(5))
    points = np.column_stack([rng.uniform(-0.15, 0.15, (40, 2)), rng.uniform(0, 0.1, 40)])
    rows, columns = np.indices((camera.height + 2 * LENS_MARGIN, camera.width + 2 * LENS_MARGIN))
    places = bend_map(camera, LENS_MARGIN)
    before, after = opencv_pixels(straight, points) + LENS_MARGIN, opencv_pixels(camera, points)
    for (x, y), (u, v) in zip(before, after, strict=True):
        spot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 3.0**2)).astype(np.float32)
        picture = bent(spot, places)
        near = picture * (np.hypot(*np.subtract(np.indices(picture.shape), [[[v]], [[u]]])) < 12)
        centre = [float((near * grid).sum() / near.sum()) for grid in np.indices(picture.shape)[::-1]]
        # A spot is bent as a whole, not at its centre alone.
        np.testing.assert_allclose(centre, (u, v), atol=0.15)


def test_without_distortion_a_lens_bends_nothing_and_a_margin_that_is_too_narrow_is_named(rng):
    camera = dataclasses.replace(make_camera(), distortion=np.zeros(5))
    size = camera.width + 2 * LENS_MARGIN
    picture = rng.integers(0, 256, (size, size, 3), dtype=np.uint8)
    inner = picture[LENS_MARGIN:-LENS_MARGIN, LENS_MARGIN:-LENS_MARGIN]
    np.testing.assert_array_equal(bent(picture, bend_map(camera, LENS_MARGIN)), inner)
    with pytest.raises(CalibrationError, match=r"camera60: its lens shows .* px more .* margin of 5 px"):
        bend_map(make_camera(), 5)


def test_faces_seen_through_a_lens_fill_the_outline_that_opencv_projects():
    model, camera = load_object("cuboid_2x2x8_v2"), make_camera()
    position = np.array([0.08, -0.05, 0.05])
    labels = face_map(camera, model, position, np.eye(3))
    assert int(model.face_labels[4]) in labels  # the face on top
    ends = corners(model.size)
    edges = [(a, b) for a in ends for b in ends if np.count_nonzero(a != b) == 1]
    points = np.concatenate([a + np.linspace(0, 1, 30)[:, None] * (b - a) for a, b in edges]) + position
    outline = cv2.convexHull(opencv_pixels(camera, points).astype(np.float32))
    area = cv2.contourArea(outline)
    assert np.count_nonzero(labels) == pytest.approx(area, rel=0.03)
    moments = cv2.moments(outline)
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    np.testing.assert_allclose(np.argwhere(labels)[:, ::-1].mean(axis=0), centre, atol=0.1)


def test_with_its_lens_a_camera_keeps_what_its_file_says():
    camera = make_camera()
    bare, whole = (as_drawn(camera, drawing) for drawing in (Drawing(), Drawing(lens=True)))
    assert not bare.distortion.any()
    assert bare.camera_from_world_std is None
    np.testing.assert_array_equal(whole.distortion, camera.distortion)
    np.testing.assert_array_equal(whole.camera_from_world_std, camera.camera_from_world_std)
    np.testing.assert_array_equal(whole.matrix, bare.matrix)
    assert as_drawn(camera, Drawing(scale=4)).matrix[1, 2] == pytest.approx(camera.matrix[1, 2] - 0.25)
    # Both workloads through the lens share their scenes.
    first, second = (BY_NAME[f"simulation package, lens{more}"].base for more in ("", ", blurred"))
    assert first == second
    assert PACKAGES[first].lens
