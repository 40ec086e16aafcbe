"""The command itself, on a few scenes that it renders."""

from __future__ import annotations

import numpy as np

from benchmarks.score.records import read_results, records_of
from tests.helpers import run_python
from tests.helpers.synthetic_needs import skip_without_platform


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
    records = records_of(results)
    assert {r.workload for r in records} == set(names)
    assert len(records) == 18
    assert results["about"]["quick"]
    assert set(results["summary"]) == set(names)
    for record in records:
        assert record.present
        assert 0 < record.visible_fraction <= 1
        assert record.cameras == (2 if record.workload == "two cameras" else 3)
        assert record.found == np.isfinite(record.position_mm)
        assert 0 < record.bound_mm < record.bound_fixed_mm
    assert len(list((out / "worst").glob("*.jpg"))) == len(results["worst"]) > 0
