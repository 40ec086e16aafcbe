import json
import re
import runpy
import signal
import sys

import numpy as np
import pandas as pd
import pytest

from benchmarks import program
from benchmarks import run as runs
from benchmarks.data.package.environment import VARIABLE
from benchmarks.data.plan import Plan
from benchmarks.data.workloads import WORKLOADS
from benchmarks.judge import results as judged
from benchmarks.judge.results import Results, ResultsError, origin, read_results, write_results
from benchmarks.judge.targets import FILE, judge
from benchmarks.report.documents import document
from benchmarks.run import Run, measure
from tests.benchmarks.made_up import ABOUT, answers, film, printed_by, results
from tests.helpers import contents
from tests.helpers.synthetic_needs import skip_without_platform
from tracker.errors import TrackerError
from tracker.files.toml import read_toml


def test_results_survive_the_disk(tmp_path):
    before = results(4)
    write_results(tmp_path / "results.json", before)
    after = read_results(tmp_path)
    assert after.about == json.loads(json.dumps(before.about))
    assert after.frames.keys() == before.frames.keys()
    for part, frame in before.frames.items():
        pd.testing.assert_frame_equal(after.frames[part], frame, check_dtype=False, rtol=1e-6)


@pytest.mark.parametrize("content", [None, "no JSON", "[]", '{"about": {}, "accuracy": [1]}'])
def test_what_is_no_file_of_results_is_reported_by_name(tmp_path, content):
    if content is not None:
        (tmp_path / "results.json").write_text(content)
    with pytest.raises(ResultsError, match=r"results\.json"):
        read_results(tmp_path)


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Measures made-up parts in a tree that can be changed; counts how often each was."""
    tree = {key: ABOUT[key] for key in origin()}
    monkeypatch.setattr(runs, "origin", lambda: dict(tree))
    count = dict.fromkeys(("films", "dice"), 0)

    def part(name):
        def made(run):
            count[name] += 1
            return {name: pd.DataFrame([{"group": "all", "object": "cube_v2", "x": 1.0}])}

        return made

    monkeypatch.setattr(runs, "PARTS", {name: part(name) for name in count})

    def run(*parts, seed=1, whole=False, **more):
        return measure(Run(Plan(3, seed), tmp_path, None, **more), parts, whole=whole)

    return run, tree, count


def test_parts_of_one_tree_are_put_together_and_say_what_made_them(measured, tmp_path, monkeypatch):
    run, tree, _ = measured
    run("films")
    run("dice")
    found = read_results(tmp_path)
    assert set(found.frames) == set(found.about["parts"]) == {"films", "dice"}
    made = found.about["parts"]["dice"]
    assert {"commit", "processor", "libraries", "renderer", "seconds"} <= set(made)
    with pytest.raises(ResultsError, match="different trees"):
        run("dice", seed=2)
    tree["code"] = "changed"
    with pytest.raises(ResultsError, match="different trees"):
        run("dice")
    assert set(run("films", "dice", whole=True).frames) == {"films", "dice"}
    monkeypatch.setitem(runs.PARTS, "films", lambda run: tree.update(code="changed again") or {})
    with pytest.raises(ResultsError, match="changed while"):
        run("films")


def test_a_run_that_was_broken_off_goes_on_and_a_finished_one_starts_again(measured, monkeypatch):
    run, _, count = measured
    with monkeypatch.context() as patch:
        patch.setitem(runs.PARTS, "dice", lambda run: 1 / 0)
        # What some workloads were asked is not gone on with for all of them.
        for asked in ({"workloads": WORKLOADS[:1]}, {}):
            with pytest.raises(ZeroDivisionError):
                run("films", "dice", whole=True, **asked)
    assert count == {"films": 2, "dice": 0}
    run("films", "dice", whole=True)
    assert count == {"films": 2, "dice": 1}
    run("films", "dice", whole=True)
    assert count == {"films": 3, "dice": 2}


def test_what_is_measured_later_is_no_longer_left_out(measured, monkeypatch):
    run, _, _ = measured
    films = runs.PARTS["films"]
    for name in ("films", "dice"):
        monkeypatch.setitem(runs.PARTS, name, lambda run, name=name: run.skip(name, "there are none") or {})
    run("films")
    found = run("dice")
    assert "Left out: films (there are none); dice (there are none)." in document(found.about, [], [])
    monkeypatch.setitem(runs.PARTS, "films", films)
    found = run("films")
    assert "Left out: dice (there are none)." in document(found.about, [], [])


def test_sets_of_scenes_are_kept_until_their_part_is_finished(measured, tmp_path, monkeypatch):
    run, _, _ = measured
    asked = []

    def made(plan, workloads, objects, keep):
        rows = []
        for name in ("a", "b"):
            answer = [{"group": "g", "object": name}], {}
            rows += keep(name, lambda name=name, answer=answer: asked.append(name) or answer)[0]
            if name == stop[0]:
                raise KeyboardInterrupt
        return pd.DataFrame(rows), {}

    monkeypatch.setattr(runs, "measure_accuracy", made)
    monkeypatch.setitem(runs.PARTS, "accuracy", runs.accuracy)
    # What others have put there stays, and what is damaged counts as none.
    (tmp_path / "kept").mkdir()
    for name, content in (("mine.json", "[1]"), ("mine.txt", ""), ("a.json", "{")):
        (tmp_path / "kept" / name).write_text(content)
    stop = ["a"]
    with pytest.raises(KeyboardInterrupt):
        run("accuracy")
    stop[0] = ""
    assert len(run("accuracy").frames["accuracy"]) == 2
    assert asked == ["a", "b"]
    run("accuracy")
    assert asked == ["a", "b", "a", "b"]
    # Answers to other workloads or of other objects on the same scenes are other answers.
    for other in ({"workloads": WORKLOADS[:1]}, {"objects": ["cube_v2"]}):
        stop[0] = "a"
        with pytest.raises(KeyboardInterrupt):
            run("accuracy")
        stop[0] = ""
        run("accuracy", **other)
    assert asked[4:] == ["a", "a", "b"] * 2
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {"mine.json", "mine.txt"}


@pytest.mark.parametrize("name", ["errors.png", "thesis/results.json"])
def test_a_folder_of_something_else_is_refused(measured, tmp_path, name):
    run, _, count = measured
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    before = contents(tmp_path)
    with pytest.raises(ResultsError, match=f"found {name[:6]}.* and no results.json, expected a new or an"):
        run("films")
    assert (contents(tmp_path), sum(count.values())) == (before, 0)


ELLIPSOID = "inside the stated 95 % ellipsoid"


@pytest.mark.parametrize(
    ("target", "count", "changed", "verdict"),
    [
        ("position, median", 40, {}, "met"),
        ("position, median", 40, {"mm": 1.5}, "missed"),
        ("position, median", 40, {"mm": np.linspace(0.5, 1.5, 40)}, "undecided"),
        ("wrong and sure", 40, {}, "undecided"),
        ("wrong and sure", 2000, {}, "met"),
        ("wrong and sure", 40, {"mm": 9.0}, "missed"),
        (ELLIPSOID, 1000, {}, "met"),
        (ELLIPSOID, 1000, {"nees": lambda own: own.nees / 3}, "missed"),
        (ELLIPSOID, 1000, {"nees": lambda own: own.nees * 3}, "missed"),
    ],
)
def test_a_target_is_met_or_missed_only_where_its_whole_interval_is(target, count, changed, verdict):
    own = answers(count)
    own = own[(own.group == "realistic") & (own.object == "cube_v2")].assign(group="world", mm=0.5, deg=0.1)
    judged = judge(Results({}, {"accuracy": own.assign(**changed)}))
    found = {(row["name"], row["object"]): row["verdict"] for row in judged}
    assert found[f"world: {target}", "cube"] == verdict


def test_fourteen_targets_are_judged_for_both_kinds_of_object():
    made = results(20)
    one = film().assign(group="update")
    made.frames["recorded, one camera"] = pd.concat([one, one.assign(object="cuboid_2x2x8_v2")])
    other = made.frames["accuracy"].query("group == 'realistic'").assign(group="other calibration")
    made.frames["accuracy"] = pd.concat([made.frames["accuracy"], other])
    judged = judge(made)
    assert len({row["name"] for row in judged}) == 14
    assert len(judged) == 28
    assert all(row["reached"] and row["interval"] for row in judged)
    # A target is shown as it is, to the last digit.
    keys = ("at_most", "at_least", "between")
    limits = {
        (target["name"], kind): np.ravel(next(target[key] for key in keys if key in target)[kind]).tolist()
        for target in read_toml(FILE, TrackerError)["target"]
        for kind in ("cube", "cuboid")
    }
    for row in judged:
        shown = [float(number) for number in re.findall(r"[\d.]+", row["target"])]
        assert shown == limits[row["name"], row["object"]]


def test_the_code_of_a_run_is_that_of_its_sources(tmp_path, monkeypatch):
    monkeypatch.setattr(judged, "ROOT", tmp_path)
    monkeypatch.setattr(judged, "PROJECT", ("benchmarks",))
    codes, folder = [], tmp_path / "benchmarks"
    folder.mkdir()
    # Pages and what the benchmarks write are none of them.
    for name, content in (("a.py", "1"), ("a.md", "1"), ("gate.json", "1"), ("a.py", "2"), ("b.toml", "2")):
        (folder / name).write_text(content)
        codes.append(judged.code())
    assert [codes.index(code) for code in codes] == [0, 0, 0, 3, 4]
    assert len(codes[0]) == 16
    assert {"numpy", "numba", "opencv-python-headless"} <= set(origin()["libraries"])


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
    assert "# Results" in printed_by("accuracy", *arguments)
    results = read_results(out)
    frames = results.frames["accuracy"]
    figures = {row["group"] for row in results.figures if row["table"] == "accuracy"}
    assert set(frames.group) == figures == set(names)
    assert len(frames) == 9
    assert (results.about["draw"], results.about["scenes"]) == ("development", 3)
    assert frames.present.all()
    assert frames.visible.between(0, 1, inclusive="right").all()
    assert (frames.found == np.isfinite(frames.mm)).all()
    assert frames.pictures.nunique() == 9
    pictures = {"errors.png", "times.png", "trust.png", "visible.png", "worst.jpg"}
    assert {path.name for path in out.iterdir() if path.suffix != ".json"} == pictures


@pytest.mark.parametrize("only", ["simulation package", "rig: large box"])
def test_a_run_without_any_answer_says_what_it_left_out(tmp_path, monkeypatch, only):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    printed = printed_by("accuracy", "--only", only, "--object", "cube_v2", "--scenes", 1, "-o", tmp_path)
    assert ("Left out: simulation package" in printed) is (only == "simulation package")
    assert "## Accuracy" not in printed


def test_errors_are_one_line_and_say_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmarks", "report", "-o", str(tmp_path / "nowhere")])
    for line in ("benchmarks: .*nowhere.*\n", r"benchmarks: .* -e '\.\[bench,synthetic\]'\n"):
        with pytest.raises(SystemExit) as stop:
            runpy.run_module("benchmarks", run_name="__main__")
        assert stop.value.code == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert re.fullmatch(line, err)
        monkeypatch.setitem(sys.modules, "benchmarks.program", None)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_is_no_verdict(number, code, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("benchmarks.program.measure", lambda *_, **__: signal.raise_signal(number))
    monkeypatch.setattr(sys, "argv", ["benchmarks", "gate", "-o", str(tmp_path)])
    with pytest.raises(SystemExit) as stop:
        runpy.run_module("benchmarks", run_name="__main__")
    assert (stop.value.code, capsys.readouterr().err) == (code, "benchmarks: interrupted\n")


SMALL = ("accuracy", "--quick", "--only", "realistic", "--object", "cube_v2", "--workers", 1)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((*SMALL, "-o", "letter/out"), "benchmarks: letter/out: Not a directory"),
        ((*SMALL, "-o", "out", "--cache", "letter/cache"), "benchmarks: letter/cache.*: Not a directory"),
        (("noise", "-o", "letter/noise.toml"), "benchmarks: letter/noise.toml: Not a directory"),
        ((*SMALL, "-o", "letter/out", "--workers", 0), "Error: .*--workers': 0 is not in the range.*"),
        (("noise", "--workers", -3), "Error: .*--workers': -3 is not in the range.*"),
        (("likeness", "--scenes", 0, "--real", "."), "Error: .*--scenes': 0 is not in the range.*"),
    ],
)
def test_outputs_and_workers_are_checked_before_the_work(arguments, line, tmp_path, monkeypatch, run_here):
    (tmp_path / "letter").write_text("mine")
    for name in ("measure.noise.FilmStore", "data.scenes.FrameMaker"):
        monkeypatch.setattr(f"benchmarks.{name}", lambda *_: pytest.fail("work has begun"))
    monkeypatch.setattr(sys, "argv", ["benchmarks", *map(str, arguments)])
    result = run_here(folder=tmp_path, main=lambda _: runpy.run_module("benchmarks", run_name="__main__"))
    assert (result.returncode, result.stdout) == (2, "")
    assert re.fullmatch(line, result.stderr.splitlines()[-1])
