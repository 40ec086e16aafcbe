import csv
import json
import math
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers import contents
from tests.helpers.recording_stubs import NoiseTracker, write_log
from tracker.batch import jobs, results, run, tables
from tracker.batch.results import output_of
from tracker.batch.run import Batch, only_run, read_batch, run_batch
from tracker.batch.workers import engine
from tracker.errors import LogError, TrackerError
from tracker.files import claimed, whole_file
from tracker.poses.file import read_poses
from tracker.recordings import Job, Options, Recipe
from tracker.recordings.track import fingerprint
from tracker.summaries.summary import COLUMNS

COUNT = 5
OPTIONS = Options("cube_v2", make_tracker=NoiseTracker)


@pytest.fixture
def recordings(tmp_path) -> Path:
    for number in range(COUNT):
        write_log(tmp_path / "in" / f"{number:03d}", 10 + number)
    return tmp_path / "in"


def batch_of(recordings: Path, name: str = "out", options: Options = OPTIONS) -> Batch:
    return Batch.of([f"{recordings}/*"], recordings.parent / name, options)


def do(one: Batch) -> tuple[list[dict], int]:
    """Results of the recordings that were tracked, and how many were done before."""
    results = []
    with only_run(one, one.work()):
        run_batch(one.work(), engine(1), results.append)
        tables.write_tables(one, tables.state(one), as_csv=True)
    return [result for result in results if result is not None], results.count(None)


def test_names_mirror_paths_and_depend_on_nothing_else(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for given, expected in [
        ("a/camera_data.dat", "a/camera_data.dat.poses.h5"),
        ("./a//b/", "a/b.poses.h5"),
        ("/data/x.h5", "data/x.h5.poses.h5"),
        ("../a", f"{tmp_path.parent}/a.poses.h5".lstrip("/")),
    ]:
        assert output_of(Path(given), Path("out")) == Path("out") / expected


def test_every_recording_has_a_result_and_only_what_is_broken_changed_or_missing_is_done_again(recordings):
    one = batch_of(recordings)
    tracked, before = do(one)
    assert (len(tracked), before) == (COUNT, 0)
    assert [result["frames"] for result in tracked] == [10 + number for number in range(COUNT)]
    whole = contents(one.folder)
    assert do(one) == ([], COUNT)
    assert contents(one.folder) == whole
    assert read_batch(one.folder).pairs == one.pairs
    assert not [name for name in whole if Path(name).name.startswith(".")]
    outputs = [one.folder / output for _, output in one.pairs]
    outputs[0].unlink()
    outputs[1].write_bytes(outputs[1].read_bytes()[:-50])
    results.summary_file(outputs[2]).unlink()
    tracked, before = do(one)
    assert sorted(result["frames"] for result in tracked) == [0, 10, 11]
    assert before == COUNT - 3
    assert contents(one.folder) == whole
    for later in (1, 3_600_000_000_000):  # as of poses that another run has replaced, also by a clock ahead
        stamp = results.summary_file(outputs[3]).stat().st_mtime_ns + later
        os.utime(outputs[3], ns=(stamp, stamp))
        tracked, before = do(one)
        assert ([result["frames"] for result in tracked], before) == ([0], COUNT - 1)
        assert do(one) == ([], COUNT)
    os.utime(recordings / "003" / "camera_data.dat", (0, 0))
    os.utime(recordings / "004" / "camera60.yml", (0, 0))
    tracked, _ = do(one)
    assert sorted(result["frames"] for result in tracked) == [13, 14]
    line = json.loads(results.summary_file(outputs[2]).read_text())
    wrong = {"frames": "20", "seconds": [1.0], "recording": 5, "level": 1.5, "fault": True}
    large = {"frames": 2**63, "level": -(2**64), "seconds": 10**400, "fault": "\ud800", "task": "\udfff"}
    for damage in (
        ["", "[]", "{}", "[" * 100_000, "\x00"],
        *[[json.dumps({**line, name: value}) for name, value in one.items()] for one in (wrong, large)],
    ):
        for output, content in zip(outputs, damage, strict=True):
            results.summary_file(output).write_text(content)
        assert tables.state(one).missing == COUNT
        assert [result["frames"] for result in do(one)[0]] == [0] * COUNT
    goal = [[0, [0.0, 0.0, 0.05]], [500, [0.1, 0.0, 0.08]]]
    there = recordings / "002" / "goal.json"
    there.write_text(json.dumps(goal))
    os.utime(there, (0, 0))  # copied with its old time
    for change, task in ((lambda: None, "trajectory"), (there.unlink, None)):
        change()
        tracked, before = do(one)
        assert ([result["frames"] for result in tracked], before) == ([0], COUNT - 1)
        assert tables.state(one).lines[2]["task"] == task
    tracked, _ = do(batch_of(recordings, options=Options("cube_v2", stop=4, make_tracker=NoiseTracker)))
    assert [result["frames"] for result in tracked] == [4] * COUNT


def test_results_of_other_options_do_not_count_as_done(recordings):
    do(batch_of(recordings))
    other = batch_of(recordings, options=Options("cube_v2", stop=3, make_tracker=NoiseTracker))
    with only_run(other, other.work()):
        assert tables.state(other).missing == COUNT
        run_batch(other.work()[:2], engine(1), lambda _: None)
    for one in (other, read_batch(other.folder)):
        assert [line["frames"] for line in tables.state(one).lines] == [3, 3]
    with only_run(other, other.work()):
        assert tables.state(other).missing == COUNT - 2
    assert len(do(batch_of(recordings))[0]) == COUNT


@pytest.mark.parametrize("suffix", [".h5", ""])
def test_poses_of_another_object_are_not_replaced(recordings, suffix):
    do(batch_of(recordings))
    for path in (recordings.parent / "out").rglob("*"):
        if path.is_file() and not path.name.endswith(suffix):
            path.unlink()
    before = contents(recordings.parent / "out")
    other = batch_of(recordings, options=Options("cuboid_2x2x8_v2", make_tracker=NoiseTracker))
    with pytest.raises(LogError, match=r"found poses of cube_v2, expected those of cuboid_2x2x8_v2, or anot"):
        do(other)
    assert contents(recordings.parent / "out") == before


def test_a_run_on_a_part_does_not_make_the_rest_count_as_of_its_options(recordings):
    options = Options("cube_v2", stop=3, make_tracker=NoiseTracker)
    do(batch_of(recordings))
    do(Batch.of([str(recordings / "000")], recordings.parent / "out", options))
    other = batch_of(recordings, options=options)
    with only_run(other, other.work()):
        assert [line["frames"] for line in tables.state(other).lines] == [3]


def test_results_of_other_recordings_by_the_same_names_are_not_replaced(tmp_path, monkeypatch):
    def at(place: str, stop: int | None = None, name: str = "*") -> Batch:
        monkeypatch.chdir(tmp_path / place)
        options = Options("cube_v2", stop=stop, make_tracker=NoiseTracker)
        return Batch.of([f"ep/{name}"], tmp_path / "out", options)

    for place, name in (("one", "0"), ("one", "1"), ("two", "0")):
        write_log(tmp_path / place / "ep" / name, 3)
    do(at("one"))
    do(at("one", name="1"))  # nor are those of earlier commands
    before = contents(tmp_path / "out")
    for stop in (None, 2):
        with pytest.raises(LogError, match=r"two/ep/0: found the result of .*one/ep/0 under the same name"):
            do(at("two", stop))
        assert contents(tmp_path / "out") == before
    (tmp_path / "one").rename(tmp_path / "moved")
    assert len(do(at("moved"))[0]) == 2


def test_what_fails_is_reported_with_its_reason_and_the_others_are_done(recordings, monkeypatch):
    spoilt, real, long = recordings / "001" / "camera_data.dat", run.run, ("b" * 243, "c" * 250)
    content = spoilt.read_bytes()
    spoilt.write_bytes(content[:-100])
    (recordings / "notes.txt").write_text("no recording")
    for name in long:
        write_log(recordings / name, 3)

    def failing(job):
        if "002" in str(job.log):
            raise ZeroDivisionError
        return real(job)

    monkeypatch.setattr(run, "run", failing)
    one = batch_of(recordings)
    failed = [result for result in do(one)[0] if result["failure"]]
    failures = {Path(result["recording"]).name: result["failure"] for result in failed}
    assert failures.keys() == {"001", "002", "notes.txt", *long}
    assert "001/camera_data.dat: found" in failures["001"]
    assert "ZeroDivisionError" in failures["002"]
    assert {failures[name].split(": ")[-1] for name in long} == {"File name too long"}
    reasons = json.loads((one.folder / "failures.json").read_text())
    kept = {Path(failure["recording"]).name: failure["reason"] for failure in reasons}
    assert kept == {name: failures[name] for name in ("001", "002", "notes.txt")}
    found = tables.state(one, {str(recordings / name): failures[name] for name in long})
    assert (len(found.lines), len(found.failures), found.missing) == (COUNT - 2, 5, 0)
    spoilt.write_bytes(content)
    monkeypatch.setattr(run, "run", real)
    for name in ("notes.txt", *long):
        path = recordings / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    tracked, before = do(batch_of(recordings))
    assert (len(tracked), before) == (2, COUNT - 2)
    assert not (one.folder / "failures.json").exists()
    # A reason that could not be kept is reported by its run.
    one = batch_of(recordings)
    logs = [log for log, _ in one.pairs]
    for name in ("000.poses.h5", "001.poses.h5"):
        next(one.folder.rglob(name)).unlink()
    assert tables.state(one).failures == {}
    found = tables.state(one, {logs[1]: "no space", logs[2]: "done since"})
    assert (found.failures, found.missing, len(found.lines)) == ({logs[1]: "no space"}, 1, COUNT - 2)


def test_a_result_that_another_run_is_making_is_left_to_it(recordings):
    one = batch_of(recordings)
    target = one.folder / one.pairs[1][1]
    target.parent.mkdir(parents=True)
    with claimed(target):
        tracked, _ = do(one)
    assert "another run" in tracked[1]["failure"]
    assert not results.failure_file(target).exists()


def test_what_killed_runs_left_of_its_own_files_is_removed_and_nothing_else(tmp_path):
    outputs = ("a/b.poses.h5", "a/d.poses.h5", "s.zarr/episode-00000.poses.h5")
    one = Batch(tmp_path, OPTIONS, tuple((f"/in/{output}", output) for output in outputs))
    folder = tmp_path / "a"
    own = ["a/.b.poses.h5.lock", "a/.b.poses.h5.abc_1234.tmp", "a/.b.summary.json.abc_1234.tmp"]
    own += [f".{name}.abc_1234.tmp" for name in ("batch.json", "summary.csv", "failures.json")]
    own += [f"s.zarr/.{name}.abc_1234.tmp" for name in results.OF_STORE]
    others = ["a/.mine", "a/.c.lock", "a/.c.poses.h5.lock", "a/.b.poses.h5.mine.tmp", ".cache.tmp"]
    others += ["a/.d.poses.h5.abc_1234.tmp", ".git.lock", ".other.abc_1234.tmp", "c/.b.poses.h5.lock"]
    others += ["a/.report.json.abc_1234.tmp"]
    for name in (*own, *others):
        path = tmp_path / name / "content" if name.endswith(".tmp") else tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    with claimed(folder / "d.poses.h5"), only_run(one, one.work()):
        there = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob(".*")}
        assert there == {*others, "a/.d.poses.h5.lock", ".batch.json.lock"}
        with pytest.raises(BlockingIOError, match="another run"), only_run(one, one.work()):
            pass


def test_what_a_job_is_writing_is_not_removed_by_a_run_that_begins(recordings, monkeypatch):
    one = batch_of(recordings)

    def begun_meanwhile(path, content):
        with whole_file(path) as temporary:
            temporary.write_text(content)
            run._remove_leftovers(one)

    monkeypatch.setattr(run, "write_whole", begun_meanwhile)
    assert run_batch(one.work(), engine(1), lambda _: None) == 0
    assert tables.state(one).missing == 0


def test_the_pace_is_that_of_the_last_minutes_and_takes_one_look_at_all_times():
    class Stamps(list):
        looks = 0

        def __iter__(self):
            self.looks += 1
            return super().__iter__()

    stamps = Stamps([9e8, *np.arange(1e9, 1e9 + 500, 5)])
    assert tables._rate(stamps) == pytest.approx(1 / 5)
    assert stamps.looks == 2  # thousands of recordings would take minutes otherwise
    assert tables._rate([]) is tables._rate([9e8]) is tables._rate([9e8, 1e9]) is None


def test_nobody_waits_for_results_that_are_there(tmp_path, monkeypatch):
    pairs = [(f"/none/{number}", f"{number}.poses.h5") for number in range(3000)]
    work = Batch(tmp_path, OPTIONS, tuple(pairs)).work()
    tasks = [task for task, _ in work]
    for one in tasks[:-1]:
        results.summary_file(Path(one.output)).touch()
    looked = []
    monkeypatch.setattr(run, "fingerprint", lambda job: looked.append(job) or "x")
    missing = run.unfinished(work, lambda: None)
    assert next(missing) is tasks[-1]
    assert not looked
    assert next(missing) is tasks[0]
    assert len(looked) == 1


def test_the_table_says_what_is_in_the_files_and_a_bad_goal_costs_the_score_alone(recordings):
    goal = {"difficulty": 1, "goal": {"position": [0.01, 0.01, 0.01], "orientation": [0, 0, 0, 1]}}
    bad = {
        "000": "[[0, 5]]",
        "001": "\0",
        "003": "{}",
        "005": "[[0, 0, 0.011]]",
        os.fsdecode(b"006\xe9"): "[[0, [0, 0, 1e300]]]",  # no Unicode
    }
    for name in [*bad][3:]:
        write_log(recordings / name, 10 + int(name[:3]))
    for name, content in {"002": json.dumps(goal), **bad}.items():
        (recordings / name / "goal.json").write_text(content)
    one = batch_of(recordings, os.fsdecode(b"out\xe9"))
    assert [result["failure"] for result in do(one)[0]] == [None] * 7
    with (one.folder / "summary.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["recording"] for row in rows] == [log.replace("\udce9", "\ufffd") for log, _ in one.pairs]
    poses = read_poses(one.folder / rows[2]["output"])
    assert int(rows[2]["frames"]) == len(poses) == 12
    assert float(rows[2]["share_found"]) == np.mean(poses.measured.has_pose)
    assert float(rows[2]["height_max_m"]) == poses.filtered.position[:, 2].max()
    assert float(rows[2]["position_std_median_mm"]) == pytest.approx(1.0)
    assert (rows[2]["task"], rows[2]["level"]) == ("move_object", "1")
    assert float(rows[2]["reward_mean"]) < 0
    assert [rows[4][name] for name in ("task", "goal_fault", "reward_total")] == [""] * 3
    for name in bad:
        row = rows[int(name[:3])]
        assert f"/{name}/goal.json: ".replace("\udce9", "\ufffd") in row["goal_fault"]
        assert row["reward_total"] == ""
    assert "found no goal" in rows[3]["goal_fault"]
    assert rows[0]["worst_camera"] in ("camera180", "")
    before = (one.folder / "summary.csv").read_bytes()
    (one.folder / "summary.csv").write_text("of an earlier run")
    tables.write_tables(one, tables.state(one), as_csv=False)
    assert (one.folder / "summary.csv").read_bytes() == before
    parquet = pytest.importorskip("pyarrow.parquet", reason="cluster: no module pyarrow")
    with (one.folder / "summary.parquet").open("rb") as file:
        table = parquet.read_table(file)
    assert table.column_names == list(COLUMNS)
    assert table["frames"].to_pylist() == [10, 11, 12, 13, 14, 15, 16]
    assert table["reward_mean"].to_pylist()[2] == float(rows[2]["reward_mean"])


def test_the_jobs_of_a_list_do_all_of_it_once(recordings):
    here = batch_of(recordings, "here", Options("cube_v2", stop=1))
    do(here)
    one = batch_of(recordings, options=Options("cube_v2", stop=1))
    description = jobs.describe(one, [task for task, _ in one.work()], "slurm")
    content = json.loads(description.list_text)
    content["each"] = 2
    description.write()
    listed = description.path.with_suffix(".json")
    listed.write_text(json.dumps(content))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(2)
    for number in (0, 1, 2, 1):
        assert jobs.do_share(listed, number) == 0
    assert cv2.getNumThreads() == 1
    cv2.setNumThreads(threads)
    with pytest.raises(LogError, match="found 3 jobs"):
        jobs.do_share(listed, 3)
    found = {name: data for name, data in contents(one.folder).items() if not name.startswith(".jobs")}
    assert not found.keys() & {"batch.json", "summary.csv", "summary.parquet"}
    assert found.items() <= contents(here.folder).items()
    assert len([name for name in found if name.endswith(".poses.h5")]) == COUNT
    tampered = {"options": {**content["options"], "make_tracker": "os.system"}}
    for wrong in ({"each": 0}, {"each": -1}, {"each": math.inf}, tampered):
        listed.write_text(json.dumps({**content, **wrong}))
        with pytest.raises(LogError, match="found no batch"):
            jobs.do_share(listed, 0)
    listed.write_text(json.dumps({**content, "agreed": "other"}))
    with pytest.raises(TrackerError, match="submit it again"):
        jobs.do_share(listed, 0)


def test_to_look_at_a_recording_takes_no_longer_among_many(tmp_path, monkeypatch):
    log = write_log(tmp_path / "in" / "000", 3)
    recipe = Recipe.of(OPTIONS)
    _ = recipe.digest  # looks at the sources, once
    entries = []
    for lists in (os.scandir, os.listdir):
        monkeypatch.setattr(os, lists.__name__, lambda path, lists=lists: entries.append(path) or lists(path))
    for given in (log, log.parent):
        fingerprint(Job(given, tmp_path / "out.h5", recipe))
    assert set(entries) == {log.parent}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("batch.json", "batch.json: found no batch"),
        *[
            (name, f"found {name}, but no batch")
            for name in (
                *("summary.csv", "ep/1.summary.json", "ep/1.failed.json"),
                *("a.zarr/report.json", "a.zarr/images.parquet", "a.zarr/steps.parquet"),
            )
        ],
        ("a.zarr/poses.zarr/mine", "found a.zarr/poses.zarr, but no batch"),
    ],
)
def test_files_of_others_by_a_batchs_names_stay(tmp_path, name, message):
    outputs = ("ep/1.poses.h5", "a.zarr/episode-00000.poses.h5")
    one = Batch(tmp_path, OPTIONS, tuple((f"/in/{output}", output) for output in outputs))
    (one.folder / name).parent.mkdir(parents=True, exist_ok=True)
    (one.folder / name).write_text('{"mine": 1}')
    before = contents(one.folder)
    with pytest.raises(LogError, match=message), only_run(one, one.work()):
        pass
    assert contents(one.folder) == before
