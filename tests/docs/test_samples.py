"""No sample of README and pages that is not run: here, by a test of its own, or it stands in NOT_RUN."""

import glob
import itertools
import json
import re
import shlex
import shutil
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import click
import numpy as np
import pytest

import tracker
from benchmarks.program import main as benchmark_commands
from synthetic.camera.shot import QUALITIES
from synthetic.cli import commands as synthetic_commands
from synthetic.export.workers import run_tasks
from tests.calibration.board.test_extrinsics import PLACES, TRUE
from tests.docs.samples import COMMANDS, FENCED, INLINE_COMMANDS, PAGES, SAMPLES, blocks
from tests.helpers import ROOT, robot_stores
from tests.helpers.boards import photo, pose_towards, write_photos
from tests.helpers.command import Run
from tests.helpers.filmed import RIG, write_recording
from tests.helpers.log_writers import make_content, write_native, write_picture
from tests.helpers.moving_cube import carried, knocked, rests
from tests.helpers.pose_logs import random_poses
from tests.helpers.synthetic_needs import skip_without_platform
from tests.logs.test_robot_log import text
from tracker import CameraRig, cli
from tracker.batch.workers import here
from tracker.calibration.by_object.table import moved
from tracker.calibration.rig import read_arena
from tracker.cli.colors import adapt
from tracker.cli.live import live
from tracker.color_learning.fit import FitOptions
from tracker.poses.file import read_poses, write_poses
from tracker.viz import write_film

NOT_RUN = {
    "python3 -m venv venv && . venv/bin/activate": "is that of the tests here",
    "python3 -m pip install -e .": "asks a registry; scripts/try_release.py installs the wheel",
    "python3 -m pip install -e '.[": "asks a registry; the tests are run with all extras",
    "python -m benchmarks gate": "a minute; `make gate` runs it",
}
"""Beginnings of commands, and why they are only parsed."""

PROGRAMS: dict[str, click.Command] = {
    "tracker": cli.commands,
    "python -m synthetic": synthetic_commands,
    "python -m benchmarks": benchmark_commands,
}

RUN_HERE = ("docs/poses", "docs/recordings", "docs/batch", "docs/learning")
"""Pages whose Python is no example but run in this file."""


def beginning(command: str) -> str | None:
    """The key of NOT_RUN that a command has."""
    return next((start for start in NOT_RUN if command.startswith(start)), None)


RUN = [command for command in COMMANDS if beginning(command) is None]


def test_every_block_says_in_which_language_it_is():
    known = ("python", "sh", "toml", "json", "text", "math", "c", "bibtex")
    found = [(page, language) for page, text in PAGES.items() for language, _ in FENCED.findall(text)]
    assert [(page, language) for page, language in found if language not in known] == []


def test_every_python_sample_is_an_example_or_run_here():
    examples = {path.read_text(encoding="utf-8") for path in (ROOT / "examples").glob("*.py")}
    here = [block for page in RUN_HERE for block in blocks("python", page)]
    assert len(here) == len(RUN_HERE)
    assert [block for block in blocks("python") if block not in examples and block not in here] == []


def test_every_command_is_run_or_says_why_not():
    assert {beginning(command) for command in COMMANDS} - {None} == set(NOT_RUN)
    assert [command for command in RUN if not command.startswith(tuple(PROGRAMS))] == []


def test_every_block_of_commands_has_below_it_what_they_print():
    assert [sample for sample in SAMPLES if not sample.shown] == []
    assert len(SAMPLES) > 25


def test_commands_that_are_not_run_are_understood(tmp_path, monkeypatch):
    for name in ("DIR", "carried", "my_recording", "tracker-demo"):
        (tmp_path / name).mkdir()
    (tmp_path / "cameras.toml").touch()
    monkeypatch.chdir(tmp_path)
    understood = []
    monkeypatch.setattr(click.Command, "invoke", lambda self, _: understood.append(self.name))
    for command in (*filter(beginning, COMMANDS), *INLINE_COMMANDS):
        for start, program in PROGRAMS.items():
            if command.startswith(f"{start} "):
                program.main(shlex.split(command.removeprefix(start)), standalone_mode=False)
    assert understood.count("live") == 3
    assert {"gate", "new"} < set(understood)


@pytest.fixture
def recorded(working: Path) -> None:
    """What else the commands read."""
    # Cubes that rest in many places of a world below the table; others in the air, and knocked cameras.
    high = np.eye(4)
    high[2, 3] = -0.004
    moved(RIG, high).save(write_recording(working / "rests", list(rests())))
    knocked(RIG, seed=4).save(write_recording(working / "carried", list(carried())))
    # An image store of two robots' episodes, and their calibrations.
    robot_stores.write(working / "my_data.zarr")
    robot_stores.write_robots(working / "robots")
    # Photos of a board: of one camera, and of three with lenses that are known, in two places.
    rng = np.random.default_rng(93)
    for number in range(8):
        write_picture(working / "photos" / f"{number}.png", photo(pose_towards(rng), rng))
    places = {"board_on_table": PLACES[0], "board_elsewhere": PLACES[1]}
    write_photos(working, dict(zip(RIG.names, TRUE, strict=True)), places, rng)


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plain pictures, one process, little learning and a quick replay, which change nothing but numbers."""
    monkeypatch.setitem(QUALITIES, "default", QUALITIES["fast"])
    monkeypatch.setattr("synthetic.export.dataset.run_tasks", lambda *given: run_tasks(*given[:2], 1))
    monkeypatch.setattr("tracker.batch.workers.processes", lambda _: nullcontext(here))
    monkeypatch.setattr("benchmarks.score.metrics.RESAMPLES", 39)
    monkeypatch.setattr("tracker.color_learning.fit.FitOptions", partial(FitOptions, draws=5000))
    other = {"frames": 10, "rounds": 2, "speed": 1.5}
    for option in (*adapt.params, *live.params):
        monkeypatch.setattr(option, "default", other.get(option.name, option.default))


@pytest.mark.slow
@pytest.mark.usefixtures("recorded", "quickly")
def test_the_pages_commands_run_and_print_what_is_shown(working, tmp_path, run_here):
    needed = {"distributed": "cluster", "matplotlib": "plot", "pandas": "bench", "numcodecs": "datasets"}
    for module, extra in {**needed, "rerun": "rerun"}.items():
        pytest.importorskip(module, reason=f"{extra}: no module {module}")
    skip_without_platform()
    printed: dict[str, str] = {}
    for command in RUN:
        if "build/after" in command:  # a change that changed nothing
            shutil.copytree(working / "build" / "before", working / "build" / "after")
        # What the demo leaves is there already.
        folder = tmp_path if command == "tracker demo" else working
        printed[command] = output_of(command, folder, run_here)
    for sample in SAMPLES:
        *before, last = sample.commands
        assert [command for command in before if printed.get(command)] == [], sample.page
        if sample.language == "json":
            assert keys(json.loads(printed[last])) == keys(json.loads(sample.shown)), last
        elif beginning(last) is None:
            assert re.fullmatch(pattern(sample.shown), printed[last]), f"{last}: {printed[last]}"
    assert (working / "my_object.npz").is_file()
    assert (working / "board.pdf").is_file()
    assert len(CameraRig.load(working / "calibration")) == 3
    assert len(read_poses(working / "poses.h5")) == 20
    assert list(run_block(*blocks("python", "docs/batch"))["table"].frames) == [3, 3]


def output_of(command: str, folder: Path, run_here: Run) -> str:
    """What a command prints, which ends well."""
    expanded = (sorted(glob.glob(word, root_dir=folder)) or [word] for word in shlex.split(command))
    words = list(itertools.chain.from_iterable(expanded))
    start = next(start for start in PROGRAMS if command.startswith(f"{start} "))
    main = cli.main if start == "tracker" else PROGRAMS[start].main
    result = run_here(*words[len(start.split()) :], folder=folder, main=main)
    assert result.returncode == 0, f"{command}: {result.stderr}"
    quiet = start == "tracker" and not command.startswith("tracker batch")
    assert not quiet or result.stderr == "", f"{command}: {result.stderr}"
    return result.stdout


def pattern(shown: str) -> str:
    """What a command prints is like: numbers and spaces are free, a line of `…` stands for any lines."""
    numbers = re.sub(r"\d+(?:\\\.\d+)?", r"[\\d.]+", re.escape(shown))
    return re.sub(r"(?:\\[ \n])*…\\\n", r"(?:.*\n)*?", re.sub(r"(?:\\ )+", " +", numbers))


def keys(value: object) -> object:
    """The names in JSON, of lists those in the first item; what depends on the computer is left out."""
    if isinstance(value, dict):
        return {key: keys(item) for key, item in value.items() if key != "timing_ms"}
    return keys(value[0]) if isinstance(value, list) and value else None


def run_block(block: str) -> dict[str, object]:
    """The names that a block of Python leaves."""
    names: dict[str, object] = {}
    exec(compile(block, "sample", "exec"), names)
    return names


def test_the_sample_of_poses_gives_what_its_remarks_say(tmp_path, monkeypatch, rng):
    monkeypatch.chdir(tmp_path)
    write_poses(tmp_path / "poses.h5", random_poses(rng, 6))
    (block,) = blocks("python", "docs/poses")
    names = run_block(block)
    assert len(names["poses"]) == 6
    sizes = {"n": 6, "C": 3, "3": 3}
    stated = re.findall(r"^(.+?) +# \(([\w, ]+?),?\)", block, re.MULTILINE)
    assert len(stated) == 3
    for expression, shape in stated:
        assert eval(expression, names).shape == tuple(sizes[size] for size in shape.split(", ")), expression


def test_the_sample_of_recordings_reads_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_native(tmp_path / "camera_data.dat", make_content(3), poses=1)
    (block,) = blocks("python", "docs/recordings")
    run_block(block)
    first, *frames = capsys.readouterr().out.splitlines()
    assert "3" in first.split()
    assert [line.split()[0] for line in frames] == ["0", "1", "2"]


def test_the_sample_of_robot_states_pairs_images_with_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_native(tmp_path / "camera_data.dat", make_content(3))
    (tmp_path / "robot_data.dat").write_bytes(text())
    run_block(*blocks("python", "docs/learning"))
    printed = capsys.readouterr().out
    assert [line.split()[0] for line in printed.splitlines() if line[0].isdigit()] == ["0", "1", "2"]


def test_the_sample_of_a_folder_with_names_of_its_own_is_read(tmp_path, rng):
    pytest.importorskip("av", reason="video: no module av")
    stated = [block for block in blocks("toml", "docs/recordings") if "[cameras]" in block]
    (tmp_path / "recording.toml").write_text(stated[0], encoding="utf-8")
    images = list(rng.integers(0, 256, (3, 48, 64, 3), np.uint8))
    for number, image in enumerate(images):
        write_picture(tmp_path / "left" / f"{number}.png", image)
        write_picture(tmp_path / f"right_{number}.jpg", image)
    write_film(tmp_path / "above.mp4", images, rate=30)
    with tracker.open_log(tmp_path) as log:
        assert log.camera_names == ("camera60", "camera180", "camera300")
        assert [frame.index for frame in log] == [0, 1, 2]
        assert log[2].timestamp - log[1].timestamp == pytest.approx(1 / 30)
        np.testing.assert_array_equal(log[1].images[0], images[1])


def test_the_sample_of_an_arena_is_that_of_the_sample_in_python(tmp_path, working, monkeypatch):
    monkeypatch.chdir(working)
    (stated,) = blocks("toml", "docs/own-rig")
    (tmp_path / "arena.toml").write_text(stated, encoding="utf-8")
    (same,) = blocks("python", "docs/own-rig")
    assert read_arena(tmp_path) == run_block(same)["arena"]


@pytest.mark.parametrize(
    ("page", "command"),
    [
        ("docs/first-steps", "detect --object cube_v2 tracker-demo"),
        ("docs/retracking", "track my_recording --object cube_v2 -o poses.h5"),
    ],
)
def test_a_sample_of_the_demo_has_todays_lines_and_numbers(run_here, working, page, command):
    (shown,) = (one.shown for one in SAMPLES if (one.page, one.commands[-1]) == (page, f"tracker {command}"))
    printed = run_here(*command.split(), folder=working).stdout
    rows = [
        [line for line in text.splitlines() if not line.startswith(("time", "speed"))]
        for text in (shown, printed)
    ]
    words, numbers = zip(*(split(lines) for lines in rows), strict=True)
    assert words[0] == words[1]
    # In the last digit processors differ.
    np.testing.assert_allclose(*numbers, atol=1.5e-3)


def split(lines: list[str]) -> tuple[list[str], list[float]]:
    """What stands between the numbers of some lines, and the numbers."""
    text = " ".join(" ".join(lines).split())
    number = r"-?\d+(?:\.\d+)?"
    return re.split(number, text), [float(one) for one in re.findall(number, text)]
