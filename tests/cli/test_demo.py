import re
import shlex
from unittest.mock import Mock

import pytest

from tests.docs.samples import blocks
from tests.helpers.command import assert_one_line_error, well
from tests.helpers.full_disk import no_file_longer_than


@pytest.mark.parametrize("name", ["mine", "it's mine"], ids=["plain", "a name that shells split"])
def test_the_demo_finds_the_cube_and_its_hints_work(name, tmp_path, run_here):
    shown = well(run_here("demo", "-o", name, folder=tmp_path))
    assert (tmp_path / name / "overlay.png").is_file()
    millimetres, _, degrees, *_ = shown.stdout.split("median error")[1].split()
    assert float(millimetres) < 0.3
    assert float(degrees) < 0.3
    for line in blocks("text", "README")[0].splitlines():  # the times are another machine's
        expected = line.removeprefix("…") if "ms a frame" not in line else line.partition("  ")[0]
        assert f"\n{expected}" in shown.stdout
    hints = re.findall(r"^  tracker (.*)", shown.stdout, re.MULTILINE)
    assert [hint.split()[0] for hint in hints] == ["detect", "track"]
    for hint in hints:
        well(run_here(*shlex.split(hint), folder=tmp_path))
    assert (tmp_path / "poses.csv").is_file()
    assert_one_line_error(run_here("demo", "-o", name, folder=tmp_path), f"{name}: exists")


def test_the_demo_works_after_one_that_was_interrupted(tmp_path, run_here, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr("tracker.pipeline.ObjectTracker.update", Mock(side_effect=KeyboardInterrupt))
        assert run_here("demo", folder=tmp_path).returncode == 130
    assert not list(tmp_path.iterdir())
    assert run_here("demo", folder=tmp_path).returncode == 0
    assert_one_line_error(run_here("demo", "-o", "nowhere/mine", folder=tmp_path), "nowhere")


def test_a_disk_that_takes_no_demo_is_told_of_once(tmp_path, run_here):
    with no_file_longer_than(2000):
        result = run_here("demo", "-o", "mine", folder=tmp_path)
    assert_one_line_error(result, "mine: cannot be written: File too large")
    assert result.stderr.count("File too large") == 1
    assert not list(tmp_path.iterdir())
