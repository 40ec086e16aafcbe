import numpy as np
import pytest

import tracker
from tests.helpers.command import assert_one_line_error, well
from tests.helpers.filmed import shots, write_recording
from tracker.segmentation.color_model import ColorModel

QUICK = ("--rounds", "2")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("film") / "recording", shots("cube_v2", 6, seed=513))


def test_adapted_colors_are_written_and_summarised(recording, tmp_path, run_here):
    target = tmp_path / "mine.npz"
    arguments = ("--object", "cube_v2", "--colors", "simulation", "-o", target, *QUICK)
    result = well(run_here("colors", "adapt", recording, *arguments))
    assert "round 1: " in result.stdout
    assert "3 frames that only check" in result.stdout
    assert tracker.load_colors(target).normalise
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
    assert_one_line_error(result, "refused", "found 0 of 2 frames", code=1)
    assert target.read_bytes() == b"old"


FACES = "+x=red,-x=magenta,+y=green,-y=yellow,+z=blue,-z=cyan"
CUBE = ("--object", "cube_v2")
SIZE = ("--size", ".1,.1,.1", "--faces")


@pytest.mark.parametrize(
    ("command", "arguments", "words"),
    [
        ("adapt", [*CUBE, "-o", "x.dat"], [".dat", ".npz"]),
        ("adapt", [*CUBE, "-o", "nowhere/x.npz"], ["no folder nowhere"]),
        ("adapt", ["--object", "cube_v9"], ["cube_v9", "cube_v2"]),
        ("adapt", [*CUBE, "--colors", "pink"], ["pink", "simulation"]),
        ("adapt", [*CUBE, "--colors", "mine.npz", "-o", "mine.npz"], ["mine.npz", "input"]),
        ("adapt", [*CUBE, "--frames", "2"], ["--frames", "2"]),
        ("adapt", [*CUBE, "--rounds", "0"], ["--rounds", "0"]),
        ("adapt", [*CUBE, "--calibration", "nowhere"], ["nowhere"]),
        ("adapt", [*CUBE, "nothing"], ["no such file"]),
        ("new", [], ["--size", "--faces"]),
        ("new", ["--size", "1,2,3"], ["--faces"]),
        ("new", ["--size", "a,b,c", "--faces", FACES], ["--size", "3 numbers, X,Y,Z"]),
        ("new", ["--size", "0.1,0.1", "--faces", FACES], ["--size", "3 numbers"]),
        ("new", ["--size", "0.1,0.1,nan", "--faces", FACES], ["--size", "nan"]),
        ("new", ["--size", "65,65,65", "--faces", FACES], ["65", "0.5"]),
        ("new", [*SIZE, FACES.replace("cyan", "pink")], ["pink", "cyan"]),
        ("new", [*SIZE, FACES.replace("cyan", "red")], ["red", "twice"]),
        ("new", [*SIZE, "+x=red"], ["+x", "-z"]),
        ("new", [*SIZE, f"{FACES},+x=red"], ["+x", "twice"]),
        ("new", [*SIZE[:2], *CUBE], ["--object", "--size"]),
        ("new", [*SIZE, FACES, "-o", "mine.npz"], ["mine.toml", "--object"]),
    ],
)
def test_a_fault_is_named_and_nothing_overwritten(command, arguments, words, recording, tmp_path, run_here):
    tracker.load_colors("cube_v2").save(tmp_path / "mine.npz")
    (tmp_path / "mine.toml").write_text("old")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    target = () if "-o" in arguments else ("-o", "x.npz")
    given = () if "nothing" in arguments else (recording,)
    result = run_here("colors", command, *given, *arguments, *target, folder=tmp_path)
    assert_one_line_error(result, *words)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_new_object_needs_size_and_names_alone(recording, tmp_path, run_here):
    target = tmp_path / "mine.npz"
    arguments = ("--size", "0.065,0.065,0.065", "--faces", FACES, "-o", target, *QUICK)
    well(run_here("colors", "new", recording, *arguments))
    model, cube = tracker.load_object(tmp_path / "mine.toml"), tracker.load_object("cube_v2")
    assert model.name == "mine"
    assert (model.face_labels == cube.face_labels).all()
    assert (model.size == cube.size).all()
    assert tracker.load_colors(model.colors).normalise
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.npz", "mine.toml"]
