import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers import ROOT
from tests.helpers.command import assert_one_line_error, assert_refused, well
from tracker import cli
from tracker.cli.terminal import bar

NAMES = ("camera60", "camera180", "camera300")


def detect_arguments(demo: Path, **replaced: object) -> list[object]:
    """Arguments of a good `tracker detect`, with the images of some cameras replaced."""
    images = [replaced.get(name, demo / f"{name}.png") for name in NAMES]
    return ["detect", "--object", "cube_v2", "--calibration", demo, *images]


@pytest.fixture
def labelled(tmp_path: Path) -> Path:
    """A folder of three labelled images of red and blue squares on grey."""
    folder = tmp_path / "labelled"
    folder.mkdir()
    for number in range(3):
        rng = np.random.default_rng(number)
        image = rng.normal(110, 4, (120, 120, 3))
        for color, bgr, left in (("red", (40, 50, 190), 10), ("blue", (150, 60, 20), 60)):
            top = 20 + 10 * number
            image[top : top + 40, left : left + 40] = rng.normal(bgr, 4, (40, 40, 3))
            mask = np.zeros((120, 120), np.uint8)
            mask[top : top + 40, left : left + 40] = 255
            cv2.imwrite(str(folder / f"0{number}_mask_{color}.png"), mask)
        cv2.imwrite(str(folder / f"0{number}_image.png"), np.clip(image, 0, 255).astype(np.uint8))
    return folder


@pytest.mark.parametrize(
    ("command", "words"),
    [
        *[(name, ()) for name in ("", "track", "dice", "colors", "colors fit", "colors check")],
        *[(name, ()) for name in ("colors adapt", "colors new")],
        ("detect", ("cube_v1, cube_v2, cube_v3, cuboid_2x2x8_v2, simulated_cube, simulated_cuboid, or a",)),
        ("detect", ("cuboid, or a TOML file", "dice, simulation, or a file (.npz)", "recording (.dat, .h5)")),
    ],
)
def test_every_command_explains_itself_and_names_what_can_be_named(command, words, run_here):
    result = run_here(*command.split(), "--help")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith(f"Usage: tracker {command}".rstrip())
    for word in words:
        assert word in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("ca", "plain,calibrate"),
        ("detect --object cuboid", "plain,cuboid_2x2x8_v2"),
        ("track --colors si", "plain,simulation"),
        ("detect --object my_", "file,my_"),
    ],
)
def test_a_shell_completes_commands_objects_and_colours(words, expected, monkeypatch, run_here):
    monkeypatch.setenv("_TRACKER_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"tracker {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    assert well(run_here()).stdout.split() == [expected]


def test_exit_codes_have_one_meaning_given_in_the_help_and_in_the_documentation(run_here):
    shown, page = run_here("--help").stdout, (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for code, what in cli.EXIT_CODES.items():
        assert f"  {code:<4} {what}\n" in shown
        assert f"| {code} | {what} |\n" in page.replace("`", "")


def test_the_version_is_printed(run_here):
    assert well(run_here("--version")).stdout.startswith("tracker ")


def test_detect_prints_the_pose_for_people(demo, run_here):
    result = well(run_here(*detect_arguments(demo)))
    rows = {line[:21].strip(): line[21:].split() for line in result.stdout.splitlines()}
    assert rows["object"] == ["cube_v2"]
    assert rows["status"] == ["found"]
    assert len(rows["position [mm]"]) == len(rows["std [mm]"]) == 3
    assert np.linalg.norm([float(cell) for cell in rows["orientation"]]) == pytest.approx(1, abs=1e-5)


def test_detect_prints_one_json_object_for_programs_and_draws_it(demo, tmp_path, run_here):
    result = well(run_here(*detect_arguments(demo), "--json", "--overlay", tmp_path / "out.png"))
    found = json.loads(result.stdout)
    assert list(found) == ["object", "status", "pose", "timing_ms"]
    assert found["object"] == "cube_v2"
    assert found["status"] == "found"
    assert set(found["pose"]) == {"position", "orientation", "covariance", "confidence"}
    covariance = np.array(found["pose"]["covariance"])
    assert covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert 0 < found["pose"]["confidence"] <= 1
    assert found["timing_ms"]["total"] > 0
    picture = cv2.imread(str(tmp_path / "out.png"))
    assert picture.shape == cv2.imread(str(demo / "overlay.png")).shape
    without = json.loads(run_here(*detect_arguments(demo, camera180="none"), "--json").stdout)
    np.testing.assert_allclose(without["pose"]["position"], found["pose"]["position"], atol=2e-3)


def test_nothing_found_is_an_answer_and_no_error(demo, tmp_path, run_here):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((270, 270, 3), 90, np.uint8))
    grey = dict.fromkeys(NAMES, tmp_path / "grey.png")
    result = well(run_here(*detect_arguments(demo, **grey), "--json", "--overlay", tmp_path / "out.jpg"))
    found = json.loads(result.stdout)
    assert found["pose"] is None
    assert found["status"] == "no_object_colors"
    assert (tmp_path / "out.jpg").is_file()
    shown = run_here(*detect_arguments(demo, **grey), "--exit-code")
    assert "no_object_colors" in shown.stdout
    assert shown.returncode == 1
    assert run_here(*detect_arguments(demo), "--exit-code").returncode == 0


def test_fitted_colors_are_written_and_can_be_checked(labelled, tmp_path, run_here):
    result = well(run_here("colors", "fit", labelled, "--name", "mine", "-o", tmp_path / "mine.npz"))
    assert "no image shows green" in result.stdout
    assert "no image shows red" not in result.stdout
    checked = well(run_here("colors", "check", labelled, "--colors", tmp_path / "mine.npz"))
    overlaps, confusions, *_ = checked.stdout.split("\n\n")
    header, *_, mean = overlaps.splitlines()
    values = dict(zip(header.split()[3:], mean.split()[1:], strict=True))
    assert float(values["red"]) > 0.95
    assert float(values["blue"]) > 0.95
    assert values["green"] == "-"
    assert confusions.startswith("found as")


def test_cross_validation_says_which_colors_are_weak_and_draws_them(labelled, tmp_path, run_here):
    arguments = ("colors", "check", labelled, "--cross-validate", "--plot", tmp_path / "plot.png")
    result = well(run_here(*arguments))
    assert float(result.stdout.split("\n\n")[0].split()[-1]) > 0.9  # of images that the fit did not see
    for words in ("no colour is weak", "the light: red", "a better set of colours"):
        assert words in result.stdout
    assert cv2.imread(str(tmp_path / "plot.png")).std() > 10
    for path in (*labelled.glob("01*"), *labelled.glob("02*")):
        path.unlink()
    assert_one_line_error(run_here(*arguments[:-2]), "found 1", "at least 2")


def test_a_plot_among_the_images_that_are_read_is_refused(labelled, run_here):
    arguments = ("colors", "check", labelled, "--colors", "cube_v2", "--plot", "labelled/x.png")
    assert_refused(run_here, labelled.parent, arguments, "that are read")


def test_a_failed_fit_keeps_the_old_file(labelled, tmp_path, run_here):
    target = tmp_path / "mine.npz"
    target.write_bytes(b"old")
    shutil.copy(labelled / "00_image.png", labelled / "03_image.png")
    (labelled / "03_mask_red.png").write_bytes(b"broken")
    assert_refused(run_here, tmp_path, ["colors", "fit", labelled, "-o", target], "03_mask_red.png")


def help_into(stdout) -> tuple[int, list[str]]:
    """Exit code and lines on stderr of `tracker --help` that writes there."""
    command = [sys.executable, "-m", "tracker", "--help"]
    done = subprocess.run(command, cwd=ROOT, stdout=stdout, stderr=subprocess.PIPE, check=False, text=True)
    return done.returncode, done.stderr.splitlines()


@pytest.mark.skipif(os.name != "posix", reason="system: pipes and devices of POSIX systems")
def test_a_reader_that_has_left_is_no_reason_to_complain():
    reader, writer = os.pipe()
    os.close(reader)
    assert help_into(writer) == (2, [])
    os.close(writer)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="system: no /dev/full")
def test_output_that_cannot_be_written_is_one_line():
    with open("/dev/full", "w") as full:
        code, (line,) = help_into(full)
    assert code == 2
    assert line.startswith("tracker: output: ")


@pytest.mark.parametrize(
    ("raised", "code", "message"),
    [
        (KeyboardInterrupt(), 130, "tracker: interrupted\n"),
        (RuntimeError("two\nlines"), 2, "RuntimeError in test_cli.py"),
    ],
)
def test_whatever_happens_is_one_line_without_traceback(raised, code, message, monkeypatch, capsys):
    def fail(_: object) -> None:
        raise raised

    monkeypatch.setattr("tracker.load_object", fail)
    with pytest.raises(SystemExit) as stop:
        cli.main(["detect", "--object", "cube_v2", "--calibration", "x", "x.png"])
    assert stop.value.code == code
    printed = capsys.readouterr()
    assert message in printed.err
    assert len(printed.err.splitlines()) == 1
    assert printed.out == ""


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_bar_leaves_its_line_once_all_is_done(monkeypatch):
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    with bar("frames", 3, quiet=False) as advance:
        for _ in range(3):
            assert "frames" in shown.getvalue()
            advance(1)
        done = shown.getvalue()
        assert done.endswith("\r")
        assert not done.rsplit("\r", 2)[1].strip()
        advance(1)
    assert shown.getvalue() == done
