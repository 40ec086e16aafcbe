"""The command itself, on a few scenes that it renders."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.judge.results import contradictions, read_results
from tests.helpers import run_python
from tests.helpers.synthetic_needs import skip_without_platform


@pytest.mark.slow
def test_a_smoke_run_measures_and_says_so(tmp_path):
    skip_without_platform()
    out = tmp_path / "out"
    names = ("realistic", "two cameras", "light")
    arguments = [
        *("--quick", "--object", "cube_v2", "--workers", "1"),
        *(part for name in names for part in ("--only", name)),
        *("--cache", tmp_path / "cache", "--real", tmp_path / "nowhere", "-o", out),
    ]
    done = run_python(["-m", "benchmarks", "accuracy", *arguments], check=True)
    assert done.stdout.index("# Results") >= 0
    assert "Traceback" not in done.stderr
    results = read_results(out)
    frames = results.frames
    assert set(frames.workload) == set(names)
    assert len(frames) == 18
    assert (results.about["draw"], results.about["scenes"]) == ("development", 6)
    assert {row["group"] for row in results.rows if row["part"] == "accuracy"} == set(names)
    assert contradictions(results) == []
    assert frames.present.all()
    assert frames.visible_fraction.between(0, 1, inclusive="right").all()
    assert (frames.cameras == np.where(frames.workload == "two cameras", 2, 3)).all()
    assert (frames.found == np.isfinite(frames.position_mm)).all()
    assert ((frames.bound_mm > 0) & (frames.bound_mm < frames.bound_fixed_mm)).all()
    assert len(list((out / "worst").glob("*.jpg"))) == len(results.worst) > 0
