"""No sample of README and pages that is not run: here, by a test of its own, or it stands in NOT_RUN."""

import glob
import itertools
import json
import re
import shlex
import shutil
from collections.abc import Callable
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
from tests.helpers import RIG, ROOT, robot_stores
from tests.helpers.boards import photo, pose_towards, write_photos
from tests.helpers.command import Run
from tests.helpers.filmed import write_recording
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


TODAYS = (
    "tracker detect --object cube_v2 tracker-demo",
    "tracker track my_recording --object cube_v2 -o poses.h5",
)
"""Commands of which not only the words are those that are shown, but also the numbers."""

WRITTEN: dict[str, Callable[[Path], bool]] = {
    "docs/batch": lambda _: list(run_block(*blocks("python", "docs/batch"))["table"].frames) == [3, 3],
    "docs/own-rig": lambda folder: (
        (folder / "board.pdf").is_file() and len(CameraRig.load(folder / "calibration")) == 3
    ),
    "docs/retracking": lambda folder: len(read_poses(folder / "poses.h5")) == 20,
}
"""Whether what the commands of a page have written is right."""


def beginning(command: str) -> str | None:
    """The key of NOT_RUN that a command has."""
    return next((start for start in NOT_RUN if command.startswith(start)), None)


def test_every_block_says_in_which_language_it_is_and_that_of_python_is_an_example_or_run_here():
    known = ("python", "sh", "toml", "json", "text", "math", "c", "bibtex")
    found = [(page, language) for page, text in PAGES.items() for language, _ in FENCED.findall(text)]
    assert [(page, language) for page, language in found if language not in known] == []
    examples = {path.read_text(encoding="utf-8") for path in (ROOT / "examples").glob("*.py")}
    here = [block for page in RUN_HERE for block in blocks("python", page)]
    assert len(here) == len(RUN_HERE)
    assert [block for block in blocks("python") if block not in examples and block not in here] == []


def test_every_command_is_run_or_says_why_not_and_below_each_block_is_what_they_print():
    assert {beginning(command) for command in COMMANDS} - {None} == set(NOT_RUN)
    assert [one for one in COMMANDS if not (beginning(one) or one.startswith(tuple(PROGRAMS)))] == []
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


BGR = {"red": (40, 50, 190), "green": (60, 150, 70), "blue": (150, 60, 20)}


@pytest.fixture(scope="module")
def working(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages speak of: tracker-demo, my_images, my_recording, my_object.toml, …"""
    folder = tmp_path_factory.mktemp("pages")
    demo, few = ROOT / "tracker" / "demo", shutil.ignore_patterns("00000[3-9]", "00001*")
    shutil.copytree(demo, folder / "tracker-demo")
    shutil.copytree(demo, folder / "my_recording")
    for number in range(2):
        shutil.copytree(folder / "my_recording", folder / "episodes" / f"{number:04d}", ignore=few)
    shutil.copytree(ROOT / "examples" / "dice", folder / "examples" / "dice")
    for number in range(2):
        image = np.random.default_rng(number).normal(110, 4, (90, 120, 3))
        for index, (color, bgr) in enumerate(BGR.items()):
            mask = np.zeros((90, 120), np.uint8)
            mask[20 + 9 * number :, 10 + 40 * index :][:30, :30] = 255
            image[mask > 0] = bgr
            write_picture(folder / "my_images" / f"0{number}_mask_{color}.png", mask)
        write_picture(folder / "my_images" / f"0{number}_image.png", np.rint(image).astype(np.uint8))
    objects = [block for block in blocks("toml") if re.search("^size = ", block, re.MULTILINE)]
    (folder / "my_object.toml").write_text(objects[0], encoding="utf-8")
    return folder


def prepare(page: str, folder: Path) -> None:
    """Write what else the commands of a page read."""
    if page == "docs/calibration-check":
        # Cubes that rest in many places of a world below the table; others in the air, and knocked cameras.
        high = np.eye(4)
        high[2, 3] = -0.004
        moved(RIG, high).save(write_recording(folder / "rests", list(rests())))
        knocked(RIG, seed=4).save(write_recording(folder / "carried", list(carried())))
    elif page == "docs/learning":
        # An image store of two robots' episodes, and their calibrations.
        robot_stores.write(folder / "my_data.zarr")
        robot_stores.write_robots(folder / "robots")
    elif page == "docs/retracking":
        # What the page says to save, above the command that reads it.
        above = PAGES[page].partition("tracker score ")[0]
        (goal,) = re.findall(r"save `(.+?)` as `my_recording/goal.json`", above)
        (folder / "my_recording" / "goal.json").write_text(goal, encoding="utf-8")
    elif page == "docs/own-rig":
        # Photos of a board: of one camera, and of three with lenses that are known, in two places.
        rng = np.random.default_rng(93)
        for number in range(8):
            write_picture(folder / "photos" / f"{number}.png", photo(pose_towards(rng), rng))
        places = {"board_on_table": PLACES[0], "board_elsewhere": PLACES[1]}
        write_photos(folder, dict(zip(RIG.names, TRUE, strict=True)), places, rng)


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Few plain pictures, one process, little learning, a quick replay, which change nothing but numbers."""
    monkeypatch.setitem(QUALITIES, "default", QUALITIES["fast"])
    # Plain pictures must not be taken for those that the gate measures.
    monkeypatch.setenv("TRACKER_BENCHMARK_CACHE", str(tmp_path / "scenes"))
    monkeypatch.setattr("synthetic.export.dataset.run_tasks", lambda *given: run_tasks(*given[:2], 1))
    monkeypatch.setattr("tracker.cli.batch.processes", lambda _: nullcontext(here))
    monkeypatch.setattr("benchmarks.score.metrics.RESAMPLES", 39)
    monkeypatch.setattr("benchmarks.program.QUICK", 3)
    monkeypatch.setattr("tracker.cli.colors.FitOptions", partial(FitOptions, draws=5000))
    other = {"frames": 10, "rounds": 2, "speed": 1.5}
    for option in (*adapt.params, *live.params):
        monkeypatch.setattr(option, "default", other.get(option.name, option.default))


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize("page", dict.fromkeys(sample.page for sample in SAMPLES))
def test_a_pages_commands_run_and_print_what_is_shown(page, working, tmp_path, run_here):
    needed = {"distributed": "cluster", "matplotlib": "plot", "pandas": "bench", "numcodecs": "datasets"}
    for module, extra in {**needed, "rerun": "rerun"}.items():
        pytest.importorskip(module, reason=f"{extra}: no module {module}")
    skip_without_platform()
    prepare(page, working)
    for sample in (one for one in SAMPLES if one.page == page):
        printed = {}
        for command in itertools.filterfalse(beginning, sample.commands):
            if "build/after" in command:  # a change that changed nothing
                shutil.copytree(working / "build" / "before", working / "build" / "after")
            # What the demo leaves is there already.
            folder = tmp_path if command == "tracker demo" else working
            printed[command] = output_of(command, folder, run_here)
        *before, last = sample.commands
        assert [command for command in before if printed.get(command)] == []
        if sample.language == "json":
            assert keys(json.loads(printed[last])) == keys(json.loads(sample.shown)), last
        elif not beginning(last):
            assert re.fullmatch(pattern(sample.shown), printed[last]), f"{last}: {printed[last]}"
        if last in TODAYS:
            assert_same_numbers(sample.shown, printed[last])
    assert page not in WRITTEN or WRITTEN[page](working)


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


def assert_same_numbers(*printed: str) -> None:
    """Two texts differ in the last digit at most, as processors do, but for lines about time."""
    number, words, values = r"-?\d+(?:\.\d+)?", [], []
    for one in printed:
        lines = (line for line in one.splitlines() if not line.startswith(("time", "speed")))
        kept = " ".join(" ".join(lines).split())
        words.append(re.split(number, kept))
        values.append([float(found) for found in re.findall(number, kept)])
    assert words[0] == words[1]
    np.testing.assert_allclose(*values, atol=1.5e-3)


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


@pytest.mark.parametrize("page", ["docs/recordings", "docs/learning"])
def test_the_samples_of_recordings_read_one_and_pair_images_with_states(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_native(tmp_path / "camera_data.dat", make_content(3), poses=int(page == "docs/recordings"))
    (tmp_path / "robot_data.dat").write_bytes(text())
    run_block(*blocks("python", page))
    lines = capsys.readouterr().out.splitlines()
    assert page == "docs/learning" or "3" in lines.pop(0).split()
    assert [line.split()[0] for line in lines if line[0].isdigit()] == ["0", "1", "2"]


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


def test_the_samples_of_an_arena_are_the_same_and_that_of_an_object_loads(tmp_path, working, monkeypatch):
    monkeypatch.chdir(working)
    (stated,) = blocks("toml", "docs/own-rig")
    (tmp_path / "arena.toml").write_text(stated, encoding="utf-8")
    (same,) = blocks("python", "docs/own-rig")
    assert read_arena(tmp_path) == run_block(same)["arena"]
    model = tracker.load_object(working / "my_object.toml")
    assert model.name == "my_object"
    assert model.colors == "my_object.npz" or Path(model.colors).parent == working
