"""Runs compared scene by scene, and the gate that rests on it: what it must let through and what not."""

from __future__ import annotations

import copy

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from benchmarks.judge import ci
from benchmarks.judge.compare import compare
from benchmarks.judge.results import Results, ResultsError, read_results, write_results
from benchmarks.program import main
from benchmarks.score.records import FrameRecord, frame_of

CUBE, CUBOID = "cube_v2", "cuboid_2x2x8_v2"
ABOUT = {"seed": 1, "draw": "small"}


@pytest.fixture
def before(rng) -> Results:
    """All right, with errors that differ from scene to scene."""
    records = [
        FrameRecord(
            workload.name,
            name,
            index,
            3,
            0.9,
            True,
            "found",
            True,
            position_mm=float(rng.lognormal(-2, 0.5)),
            rotation_deg=float(rng.lognormal(-1, 0.5)),
            confidence=0.99,
        )
        for workload in ci.WORKLOADS
        for name in (CUBE, CUBOID)
        for index in range(ci.SCENES)
    ]
    third = {"part": "third camera", "object": CUBE, "group": "", "bin": "camera60", "n": 1}
    return Results(dict(ABOUT), [{**third, "px": 0.8, "mm": 1.4}], frame_of(records))


def changed(before: Results, chosen: pd.Series, **factors: float) -> Results:
    """The same run with some scenes' errors multiplied."""
    after = copy.deepcopy(before)
    for key, factor in factors.items():
        after.frames.loc[chosen, key] *= factor
    return after


def of(run: Results, name: str, workload: str | None = None, first: int = ci.SCENES) -> pd.Series:
    frames = run.frames
    own = (frames.object == name) & (frames["index"] < first)
    return own & (frames.workload == workload) if workload else own


def test_an_equal_run_passes_and_a_better_one_too(before):
    assert ci.failures(before, before) == []
    better = changed(before, of(before, CUBOID), position_mm=0.8, rotation_deg=0.9)
    assert ci.failures(before, better) == []


def test_a_run_that_scatters_as_rounding_does_passes(before, rng):
    after = copy.deepcopy(before)
    after.frames["position_mm"] *= np.exp(rng.normal(0, 0.05, len(after.frames)))
    assert ci.failures(before, after) == []


def test_eight_per_cent_of_the_cuboids_median_are_too_much(before):
    worse = changed(before, of(before, CUBOID), position_mm=1.08)
    (line,) = ci.failures(before, worse)
    assert line.startswith(f"{CUBOID} / ratio_mm: 1.08")


def test_a_lost_scene_of_hard_light_is_too_much(before):
    chosen = of(before, CUBE, "small: hard light", first=1)
    worse = changed(before, chosen, position_mm=1e3)
    lines = ci.failures(before, worse)
    assert any(line.startswith(f"small: hard light / {CUBE} / lost: 1") for line in lines)


def test_a_scene_that_is_no_longer_found_is_lost(before):
    worse = copy.deepcopy(before)
    worse.frames.loc[of(before, CUBE, "small: light", 1), ["position_mm", "rotation_deg"]] = np.nan
    worse.frames.loc[of(before, CUBE, "small: light", 1), "found"] = False
    assert ci.failures(before, worse)


def test_recorded_triplets_are_held_and_must_be_there(before):
    worse = copy.deepcopy(before)
    worse.rows[0]["px"] = 1.0
    (line,) = ci.failures(before, worse)
    assert line == "third camera / camera60 / cube_v2 / px: 1.0, was 0.8"
    worse.rows = []
    assert len(ci.failures(before, worse)) == 2


def test_ratios_have_intervals_and_signs_a_probability(before, rng):
    after = copy.deepcopy(before)
    after.frames["position_mm"] *= 1.1 * np.exp(rng.normal(0, 0.05, len(after.frames)))
    for row in compare(before, after):
        assert row["low_mm"] <= row["ratio_mm"] <= row["high_mm"]
        assert 1.0 < row["ratio_mm"] < 1.25
        assert row["ratio_deg"] == row["low_deg"] == row["p_deg"] == 1.0
        assert row["p_mm"] < 0.05


def test_pairs_are_of_the_same_scene_whatever_the_order(before):
    after = copy.deepcopy(before)
    after.frames = after.frames.sample(frac=1.0, random_state=1)
    assert all(row["ratio_mm"] == 1.0 and row["lost"] == row["gained"] == 0 for row in compare(before, after))


def test_runs_of_other_scenes_are_not_compared(before):
    other = copy.deepcopy(before)
    other.about["seed"] = 2
    with pytest.raises(ResultsError, match="other scenes"):
        compare(before, other)
    other.about["seed"], other.frames = 1, other.frames.iloc[:0]
    with pytest.raises(ResultsError, match="no scene"):
        compare(before, other)


def test_the_command_prints_a_table(before, tmp_path):
    for name, run in (("a", before), ("b", changed(before, of(before, CUBE), position_mm=1.5))):
        write_results(tmp_path / f"{name}.json", run)
    done = CliRunner().invoke(main, ["compare", str(tmp_path / "a.json"), str(tmp_path / "b.json")])
    assert done.exit_code == 0, done.output
    lines = [line for line in done.output.splitlines() if line.startswith("| small: light | cube_v2")]
    assert len(lines) == 1
    assert "1.500 (1.500-1.500)" in lines[0]


def test_the_committed_baseline_is_of_these_scenes_and_says_why_it_stands():
    baseline = read_results(ci.BASELINE)
    assert baseline.about["reason"]
    assert baseline.about["scenes"] == ci.plan(ci.BASELINE.parent).scenes
    counts = baseline.frames.groupby(["workload", "object"]).size()
    assert set(counts.index.get_level_values("workload")) == {workload.name for workload in ci.WORKLOADS}
    assert (counts == ci.SCENES).all()
