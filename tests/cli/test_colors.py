import os
import shutil
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

import tracker
from tests.cli.test_refused import FACES
from tests.helpers import exposed
from tests.helpers.command import assert_one_line_error, assert_refused, well
from tests.helpers.log_writers import write_picture
from tracker.cli.demo import DATA
from tracker.color_learning.fit import FitOptions
from tracker.segmentation.color_model import ColorModel

QUICK = ("--rounds", "2")


@pytest.fixture
def run_here(run_here):
    return partial(run_here, "colors")


@pytest.fixture(autouse=True)
def _few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tracker.cli.colors.FitOptions", partial(FitOptions, draws=5000))


@pytest.mark.parametrize(
    ("given", "held_out"),
    [([DATA], 10), ([*sorted(DATA.glob("0*"))[::3][:6], "--calibration", DATA], 3)],
    ids=["a recording", "recordings of one frame each, in turn"],
)
def test_colors_adapted_to_half_of_the_frames_are_written_and_summarised(given, held_out, tmp_path, run_here):
    target = tmp_path / "mine.npz"
    arguments = ("--object", "cube_v2", "--colors", "simulation", "-o", target, *QUICK)
    result = well(run_here("adapt", *given, *arguments))
    assert "round 1: " in result.stdout
    assert f" {held_out} held-out frames" in result.stdout
    assert tracker.load_colors(target).normalise
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.npz"]


def test_exchanged_faces_are_refused_and_nothing_is_written(tmp_path, run_here):
    log_posterior = tracker.load_colors("cube_v2").log_posterior.copy()
    log_posterior[[2, 5]] = log_posterior[[5, 2]]
    ColorModel("wrong", log_posterior).save(tmp_path / "wrong.npz")
    given = ("adapt", DATA, "--object", "cube_v2", "--colors", "wrong.npz", "-o", "mine.npz")
    parts = ("wrong: refused", "green has the hue of magenta", "use `tracker colors fit`")
    assert_refused(run_here, tmp_path, given, *parts)


def test_colors_that_cannot_be_bettered_keep_the_old_file(tmp_path, run_here):
    for number in range(4):
        for name in ("camera60", "camera180", "camera300"):
            path = tmp_path / "empty" / f"{number}" / f"{name}.png"
            write_picture(path, np.full((270, 270, 3), 100, np.uint8))
    tracker.CameraRig.load(DATA).save(tmp_path / "empty")
    (tmp_path / "mine.npz").write_bytes(b"old")
    given = ("adapt", "empty", "--object", "cube_v2", "--colors", "cube_v2", "-o", "mine.npz", "-q")
    assert_refused(run_here, tmp_path, given, "refused", "found 0 of 2 frames", code=1)


def test_a_new_object_needs_size_and_names_alone(tmp_path, run_here):
    target = tmp_path / "mine.npz"
    arguments = ("--size", "0.065,0.065,0.065", "--faces", FACES, "-o", target, *QUICK)
    first, *_ = well(run_here("new", DATA, *arguments)).stdout.splitlines()
    assert not first.startswith("names")  # colours of the package explain more
    model, cube = tracker.load_object(tmp_path / "mine.toml"), tracker.load_object("cube_v2")
    assert model.name == "mine"
    assert (model.face_labels == cube.face_labels).all()
    assert (model.size == cube.size).all()
    assert tracker.load_colors(model.colors).normalise
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.npz", "mine.toml"]


def test_a_name_that_no_file_of_an_object_can_hold_is_refused_before_learning(tmp_path, run_here):
    size, target = ("--size", "0.065,0.065,0.065"), os.fsdecode(b"w\xfcrfel.npz")
    given = ("new", DATA, *size, "--faces", FACES, "-o", target)
    assert_refused(run_here, tmp_path, given, "cannot be written")


@pytest.fixture
def labelled(tmp_path: Path) -> Path:
    """A folder of three labelled images of red and blue squares on grey."""
    folder = tmp_path / "labelled"
    for number in range(3):
        rng = np.random.default_rng(number)
        image = rng.normal(110, 4, (120, 120, 3))
        for color, bgr, left in (("red", (40, 50, 190), 10), ("blue", (150, 60, 20), 60)):
            top = 20 + 10 * number
            image[top : top + 40, left : left + 40] = rng.normal(bgr, 4, (40, 40, 3))
            mask = np.zeros((120, 120), np.uint8)
            mask[top : top + 40, left : left + 40] = 255
            write_picture(folder / f"0{number}_mask_{color}.png", mask)
        write_picture(folder / f"0{number}_image.png", exposed(image))
    return folder


def test_fitted_colors_are_written_and_can_be_checked(labelled, tmp_path, run_here):
    result = well(run_here("fit", labelled, "--name", "mine", "-o", tmp_path / "mine.npz"))
    assert "no image shows green" in result.stdout
    assert "no image shows red" not in result.stdout
    checked = well(run_here("check", labelled, "--colors", tmp_path / "mine.npz"))
    overlaps, confusions, *_ = checked.stdout.split("\n\n")
    header, *_, mean = overlaps.splitlines()
    values = dict(zip(header.split()[3:], mean.split()[1:], strict=True))
    assert float(values["red"]) > 0.95
    assert float(values["blue"]) > 0.95
    assert values["green"] == "-"
    assert confusions.startswith("found as")


def test_a_fitted_model_is_called_as_it_is_when_loaded(labelled, tmp_path, run_here):
    target = tmp_path / "mine.npz"
    result = well(run_here("fit", labelled, "-o", target, "--name", "other"))
    assert f"\n{tracker.load_colors(target).name}: written to {target}" in result.stdout


def test_a_colour_that_other_objects_images_teach_is_not_said_to_be_missing(labelled, tmp_path, run_here):
    others = shutil.copytree(labelled, tmp_path / "others")
    for mask in labelled.glob("*_mask_blue.png"):
        mask.unlink()
    for given, missing in ((("--others", others), False), ((), True)):
        result = well(run_here("fit", labelled, *given, "-o", tmp_path / "mine.npz"))
        assert ("no image shows blue" in result.stdout) is missing
        assert ((tracker.load_colors(tmp_path / "mine.npz").label_table == 3).any()) is not missing
        assert "no image shows green" in result.stdout


def test_cross_validation_says_which_colors_are_weak_and_draws_them(labelled, tmp_path, run_here):
    arguments = ("check", labelled, "--cross-validate", "--plot", tmp_path / "plot.png")
    result = well(run_here(*arguments))
    assert float(result.stdout.split("\n\n")[0].split()[-1]) > 0.9  # of images that the fit did not see
    for words in ("no colour is weak", "the light: red", "a better set of colours"):
        assert words in result.stdout
    assert cv2.imread(str(tmp_path / "plot.png")).std() > 10
    for path in (*labelled.glob("01*"), *labelled.glob("02*")):
        path.unlink()
    assert_one_line_error(run_here(*arguments[:-2]), "found 1", "at least 2")


def test_colors_can_be_checked_on_images_that_show_none_of_them(labelled, tmp_path, run_here):
    for mask in labelled.glob("*_mask_*.png"):
        cv2.imwrite(str(mask), np.zeros((120, 120), np.uint8))
    plot, model = tmp_path / "plot.png", tmp_path / r"$\frac$ 物.npz"  # nor is its name a formula
    tracker.load_colors("cube_v2").save(model)
    result = well(run_here("check", labelled, "--colors", model, "--plot", plot))
    assert result.stdout.endswith(f"no colour is weak\n\nplot: {plot}\n")


def test_a_failed_fit_keeps_the_old_file(labelled, tmp_path, run_here):
    (tmp_path / "mine.npz").write_bytes(b"old")
    shutil.copy(labelled / "00_image.png", labelled / "03_image.png")
    (labelled / "03_mask_red.png").write_bytes(b"broken")
    assert_refused(run_here, tmp_path, ["fit", labelled, "-o", "mine.npz"], "03_mask_red.png")
