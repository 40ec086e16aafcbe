"""The commands that learn colours without labels."""

from __future__ import annotations

import numpy as np
import pytest

import tracker
from tests.helpers.command import assert_one_line_error
from tests.helpers.filmed import shots, write_recording
from tracker.segmentation.color_model import ColorModel

QUICK = ("--rounds", "2")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("film") / "recording", shots("cube_v2", 6, seed=513))


def test_adapted_colors_are_written_and_told_of(recording, tmp_path, run_here):
    target = tmp_path / "mine.npz"
    arguments = ("--object", "cube_v2", "--colors", "simulation", "-o", target, *QUICK)
    result = run_here("colors", "adapt", recording, *arguments)
    assert result.returncode == 0, result.stderr
    assert "round 1: " in result.stdout
    assert "3 frames that did not teach" in result.stdout
    colors = tracker.load_colors(target)
    assert colors.normalise
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.npz"]


def test_exchanged_faces_are_refused_and_nothing_is_written(recording, tmp_path, run_here):
    log_posterior = tracker.load_colors("cube_v2").log_posterior.copy()
    log_posterior[[2, 5]] = log_posterior[[5, 2]]
    ColorModel("wrong", log_posterior).save(tmp_path / "wrong.npz")
    arguments = ("--object", "cube_v2", "--colors", tmp_path / "wrong.npz", "-o", tmp_path / "mine.npz")
    result = run_here("colors", "adapt", recording, *arguments)
    assert_one_line_error(result, "wrong: refused", "green has the hue of magenta")
    assert not (tmp_path / "mine.npz").exists()


def test_colors_that_cannot_be_bettered_keep_the_old_file(tmp_path, run_here):
    film = shots("cube_v2", 4, seed=514)
    for shot in film:
        shot.images[:] = [np.full_like(image, 100) for image in shot.images]
    target = tmp_path / "mine.npz"
    target.write_bytes(b"old")
    recording = write_recording(tmp_path / "empty", film)
    arguments = ("--object", "cube_v2", "--colors", "cube_v2", "-o", target)
    result = run_here("colors", "adapt", recording, *arguments, "-q")
    assert_one_line_error(result, "refused", "found 0 of 2 frames")
    assert target.read_bytes() == b"old"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--object", "cube_v2"], ["-o"]),
        (["--object", "cube_v2", "-o", "x.dat"], [".dat", ".npz"]),
        (["--object", "cube_v2", "-o", "nowhere/x.npz"], ["no folder nowhere"]),
        (["--object", "cube_v9", "-o", "x.npz"], ["cube_v9", "cube_v2"]),
        (["--object", "cube_v2", "-o", "x.npz", "--colors", "pink"], ["pink", "simulation"]),
        (["--object", "cube_v2", "-o", "x.npz", "--frames", "2"], ["--frames", "2"]),
        (["--object", "cube_v2", "-o", "x.npz", "--rounds", "0"], ["--rounds", "0"]),
        (["--object", "cube_v2", "-o", "x.npz", "--calibration", "nowhere"], ["nowhere"]),
    ],
)
def test_a_faulty_option_is_named(arguments, words, recording, tmp_path, run_here):
    assert_one_line_error(run_here("colors", "adapt", recording, *arguments, folder=tmp_path), *words)
    assert not list(tmp_path.iterdir())


def test_a_recording_that_is_none_is_named(tmp_path, run_here):
    arguments = ("--object", "cube_v2", "-o", tmp_path / "x.npz")
    assert_one_line_error(run_here("colors", "adapt", tmp_path / "nothing", *arguments), "no such file")


def test_the_colors_to_begin_with_are_not_overwritten(recording, tmp_path, run_here):
    mine = tmp_path / "mine.npz"
    tracker.load_colors("cube_v2").save(mine)
    before = mine.read_bytes()
    arguments = ("--object", "cube_v2", "--colors", mine, "-o", mine)
    assert_one_line_error(run_here("colors", "adapt", recording, *arguments), "mine.npz", "input")
    assert mine.read_bytes() == before


FACES = "+x=red -x=magenta +y=green -y=yellow +z=blue -z=cyan"


def test_a_new_object_needs_size_and_names_alone(recording, tmp_path, run_here):
    target = tmp_path / "mine.npz"
    arguments = ("--size", "0.065 0.065 0.065", "--faces", FACES, "-o", target, *QUICK)
    result = run_here("colors", "new", recording, *arguments)
    assert result.returncode == 0, result.stderr
    model, cube = tracker.load_object(tmp_path / "mine.toml"), tracker.load_object("cube_v2")
    assert model.name == "mine"
    assert (model.face_labels == cube.face_labels).all()
    assert (model.size == cube.size).all()
    assert tracker.load_colors(model.colors).normalise
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.npz", "mine.toml"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["--size", "--faces"]),
        (["--size", "1 2 3"], ["--faces"]),
        (["--size", "a b c", "--faces", FACES], ["--size", "three numbers"]),
        (["--size", "0.1 0.1", "--faces", FACES], ["size", "3"]),
        (["--size", "65 65 65", "--faces", FACES], ["65", "0.5"]),
        (["--size", ".1 .1 .1", "--faces", FACES.replace("cyan", "pink")], ["pink", "cyan"]),
        (["--size", ".1 .1 .1", "--faces", FACES.replace("cyan", "red")], ["red", "twice"]),
        (["--size", ".1 .1 .1", "--faces", "+x=red"], ["+x", "-z"]),
        (["--size", ".1 .1 .1", "--faces", f"{FACES} +x=red"], ["+x", "twice"]),
        (["--size", ".1 .1 .1", "--object", "cube_v2"], ["--object", "--size"]),
    ],
)
def test_a_faulty_description_is_named(arguments, words, recording, tmp_path, run_here):
    result = run_here("colors", "new", recording, *arguments, "-o", "x.npz", folder=tmp_path)
    assert_one_line_error(result, *words)
    assert not list(tmp_path.iterdir())


def test_an_objects_file_is_not_overwritten(recording, tmp_path, run_here):
    (tmp_path / "mine.toml").write_text("old")
    arguments = ("--size", ".1 .1 .1", "--faces", FACES, "-o", tmp_path / "mine.npz")
    assert_one_line_error(run_here("colors", "new", recording, *arguments), "mine.toml", "--object")
    assert (tmp_path / "mine.toml").read_text() == "old"
