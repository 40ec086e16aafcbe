import contextlib
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synthetic.camera.shot import QUALITIES
from tests.docs.samples import PAGES, blocks
from tests.helpers import ROOT, contents
from tests.helpers.log_writers import write_picture
from tests.helpers.synthetic_needs import skip_without_platform

EXAMPLES = ROOT / "examples"
SHOWN = re.compile(r"^\[`examples/(\w+\.py)`\]\(\.\./examples/\1\)$", re.MULTILINE)
"""A line of a page in whose place the site shows the example."""


@pytest.fixture(scope="module")
def working(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with short recordings `tracker-demo` and `my_recording`."""
    folder = tmp_path_factory.mktemp("examples")
    few = shutil.ignore_patterns("00000[4-9]", "00001*")
    for name in ("tracker-demo", "my_recording"):
        shutil.copytree(ROOT / "tracker" / "demo", folder / name, ignore=few)
    return folder


def test_the_page_names_every_example_and_every_short_one_is_shown_on_a_page():
    texts = {path.name: path.read_text(encoding="utf-8") for path in EXAMPLES.glob("*.py")}
    page, elsewhere = PAGES["docs/examples"], {"demo.py", "dice_scene.py"}
    # These are of `make demo`, and of the pictures that another one reads.
    assert {*re.findall(r"`(\w+\.py)`", page), *SHOWN.findall(page)} == set(texts) - elsewhere
    shown = {name for page in PAGES.values() for name in SHOWN.findall(page)}
    shown |= {name for name, text in texts.items() if text in blocks("python")}
    long = ("close_the_loop", "cube_pusher", "late_poses", "noisy_environment", "still")  # pages name them
    assert set(texts) - shown == elsewhere | {f"{name}.py" for name in long}


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("own_arena", ""),
        ("track_recording", r"(.* s  \w+ \[[-. \d]+\] m \[[-. \d]+\] m/s\n)+"),
        ("follow_live", r"(refound|found|tracking), \d+ ms old, in 50 ms at \[[-. \d]+\] m\n(.*\n)*"),
        ("control_loop", r"(.*\n){3}act at \[0\.11.*\n"),
        ("reward_from_images", r"reward -0\.\d+ of 4 frames, 0 of them unknown\n"),
        ("own_rig", r"left .*\nright .*\n"),
    ],
)
def test_an_example_prints_what_it_finds_in_a_recording(name, printed, working, run_script):
    assert re.fullmatch(printed, run_script(EXAMPLES / f"{name}.py", folder=working).stdout)
    assert name != "own_rig" or (working / "my_rig" / "arena.toml").is_file()


def test_the_example_finds_the_cube(working, run_script):
    result = run_script(EXAMPLES / "detect_cube.py", folder=working)
    names = [line[:16].strip() for line in result.stdout.splitlines()]
    assert names == ["position [m]", "orientation xyzw", "confidence"]
    assert float(result.stdout.split()[-1]) > 0.5
    (shown,) = (block for block in blocks("text", "docs/first-steps") if block.startswith("position"))
    numbers = (re.findall(r"-?\d\.[\de-]+", text) for text in (shown, result.stdout))
    np.testing.assert_allclose(*(np.array(found, float) for found in numbers), atol=2e-3)


def test_the_examples_of_tasks_tell_errors_and_which_dice_to_move(tmp_path, run_script):
    error, *moves = run_script(EXAMPLES / "dice_task.py", folder=tmp_path).stdout.splitlines()
    assert 2500 < int(error.removeprefix("error [px]")) < 3500
    assert 5 <= len(moves) <= 10
    assert all(line.startswith("move [") for line in moves)
    printed = run_script(EXAMPLES / "task_errors.py", folder=tmp_path).stdout.split()
    assert float(printed[0]) == pytest.approx((np.hypot(0.01, 0.02) / 0.39 + 0.075) / 2)
    assert float(printed[-1]) == -67000


def test_what_was_tracked_is_plotted_and_not_tracked_again(working, run_script):
    pytest.importorskip("matplotlib", reason="plot: no module matplotlib")
    printed = run_script(EXAMPLES / "retrack.py", folder=working).stdout
    assert printed.count("100 % of them sure, 4 tracked now") == 2
    assert run_script(EXAMPLES / "retrack.py", folder=working).stdout.count(", 0 tracked now") == 2
    (working / "tracker-demo.poses.h5").rename(working / "poses.h5")
    run_script(EXAMPLES / "plot_poses.py", folder=working)
    assert (working / "height.png").stat().st_size > 10_000


@pytest.mark.parametrize(("period", "step", "most"), [(0.1, 0.02, 8.0), (0.03, 0.01, 4.0), (0.02, 0.02, 5.0)])
def test_a_policy_sees_late_and_noisy_poses_but_none_of_the_episode_before(period, step, most, capsys):
    text = (EXAMPLES / "noisy_poses.py").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec(text.replace("0.1, 0.02 ", f"{period}, {step} "), names)
    assert names["PERIOD"] == period
    assert np.isfinite(names["off"]).mean() > 0.9
    assert 1.0 < np.nanmedian(names["off"]) < most
    if period == 0.1:
        assert [capsys.readouterr().out] == blocks("text", "docs/noise")
        exec(text.replace("< 0.001", "< 0.5"), names)  # episodes end often
        assert names["ended"].sum() > 100
        assert not names["coming"][0][1].found[names["ended"]].any()


def test_a_wrapper_makes_poses_late_noisy_and_missed(run_script, tmp_path, monkeypatch):
    gymnasium = pytest.importorskip("gymnasium", reason="gymnasium: no module gymnasium")
    printed = run_script(EXAMPLES / "noisy_environment.py", folder=tmp_path).stdout
    assert re.fullmatch(r"\d+\.\d mm from the truth, confidence [01]\.\d\d\n", printed)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    from noisy_environment import NoisyPoses, Pushed

    environment, still, off = NoisyPoses(Pushed()), np.zeros(2), []
    for seed in range(20):
        first, _ = environment.reset(seed=seed)
        assert environment.observation_space.contains(first)
        assert first["confidence"] == 0  # nothing has arrived yet
        seen = [environment.step(still) for _ in range(30)]
        assert all(environment.observation_space.contains(one[0]) for one in seen)
        last = seen[-1][0]
        if last["confidence"] > 0.5:
            off.append(np.linalg.norm(last["position"] - seen[-1][4]["truth"]))
    assert len(off) > 10
    assert 2e-4 < np.median(off) < 5e-3
    again, _ = environment.reset(seed=19)
    assert all(np.array_equal(again[key], first[key]) for key in first)
    moved = np.array([[*environment.step([0.1, 0.0])[0]["position"]] for _ in range(50)])[:, 0]
    assert 0.03 < moved[-1] < 0.1  # 0.1 m less what is on its way
    assert isinstance(environment, gymnasium.ObservationWrapper)


def test_fingers_that_the_robot_log_tells_of_are_hidden(tmp_path, run_script):
    skip_without_platform()
    from synthetic.frames import frames

    film = list(frames("cube_v2", 3, 8, quality="fast", sequence=True, dropped=0.0))
    folder = tmp_path / "my_recording"
    film[0].rig.save(folder)
    names = (f"observation_position_{k}" for k in range(9))
    lines = [" ".join(["#time_index timestamp", *names])]
    for frame in film:
        stamp = f"{frame.timestamp:.3f}"
        for camera, image in zip(frame.rig, frame.images, strict=True):
            write_picture(folder / stamp / f"{camera.name}.png", image)
        lines.append(" ".join(map(str, (frame.index, stamp, *frame.scene.robot_position))))
    (folder / "robot_data.csv").write_text("\n".join(lines) + "\n")
    printed = run_script(EXAMPLES / "hidden_fingers.py", folder=tmp_path).stdout.splitlines()
    assert len(printed) == len(film)
    for line, frame in zip(printed, film, strict=True):
        found = [float(value) for value in re.findall(r"-?\d\.\d+", line.split(" s ")[1])]
        assert np.linalg.norm(found - frame.objects[0].position) < 0.01


def test_an_environment_sees_what_its_fingers_do(monkeypatch):
    pytest.importorskip("gymnasium", reason="gymnasium: no module gymnasium")
    skip_without_platform()
    monkeypatch.syspath_prepend(str(EXAMPLES))
    from gym_environment import MoveCube

    with contextlib.closing(MoveCube(width=135)) as environment:
        first, about = environment.reset(seed=3)
        assert environment.observation_space.contains(first)
        assert np.linalg.norm(first["keypoints"].mean(axis=0) - about["truth"]) < 1e-3
        np.testing.assert_allclose(first["goal"].mean(axis=0), environment.goal_position, atol=1e-7)
        assert np.linalg.norm(first["goal"][0] - first["goal"][7]) == pytest.approx(0.065 * np.sqrt(3))
        after, reward, ended, cut, _ = environment.step(np.ones(9, np.float32))
        assert environment.observation_space.contains(after)
        assert np.abs(after["joints"] - first["joints"]).max() > 0.02
        expected = -np.linalg.norm((after["keypoints"].mean(axis=0) - environment.goal_position)[:2]) / 0.78
        assert reward == pytest.approx(expected, abs=0.01)
        assert not ended
        assert not cut
        environment.reset(seed=4)
        for _ in range(3):
            environment.step(-np.ones(9, np.float32))
        again, _ = environment.reset(seed=3)
        assert all(np.array_equal(first[key], again[key]) for key in first)
        repeated, *_ = environment.step(np.ones(9, np.float32))
        assert all(np.array_equal(after[key], repeated[key]) for key in after)


def test_an_object_of_ones_own_is_found_and_the_still_the_same_but_for_its_seed(tmp_path, run_script):
    skip_without_platform()
    printed = run_script(EXAMPLES / "own_object.py", folder=tmp_path).stdout
    off = [float(line.split()[0]) for line in printed.splitlines()]
    assert len(off) == 3
    assert max(off) < 0.5
    for more in ((), ("--output", "again"), ("--output", "other", "--seed", 7)):
        result = run_script(EXAMPLES / "still.py", *more, folder=tmp_path)
        found = re.search(r"error +([\d.]+) mm, ([\d.]+) degrees", result.stdout)
        assert found is not None, result.stdout
        assert float(found[1]) < 1
        assert float(found[2]) < 1
    first, again, other = (contents(tmp_path / name) for name in ("demo", "again", "other"))
    assert first == again
    assert first["overlay.png"] != other["overlay.png"]


def test_the_demo_films_what_it_finds(tmp_path, run_script, monkeypatch):
    pytest.importorskip("av", reason="video: no module av")
    pytest.importorskip("matplotlib", reason="plot: no module matplotlib")
    skip_without_platform()
    monkeypatch.setitem(QUALITIES, "default", QUALITIES["fast"])
    result = run_script(EXAMPLES / "demo.py", "--frames", 3, "--output", "demo", folder=tmp_path)
    assert "within 5 mm, 5°  3" in result.stdout
    written = {path.name for path in (tmp_path / "demo").iterdir()}
    assert {"overlay.png", "overlay.mp4", "errors.png", "camera60.png", "camera60.yml"} <= written


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        *((one, (), "--output demo: in use, expected a new or an empty folder") for one in ("still", "demo")),
        ("still", ("--seed", -1), "--seed: found -1, expected at least 0"),
        ("close_the_loop", ("--seed", -1), "--seed: found -1, expected at least 0"),
        *(
            ("close_the_loop", ("--seconds", value), f"--seconds: found {value}, expected at least 1")
            for value in (0.0, -1.0, np.nan, np.inf)
        ),
        ("demo", ("--frames", 0, "--output", "new"), "found no images for it, expected at least one"),
    ],
)
def test_an_example_refuses_a_folder_in_use_and_odd_values(
    name, arguments, message, tmp_path, run_script, monkeypatch, capfd
):
    pytest.importorskip("av", reason="video: no module av")
    skip_without_platform()
    monkeypatch.syspath_prepend(str(EXAMPLES))
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / "camera60.yml").write_text("mine")
    with pytest.raises(SystemExit) as stop:
        run_script(EXAMPLES / f"{name}.py", *arguments, folder=tmp_path)
    assert stop.value.code == 2
    assert capfd.readouterr().err.endswith(f"{message}\n")
    assert contents(tmp_path / "demo") == {"camera60.yml": b"mine"}
