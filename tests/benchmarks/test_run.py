"""The command itself, on a few scenes that it renders."""

from __future__ import annotations

import runpy
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import program
from benchmarks.judge.results import read_results
from tests.helpers.synthetic_needs import skip_without_platform

PICTURES = ["errors.png", "times.png", "trust.png", "visible.png", "worst.jpg"]


@pytest.mark.usefixtures("sketched")
def test_a_smoke_run_measures_and_says_so(tmp_path, monkeypatch):
    skip_without_platform()
    out = tmp_path / "out"
    names = ("realistic", "two cameras", "light")
    arguments = [
        *("--quick", "--object", "cube_v2", "--workers", "1"),
        *(part for name in names for part in ("--only", name)),
        *("--cache", tmp_path / "cache", "--real", tmp_path / "nowhere", "-o", out),
    ]
    monkeypatch.setattr(program, "QUICK", 3)
    done = CliRunner().invoke(program.main, ["accuracy", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "# Results" in done.output
    results = read_results(out)
    frames = results.frames["accuracy"]
    assert (
        set(frames.group)
        == {row["group"] for row in results.figures if row["table"] == "accuracy"}
        == set(names)
    )
    assert len(frames) == 9
    assert (results.about["draw"], results.about["scenes"]) == ("development", 3)
    assert frames.present.all()
    assert frames.visible.between(0, 1, inclusive="right").all()
    assert (frames.found == np.isfinite(frames.mm)).all()
    assert frames.pictures.nunique() == 9
    assert sorted(path.name for path in out.iterdir() if path.suffix != ".json") == PICTURES


def test_an_error_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmarks", "report", "-o", str(tmp_path / "nowhere")])
    with pytest.raises(SystemExit) as stop:
        runpy.run_module("benchmarks", run_name="__main__")
    assert stop.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("benchmarks: ")
    assert "nowhere" in line


def test_a_missing_package_is_named_with_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "benchmarks.program", None)
    with pytest.raises(SystemExit) as stop:
        runpy.run_module("benchmarks", run_name="__main__")
    assert stop.value.code == 2
    assert capsys.readouterr().err.rstrip().endswith("-e '.[bench,synthetic]'")
