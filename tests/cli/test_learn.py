import numpy as np
import pytest

import tracker
from tests.helpers.command import assert_refused, well
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
    given = ("colors", "adapt", recording, *arguments)
    assert_refused(run_here, tmp_path, given, "wrong: refused", "green has the hue of magenta")


def test_colors_that_cannot_be_bettered_keep_the_old_file(tmp_path, run_here):
    film = shots("cube_v2", 4, seed=514)
    for shot in film:
        shot.images[:] = [np.full_like(image, 100) for image in shot.images]
    (tmp_path / "mine.npz").write_bytes(b"old")
    write_recording(tmp_path / "empty", film)
    arguments = ("empty", "--object", "cube_v2", "--colors", "cube_v2", "-o", "mine.npz", "-q")
    given = ("colors", "adapt", *arguments)
    assert_refused(run_here, tmp_path, given, "refused", "found 0 of 2 frames", code=1)


FACES = "+x=red,-x=magenta,+y=green,-y=yellow,+z=blue,-z=cyan"


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
