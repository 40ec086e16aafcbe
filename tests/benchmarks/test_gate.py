import copy
import dataclasses

import numpy as np
import pandas as pd
import pytest

import tracker
from benchmarks import program
from benchmarks.data.plan import CACHE
from benchmarks.judge import gate
from benchmarks.judge.compare import compare, text
from benchmarks.judge.results import Results, ResultsError, read_results, write_results
from benchmarks.measure.accuracy import measure_accuracy
from tests.benchmarks.made_up import ABOUT, answers, printed_by, results
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.pose.evidence import NUMBERS


@pytest.fixture(scope="module")
def baseline() -> Results:
    """The committed one."""
    return read_results(gate.BASELINE)


def assert_told(before: Results, after: Results, *words: str) -> None:
    """The gate fails, with one of some words."""
    worse = gate.failures(before, after)
    assert any(word in line for line in worse for word in words), worse


def changed(run: Results, **columns) -> Results:
    """The same run with columns of the accuracy computed again from its frame."""
    after = copy.deepcopy(run)
    frame = after.frames["accuracy"]
    after.frames["accuracy"] = frame.assign(**{key: make(frame) for key, make in columns.items()})
    return after


def some(frame: pd.DataFrame, every: int) -> np.ndarray:
    return np.arange(len(frame)) % every == 0


HARMLESS = {
    "nothing": {},
    "rounding": {
        "mm": lambda f: f.mm * np.where(some(f, 2), 1.01, 0.99),
        "confidence": lambda f: f.confidence * 0.9999,
    },
    "another, busy machine": {"ratio": lambda f: f.ratio * 1.6},
    # A wrong answer that becomes right changes what the confidence is worth.
    "better": {
        "mm": lambda f: f.mm.where(f.mm > 4.5, f.mm * 0.97),
        "deg": lambda f: f.deg.where(f.deg > 4.5, f.deg * 0.97),
        "ratio": lambda f: f.ratio * 0.5,
    },
}

SABOTAGE = {
    "covariance × 3": ({"nees": lambda f: f.nees / 3}, "NEES"),
    "covariance ÷ 3": ({"nees": lambda f: f.nees * 3}, "NEES"),
    "all confidences 0.7": (
        {"confidence": lambda f: f.confidence.where(f.confidence.isna(), 0.7)},
        "confidence",
    ),
    "every tenth pose moved by 3 mm": (
        {"mm": lambda f: np.where(some(f, 10), np.hypot(f.mm, 3.0), f.mm)},
        "grown",
    ),
    "detect 2.2 times as slow": ({"ratio": lambda f: f.ratio * 2.2}, "× reference"),
    "the slowest tenth three times as slow": (
        {"ratio": lambda f: f.ratio * np.where(f.ratio > f.ratio.quantile(0.9), 3, 1)},
        "99th",
    ),
    "45 % of the scenes 5 mm worse": ({"mm": lambda f: f.mm + 5.0 * (np.arange(len(f)) % 20 < 9)}, "typical"),
    "errors 5 % larger": ({"mm": lambda f: f.mm * 1.05}, "typical"),
    "poses of look-alikes": (
        {
            "confidence": lambda f: np.where(~f.present, 0.8, f.confidence),
            "found": lambda f: f.found | ~f.present,
        },
        "above 0.5",
    ),
    "sure of what is wrong": (
        {
            "confidence": lambda f: np.where(some(f, 40), 0.99, f.confidence),
            "mm": lambda f: f.mm + 60.0 * some(f, 40),
        },
        "wrong and sure",
    ),
}


@pytest.mark.parametrize("name", HARMLESS)
def test_the_gate_lets_through(baseline, name):
    assert gate.failures(baseline, changed(baseline, **HARMLESS[name])) == []


@pytest.mark.parametrize("name", SABOTAGE)
def test_the_gate_tells(baseline, name):
    columns, word = SABOTAGE[name]
    assert_told(baseline, changed(baseline, **columns), word)


@pytest.mark.parametrize("part", ["third camera", "recorded, one camera"])
def test_the_gate_tells_of_recorded_pictures(baseline, part):
    worse = copy.deepcopy(baseline)
    frame = worse.frames[part]
    if part == "third camera":
        frame["px"] += 0.2
    else:
        frame.loc[frame.index % 2 == 0, ["found", "mm", "deg", "confidence"]] = False, np.nan, np.nan, np.nan
    assert_told(baseline, worse, *frame.object.unique())
    del worse.frames[part]
    assert_told(baseline, worse, "not measured")


def test_other_pictures_are_not_compared_and_scenes_that_are_not_measured_are_missed(baseline):
    other = changed(baseline, pictures=lambda f: f.pictures + np.where(f.group == "world", 3.0, 0.0))
    with pytest.raises(ResultsError, match="not of the same pictures: world"):
        gate.failures(baseline, other)
    nothing = Results(dict(ABOUT), {"accuracy": baseline.frames["accuracy"].iloc[:0]})
    with pytest.raises(ResultsError, match="no scene"):
        gate.failures(baseline, nothing)
    fewer = copy.deepcopy(baseline)
    fewer.frames["accuracy"] = fewer.frames["accuracy"].iloc[3:]
    assert_told(baseline, fewer, "3 scenes of the baseline were not measured")
    fewer.frames["accuracy"] = fewer.frames["accuracy"].query("object == 'cube_v2'")
    count = baseline.frames["accuracy"].object.value_counts()["cuboid_2x2x8_v2"]
    assert_told(baseline, fewer, f"cuboid_2x2x8_v2: {count} scenes of the baseline were not measured")


def test_the_committed_baseline_is_of_these_scenes_and_says_why_it_stands(baseline):
    assert baseline.about["clean"]
    assert baseline.about["reason"]
    assert set(baseline.frames["accuracy"].group) == {workload.name for workload in gate.WORKLOADS}
    assert (baseline.frames["accuracy"].groupby("group").object.nunique() == 2).all()


def test_any_run_may_be_the_baseline_and_is_looked_for_before_a_minute_is_spent(tmp_path, monkeypatch):
    monkeypatch.setattr(program, "measure", lambda run, parts, whole: results(4))
    with pytest.raises(ResultsError, match=r"none\.json"):
        printed_by("gate", "--baseline", tmp_path / "none.json", "-o", tmp_path)
    write_results(tmp_path / "results.json", results(4))
    printed = printed_by("gate", "--baseline", tmp_path / "results.json", "-o", tmp_path)
    assert printed.startswith("baseline of 0123abc: no reason given\n")


@pytest.fixture(scope="module")
def measured():
    """Measures a part of the gate's scenes, as often as it is called."""
    skip_without_platform()
    plan = dataclasses.replace(gate.plan(CACHE), scenes=6, workers=1)
    workloads = [w for w in gate.WORKLOADS if w.base == "realistic"]

    def run() -> Results:
        frame, _ = measure_accuracy(plan, workloads, ["cuboid_2x2x8_v2"])
        return Results(dict(ABOUT), {"accuracy": frame})

    return run, run()


def test_the_same_tree_gives_the_same_answers_and_another_objects_colours_worse_ones(measured, monkeypatch):
    run, before = measured
    after = run()
    columns = ["group", "index", "pictures", "mm", "deg", "nees", "confidence"]
    pd.testing.assert_frame_equal(before.frames["accuracy"][columns], after.frames["accuracy"][columns])
    other = tracker.load_colors("cube_v1")
    monkeypatch.setattr(tracker, "load_colors", lambda name: other)
    assert gate.failures(before, run())


@pytest.mark.parametrize("name", ["pixel", "hidden", "inlier", "lacking", "temper", "body"])
def test_the_gate_tells_of_a_number_of_the_evidence(measured, monkeypatch, name):
    run, before = measured
    other = {name: 1.5 * getattr(NUMBERS, name)}
    monkeypatch.setattr("tracker.pose.refiner.NUMBERS", NUMBERS._replace(**other))
    assert_told(before, run(), "confidence")


def test_runs_are_compared_scene_by_scene_and_ratios_have_intervals(rng, tmp_path):
    before = Results(dict(ABOUT), {"accuracy": answers(30)})
    after = changed(before, mm=lambda f: f.mm * 0.8 * rng.lognormal(0, 0.1, len(f)))
    rows = compare(before, after)
    for row in rows:
        if np.isfinite(row["ratio_mm"][0]):
            middle, low, high = row["ratio_mm"]
            assert low <= middle <= high < 1.0
            assert middle == pytest.approx(0.8, abs=0.06)
            assert row["ratio_deg"] == (1.0, 1.0, 1.0)
    shuffled = changed(after)
    shuffled.frames["accuracy"] = after.frames["accuracy"].sample(frac=1.0, random_state=1)
    runs = rows, compare(before, shuffled)
    one, other = (sorted(own, key=lambda row: (row["group"], row["object"])) for own in runs)
    assert text(one) == text(other)
    files = [tmp_path / name for name in ("before.json", "after.json")]
    for file, run in zip(files, (before, after), strict=True):
        write_results(file, run)
    printed = printed_by("compare", *files)
    assert "cube_v2, world (30): 0 lost, 0 gained" in printed
    assert "median_mm" in printed
