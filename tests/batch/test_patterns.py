import glob
import os
from pathlib import Path

import pytest

from tests.batch.test_run import OPTIONS, do
from tests.helpers.recording_stubs import write_log
from tracker.batch.results import outputs_of, recordings_of
from tracker.batch.run import Batch, only_run
from tracker.errors import LogError


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """The working folder, with two recordings."""
    for name in ("0", "1"):
        write_log(tmp_path / "ep" / name, 3)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("folder", ["out", "ep/out", "ep", ".", "ep/0/out"])
@pytest.mark.parametrize("pattern", ["ep/*", "e*/*", "**/camera_data.dat", "ep/*/*.dat"])
def test_the_same_command_means_the_same_again_wherever_results_are(folder, pattern, here):
    one = Batch.of([pattern], Path(folder), OPTIONS)
    assert len(one.pairs) == 2
    with only_run(one, one.work()):  # and is killed while it makes the first folder
        Path(folder, one.pairs[0][1]).parent.mkdir(parents=True, exist_ok=True)
    assert Batch.of([pattern], Path(folder), OPTIONS) == one
    do(one)
    assert Batch.of([pattern], Path(folder), OPTIONS) == one


def test_a_folder_of_results_that_is_new_is_none_of_the_recordings(here):
    (here / "ep" / "out").mkdir()
    assert len(recordings_of(["ep/*"], Path("ep/out"))) == 2
    assert len(recordings_of(["ep/*"], Path("elsewhere"))) == 3
    with pytest.raises(LogError, match="nothing that fits"):
        recordings_of(["ep/o*"], Path("ep/out"))


def test_what_links_lead_to_is_taken_once_under_its_own_name(here):
    (here / "ep" / "loop").symlink_to(".")
    (here / "ep" / "00_newest").symlink_to("1")
    (here / "chosen").mkdir()
    (here / "chosen" / "best").symlink_to(here / "ep" / "1")
    found = recordings_of(["ep/**/camera_data.dat"], Path("out"))
    assert found == [Path("ep/0/camera_data.dat"), Path("ep/1/camera_data.dat")]
    assert recordings_of(["ep/[01]*"], Path("out")) == [Path("ep/0"), Path("ep/1")]
    assert recordings_of(["chosen/*"], Path("out")) == [Path("chosen/best")]


def test_folders_that_links_lead_back_to_are_gone_through_once(here, monkeypatch):
    for name in ("a", "b", "c"):
        (here / "ep" / name).symlink_to(".")
    (here / "ep" / "0" / "up").symlink_to("..")
    (here / "ep" / "nowhere").symlink_to("nowhere")
    looked: list[str] = []
    for name in ("listdir", "scandir"):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, lambda path=".", real=real: looked.append(str(path)) or real(path))
    for pattern in ("ep/**", "ep/**/camera_data.dat", "**/ep/**/0/**/*.dat", "**/**/camera_data.dat"):
        looked.clear()
        assert Path("ep/0/camera_data.dat") in recordings_of([pattern], Path("out"))
        assert len(looked) < 40


@pytest.mark.parametrize(
    "pattern", ["**", "**/", "ep/**", "ep/**/", "ep/**/*", "*/**/0/*.dat", "{here}/**/0"]
)
def test_stars_mean_what_they_mean_to_glob(pattern, here):
    given = pattern.format(here=here)
    found = {os.path.realpath(path) for path in recordings_of([given], Path("out"))}
    expected = {os.path.realpath(path) for path in glob.glob(given, recursive=True)}
    assert found == expected


def test_what_is_named_is_taken_as_it_is(here):
    (here / "ep" / "[01]").mkdir()
    for path in ("ep/[01]", "ep/nothing", "out/ep/0.poses.h5"):
        assert recordings_of([path], Path("out")) == [Path(path)]


def test_one_recording_under_two_names_and_two_under_one_are_refused(here):
    with pytest.raises(LogError, match="each recording once"):
        outputs_of([Path("ep/0"), here / "ep" / "0"], Path())
    above = Path(*[".."] * len(here.parts), "ep", "0")
    assert outputs_of([above], Path()) == outputs_of([Path("ep/0")], Path())
    with pytest.raises(LogError, match="has this name"):
        outputs_of([above, Path("ep/0")], Path())
