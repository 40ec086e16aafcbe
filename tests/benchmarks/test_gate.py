from __future__ import annotations

import copy
import json
import math

import pytest
from click.testing import CliRunner

from benchmarks import commands
from benchmarks.commands import Run, measure
from benchmarks.data.sets import Plan
from benchmarks.judge import gate, origin
from benchmarks.judge.results import (
    Results,
    ResultsError,
    contradictions,
    read_results,
    write_results,
)
from benchmarks.judge.targets import evaluate
from benchmarks.program import main
from benchmarks.score.records import frame_of
from benchmarks.score.summary import accuracy_rows
from tests.benchmarks.test_metrics import record
from tests.helpers.made_up_results import made_up_results

HERE = {"commit": "abc", "clean": True, "code": "c0de", "kernels": "ce11", "processor": "one"}
ABOUT = {**HERE, "draw": "development", "seed": 1, "scenes": 3, "skipped": {}}
FIGURES = {
    "median_mm": 0.1,
    "p90_deg": 0.4,
    "within_5": 99.0,
    "wrong_and_sure": 0.0,
    "median_nees": 5.0,
    "brier": 0.01,
    "median_ms": 5.0,
}
FILMS = {"filtered": 99.8, "flips": 0, "losses": 0, "median_nees": 5.0}


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """The tree that results are taken to be of."""
    own = dict(HERE)
    monkeypatch.setattr(gate, "origin", lambda: own)
    return own


def results(films=None, ratio=2.0, **changes) -> Results:
    cube = {"object": "cube_v2", "n": 400}
    rows = [
        {"part": "accuracy", "group": "realistic", **cube, **FIGURES, **changes},
        {"part": "accuracy", "group": "absent", **cube, "false_finds": 0},
        {"part": "films", "group": "all", **cube, **FILMS, **(films or {})},
        {"part": "time", "group": "rendered, 270×270", **cube, "ratio": ratio},
    ]
    return Results(copy.deepcopy(ABOUT), rows)


@pytest.fixture
def baseline(tmp_path):
    gate.write_baseline(results(), "the first", tmp_path / "baseline.json")
    return gate.read_baseline(tmp_path / "baseline.json")


def test_an_equal_run_passes(baseline):
    assert gate.failures(baseline, results()) == []


@pytest.mark.parametrize(
    "change",
    [
        {"median_mm": 0.104},
        {"median_mm": 0.02},
        {"within_5": 98.6},
        {"within_5": 100.0},
        {"median_nees": 5.7},
        {"median_ms": 500.0},
        {"ratio": 2.4},
        {"ratio": 0.5},
        {"films": {"filtered": 99.6}},
        {"films": {"filtered": 100.0, "median_nees": 5.5}},
    ],
)
def test_better_or_slightly_worse_passes(baseline, change):
    assert gate.failures(baseline, results(**change)) == []


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"median_mm": 0.108}, "accuracy / realistic /  / cube_v2 / median_mm: 0.108, was 0.1"),
        ({"p90_deg": 0.5}, "accuracy / realistic /  / cube_v2 / p90_deg"),
        ({"within_5": 98.0}, "accuracy / realistic /  / cube_v2 / within_5"),
        ({"within_5": math.nan}, "accuracy / realistic /  / cube_v2 / within_5: not measured"),
        ({"wrong_and_sure": 0.5}, "accuracy / realistic /  / cube_v2 / wrong_and_sure"),
        ({"median_nees": 9.0}, "accuracy / realistic /  / cube_v2 / median_nees"),
        ({"median_nees": 2.0}, "accuracy / realistic /  / cube_v2 / median_nees"),
        ({"brier": 0.02}, "accuracy / realistic /  / cube_v2 / brier"),
        ({"ratio": 2.6}, "time / rendered, 270×270 /  / cube_v2 / ratio"),
        ({"films": {"filtered": 99.0}}, "films / all /  / cube_v2 / filtered: 99, was"),
        ({"films": {"flips": 1}}, "films / all /  / cube_v2 / flips: 1, was"),
    ],
)
def test_what_falls_by_more_than_its_tolerance_is_named(baseline, change, name):
    (worse,) = gate.failures(baseline, results(**change))
    assert worse.startswith(name)


def test_a_part_that_was_not_measured_fails(baseline):
    now = results()
    now.rows = [row for row in now.rows if row["part"] != "films"]
    assert all("films / all" in line and "not measured" in line for line in gate.failures(baseline, now))
    assert gate.failures(baseline, now)


def test_a_missing_environment_is_a_failure_too(baseline):
    now = results()
    now.about["skipped"] = {"simulation package": "no network"}
    assert gate.failures(baseline, now) == ["simulation package: left out: no network"]


def test_other_scenes_cannot_be_compared(baseline):
    for key, value in (("scenes", 4), ("seed", 2), ("draw", "release")):
        now = results()
        now.about[key] = value
        with pytest.raises(ResultsError, match=f"found {key}"):
            gate.failures(baseline, now)


@pytest.mark.parametrize(("key", "word"), [("code", "sources"), ("kernels", "compiled kernels")])
def test_results_of_other_sources_or_stale_kernels_fail(baseline, here, key, word):
    here[key] = "changed since"
    (worse,) = gate.failures(baseline, results())
    assert worse.startswith(word)
    assert "measure again" in worse


def test_kernels_are_named_by_their_sources():
    from tracker import compiled

    assert origin.origin()["kernels"] == compiled.fingerprint("tracker")


def test_a_figure_that_its_frames_do_not_give_fails(baseline):
    now = made_up_results(12)
    assert contradictions(now) == []
    row = next(row for row in now.rows if row["part"] == "accuracy" and row["group"] == "realistic")
    row["median_mm"] *= 0.9
    (wrong,) = contradictions(now)
    assert wrong.startswith("accuracy / realistic / cube_v2 / median_mm: states")


def test_a_file_edited_by_hand_is_refused(tmp_path):
    write_results(tmp_path / "results.json", results())
    assert read_results(tmp_path).rows[0]["median_mm"] == 0.1
    text = (tmp_path / "results.json").read_text(encoding="utf-8")
    (tmp_path / "results.json").write_text(text.replace('"median_mm": 0.1', '"median_mm": 0.09'), "utf-8")
    with pytest.raises(ResultsError, match="changed by hand"):
        read_results(tmp_path)


def test_results_survive_the_disk(tmp_path):
    before = made_up_results(4)
    before.rows.append({"part": "x", "object": "cube_v2", "nothing": math.nan, "n": 2})
    write_results(tmp_path / "results.json", before)
    again = read_results(tmp_path)
    assert "NaN" not in (tmp_path / "results.json").read_text(encoding="utf-8")
    assert again.rows[-1] == {"part": "x", "object": "cube_v2", "n": 2}
    assert again.frames.dtypes.to_dict() == before.frames.dtypes.to_dict()
    assert again.frames.position_mm.isna().equals(before.frames.position_mm.isna())
    (tmp_path / "broken.json").write_text("[")
    with pytest.raises(ResultsError, match="not a file of results"):
        read_results(tmp_path / "broken.json")


def test_a_baseline_needs_a_reason_and_a_clean_tree(tmp_path, here):
    with pytest.raises(ResultsError, match="found no reason"):
        gate.write_baseline(results(), " ", tmp_path / "baseline.json")
    dirty = results()
    dirty.about["clean"] = False
    with pytest.raises(ResultsError, match="not committed"):
        gate.write_baseline(dirty, "why", tmp_path / "baseline.json")
    here["code"] = "other"
    with pytest.raises(ResultsError, match="sources"):
        gate.write_baseline(results(), "why", tmp_path / "baseline.json")
    assert not (tmp_path / "baseline.json").exists()


def test_the_command_fails_with_1_and_lists_what_is_worse(tmp_path):
    run = CliRunner()
    write_results(tmp_path / "results.json", results())
    arguments = ["gate", "-o", str(tmp_path), "--baseline", str(tmp_path / "baseline.json")]
    assert isinstance(run.invoke(main, [*arguments, "--update"]).exception, ResultsError)
    assert run.invoke(main, [*arguments, "--update", "--reason", "a first one"]).exit_code == 0
    assert json.loads((tmp_path / "baseline.json").read_text())["reason"] == "a first one"
    passed = run.invoke(main, arguments)
    assert passed.exit_code == 0
    assert "a first one" in passed.output
    write_results(tmp_path / "results.json", results(median_mm=0.2))
    failed = run.invoke(main, arguments)
    assert failed.exit_code == 1
    assert "median_mm" in failed.output


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Measures made-up parts in a tree that can be changed."""
    tree = dict(HERE)
    monkeypatch.setattr(commands, "origin", lambda: dict(tree))
    rows = {part: [{"part": part, "object": "cube_v2", "n": 1, "x": 1.0}] for part in ("speed", "dice")}
    monkeypatch.setattr(commands, "PARTS", {part: lambda run, part=part: rows[part] for part in rows})

    def run(*parts, seed=1):
        return measure(Run(Plan(3, seed), tmp_path, None, results=Results({"draw": "other"})), parts)

    return run, tree


def test_parts_of_one_tree_are_put_together_and_say_what_made_them(measured, tmp_path):
    run, _ = measured
    run("speed")
    run("dice")
    found = read_results(tmp_path)
    assert {row["part"] for row in found.rows} == set(found.about["parts"]) == {"speed", "dice"}
    assert found.about["parts"]["dice"]["commit"] == "abc"


def test_parts_of_different_trees_or_scenes_are_not_put_together(measured):
    run, tree = measured
    run("speed")
    with pytest.raises(ResultsError, match="different trees"):
        run("dice", seed=2)
    tree["code"] = "changed"
    with pytest.raises(ResultsError, match="different trees"):
        run("dice")
    assert {row["part"] for row in run("speed", "dice").rows} == {"speed", "dice"}


def test_sources_that_change_meanwhile_spoil_the_run(measured, monkeypatch):
    run, tree = measured

    def changing(_):
        tree["code"] = "changed"
        return []

    monkeypatch.setitem(commands.PARTS, "speed", changing)
    with pytest.raises(ResultsError, match="changed while"):
        run("speed")


def by_name(found):
    return {(row.name, row.object): row for row in found}


def of(records):
    frames = frame_of(records)
    return by_name(evaluate(Results(rows=accuracy_rows(frames), frames=frames)))


def test_targets_are_met_or_missed_by_the_records():
    good = {"position_mm": 0.05, "rotation_deg": 0.1, "nees": 5.0, "confidence": 0.99, "bound_mm": 0.04}
    records = [record(**good, index=k) for k in range(200)]
    rows = of(records)
    position = rows["realistic: median position", "cube_v2"]
    assert position.met
    assert position.wanted == "≤ 0.1 mm"
    assert rows["realistic: NEES, median", "cube_v2"].met
    assert rows["realistic: median position over bound", "cube_v2"].value == pytest.approx(1.25)
    assert rows["realistic: median position", "cuboid_2x2x8_v2"].state == "unknown"
    bad = of([*records, *[record(found=False)] * 3])
    assert bad["realistic: within 5 mm & 5°, visible ≥ 0.5", "cube_v2"].state == "missed"


def test_one_camera_may_be_ambiguous_but_not_wrong_and_sure():
    base = {"workload": "one camera", "cameras": 1}
    rows = of(
        [
            record(**base, position_mm=15.0, rotation_deg=2.0, confidence=0.2),
            record(**base, found=False, status="ambiguous"),
            record(**base, position_mm=40.0, rotation_deg=2.0, confidence=0.9),
            record(**base, position_mm=40.0, rotation_deg=2.0, confidence=0.9, visible_fraction=0.5),
        ]
    )
    right = rows["one camera: within 20 mm & 5° or ambiguous, visible ≥ 0.7", "cube_v2"]
    assert right.value == pytest.approx(200 / 3)
    sure = rows["one camera: beyond 20 mm or 5° and sure, visible ≥ 0.7", "cube_v2"]
    assert sure.value == pytest.approx(100 / 3)


def test_finds_without_an_object_are_missed_targets():
    records = [record(workload="absent", present=False, found=k < 2, index=k) for k in range(4)]
    row = of(records)["absent: finds where there is no object", "cube_v2"]
    assert (row.value, row.state) == (2, "missed")


def test_speed_is_judged_as_a_multiple_of_the_reference():
    rows = by_name(evaluate(results(ratio=1.9)))
    assert rows["speed: detect", "cube_v2"].met
    assert rows["over time: flips", "cube_v2"].met


def test_the_committed_baseline_holds_figures_that_the_gate_knows():
    figures = gate.read_baseline()["figures"]
    known = gate.tolerances()
    assert figures
    for name in figures:
        part, *_, figure = name.split(" / ")
        assert figure in known[part]


def test_tolerances_are_of_figures_that_summaries_have():
    figures = accuracy_rows(frame_of([record(position_mm=1.0, rotation_deg=1.0, roll_deg=1.0)]))[0]
    assert set(gate.tolerances()["accuracy"]) <= {*figures, "false_finds"}
