import io
import json
import os
import re
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from tests.helpers import contents, robot_stores
from tests.helpers.command import assert_one_line_error
from tests.helpers.pose_logs import answer, make_about, moved, random_pose
from tests.helpers.recording_stubs import NoiseTracker, tiny_rig
from tests.helpers.robot_stores import SHOWN, STEPS, KnowingTracker, position, write
from tests.logs.test_datasets import edit, head
from tracker.batch.results import OF_STORE
from tracker.batch.run import only_run, run_batch
from tracker.batch.stores import Retracking, _taken
from tracker.batch.workers import engine
from tracker.errors import LogError
from tracker.poses.file import PosesBuilder, read_poses
from tracker.recordings import Options
from tracker.summaries.against_stored import delay

pytest.importorskip("lmdb", reason="datasets: no module lmdb")
pytest.importorskip("numcodecs", reason="datasets: no module numcodecs")
pq = pytest.importorskip("pyarrow.parquet", reason="cluster: no module pyarrow")


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return robot_stores.write_robots(tmp_path_factory.mktemp("robots"))


def do(store: Path, folder: Path, robots: Path, **options) -> tuple[list[dict | None], dict]:
    """Results of the episodes, None of those that were done before, and the report."""
    asked = Options("cube_v2", calibration=(str(robots),), make_tracker=KnowingTracker, **options)
    plan, results = Retracking.of([str(store)], folder, asked), []
    with only_run(plan, plan.work()):
        run_batch(plan.work(), engine(1), results.append)
        reports = plan.write_tables()
    return results, reports.get(str(store), {})


def place(store: Path, folder: Path) -> Path:
    return folder / store.relative_to(store.anchor)


def read_array(folder: Path) -> np.ndarray:
    """As the format's description says, of arrays that are one block."""
    about = json.loads((folder / ".zarray").read_text())
    assert (about["compressor"], about["order"], about["zarr_format"]) == (None, "C", 2)
    (block,) = (path for path in folder.iterdir() if path.name[0] != ".")
    assert set(block.name.split(".")) == {"0"}
    return np.fromfile(block, about["dtype"]).reshape(about["chunks"])


@pytest.mark.parametrize("task", ["push", "lift"])
@pytest.mark.parametrize("by_zarr", [False, True])
def test_episodes_have_their_robots_cameras_and_tables_fit_the_store(task, by_zarr, robots, tmp_path):
    store = write(tmp_path / "a.zarr", task, by_zarr=by_zarr)
    folder = tmp_path / os.fsdecode(b"out\xe9")  # no Unicode
    results, report = do(store, folder, robots)
    found = place(store, folder)
    assert [result["failure"] for result in results] == [None] * 3
    for number, (first, last, robot) in enumerate(robot_stores.EPISODES):
        poses = read_poses(found / f"episode-{number:05d}.poses.h5")
        np.testing.assert_array_equal(poses.index, np.arange(first // 5, last // 5))
        focal = tiny_rig()[0].matrix[0, 0]
        assert poses.about.rig[0].matrix[0, 0] == pytest.approx(focal * (1 + robot / 100))
    group = found / "poses.zarr"
    shapes = {"object_position": (3,), "object_orientation": (4,), "object_keypoints": (8, 3)}
    for name, shape in {**shapes, "confidence": (1,), "covariance": (6, 6)}.items():
        by_step, by_image = read_array(group / name), read_array(group / "images" / name)
        assert (by_step.shape, by_image.shape) == ((STEPS, *shape), (STEPS // 5, *shape))
        np.testing.assert_array_equal(by_step, by_image[SHOWN])
    expected = position(np.arange(STEPS // 5) / 10)
    expected[10] = np.nan
    np.testing.assert_allclose(read_array(group / "images" / "object_position"), expected, atol=1e-7)
    tables = [io.BytesIO((found / f"{name}.parquet").read_bytes()) for name in ("images", "steps")]
    images, steps = map(pq.read_table, tables)
    assert (images.num_rows, steps.num_rows) == (STEPS // 5, STEPS)
    assert steps["robot"].to_pylist() == [
        f"r{r}" for first, last, r in robot_stores.EPISODES for _ in range(first, last)
    ]
    assert images["robot_position_3_rad"].to_pylist()[4] == pytest.approx(20.3)
    assert images["filtered_covariance"].to_pylist()[0][:1] == [pytest.approx(1e-6)]
    assert steps["filtered_x_m"].to_pylist()[50:55] == [None] * 5
    assert report == json.loads((found / "report.json").read_text())
    assert (report["task"], list(report["robots"]), len(report["episodes"])) == (task, ["r1", "r3"], 3)
    r1, r3 = report["robots"]["r1"], report["robots"]["r3"]
    assert r1["delay_s"] == pytest.approx(robot_stores.LATE, abs=0.005)
    assert r3["bias_mm"][2] == pytest.approx(-6, abs=0.01)
    assert (r1["share_turned"], r1["stored_flips"], r1["flips"]) == (1 / 20, 2, 0)
    assert (r3["share_turned"], r3["stored_flips"]) == (0, 0)
    assert r1["stored_delay_s"] == pytest.approx(0.12)
    assert (repr(r1["frames"]), repr(r3["frames"])) == ("20", "24")


def test_images_that_no_step_saw_have_no_first_step_and_no_state_of_the_robot(robots, tmp_path):
    store, folder = write(tmp_path / "a.zarr", shown=3 * np.where(SHOWN == 4, 3, SHOWN)), tmp_path / "out"
    do(store, folder, robots)
    images = pq.read_table(place(store, folder) / "images.parquet")
    for name in ("first_step", "robot_position_0_rad"):
        assert images[name].to_pylist()[2:6] == [10, 15, None, 25]
    assert str(images["first_step"].type) == "int64"


@pytest.mark.parametrize("predicted", [False, True])
def test_what_moves_while_it_is_not_found_does_not_count_for_the_delay(predicted, rng):
    builder = PosesBuilder(make_about())
    for number, time in enumerate(np.arange(300) / 10):
        found, pose = time % 4 < 2.6, random_pose(rng, moving=True)
        last = time if found else time // 4 * 4 + 2.5
        pose.position = position(last)
        # The platform's own tracker repeats its last pose of an object that it does not see.
        stored = moved(np.eye(3), position((time if predicted else last) - robot_stores.LATE))
        ours = pose if found or predicted else None
        builder.append(number, time, answer(None, ours, "tracking" if found else "coasting"), stored)
    assert delay([builder.build()]) == pytest.approx(robot_stores.LATE, abs=0.005)


@pytest.mark.parametrize(("end", "shown"), [(7.0, True), (15.0, False)])
def test_a_delay_is_told_of_a_push_that_ends_and_not_of_even_motion(end, shown, rng):
    for _ in range(5):
        builder = PosesBuilder(make_about())
        for number, time in enumerate(np.arange(150) / 10):
            pose, late = random_pose(rng, moving=True), np.array([0.0, robot_stores.LATE])
            x, stored = np.interp(time - late, [end - 15, end], [0.0, 0.3])
            pose.position = np.array([x, 0.0, 0.03]) + rng.normal(0, 1e-4, 3)
            old = moved(np.eye(3), np.array([stored, 0.0, 0.03]) + rng.normal(0, 1e-3, 3))
            builder.append(number, time, answer(None, pose, "tracking"), old)
        found = delay([builder.build()])
        assert found == (pytest.approx(robot_stores.LATE, abs=0.03) if shown else None)


AT_REST = {"position": lambda t: np.broadcast_to([0.0, 0.0, 0.03], (*np.shape(t), 3))}


@pytest.mark.parametrize(
    ("changed", "within"), [(AT_REST, 1), ({"LATE": -0.12}, None), ({"LATE": 0.8}, None)]
)
def test_no_delay_is_told_at_rest_or_beyond_those_that_are_tried(changed, within, tmp_path, robots):
    with mock.patch.multiple(robot_stores, **changed):
        _, report = do(write(tmp_path / "a.zarr"), tmp_path / "out", robots)
    assert report["robots"]["r1"]["delay_s"] is None
    assert within in (None, report["robots"]["r1"]["share_within_5mm"])


@pytest.mark.parametrize(("blocks", "left"), [(range(9), 32), (range(9, 24), 24)])
def test_an_episode_without_a_readable_image_keeps_no_table_from_the_others(blocks, left, robots, tmp_path):
    store, folder = write(tmp_path / "a.zarr"), tmp_path / "out"
    for block in blocks:
        edit(store, f"images/{block}", lambda data: b"damaged")
    results, report = do(store, folder, robots, recover=True)
    assert [result["failure"] for result in results] == [None] * 3
    assert len(report["episodes"]) == 2
    assert pq.read_table(place(store, folder) / "images.parquet").num_rows == left
    assert pq.read_table(place(store, folder) / "steps.parquet").num_rows == STEPS


def test_zarr_itself_reads_the_group(robots, tmp_path):
    zarr = pytest.importorskip("zarr", reason="zarr: no module zarr")
    do(write(tmp_path / "a.zarr"), tmp_path / "out", robots)
    group = zarr.open_group(str(place(tmp_path / "a.zarr", tmp_path / "out") / "poses.zarr"), mode="r")
    np.testing.assert_allclose(group["object_position"][5], position(0.1), atol=1e-7)
    assert np.isnan(group["images"]["object_keypoints"][10]).all()


def test_an_interrupted_run_goes_on_with_the_missing_episodes(robots, tmp_path, monkeypatch):
    store = write(tmp_path / "a.zarr")
    do(store, tmp_path / "whole", robots)
    real = KnowingTracker.update

    def interrupted(self, images, timestamp):
        if timestamp > 2:
            raise KeyboardInterrupt
        return real(self, images, timestamp)

    monkeypatch.setattr(KnowingTracker, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        do(store, tmp_path / "out", robots)
    assert not list((tmp_path / "out").rglob("*.parquet"))
    monkeypatch.setattr(KnowingTracker, "update", real)
    results, _ = do(store, tmp_path / "out", robots)
    assert sorted(result is None for result in results) == [False, False, True]
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    again, _ = do(store, tmp_path / "out", robots)
    assert again == [None] * 3
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_tables_of_results_that_are_replaced_do_not_stay(robots, tmp_path):
    store, folder = write(tmp_path / "a.zarr"), tmp_path / "out"
    do(store, folder, robots)
    tables = [place(store, folder) / name for name in OF_STORE]
    assert all(path.exists() for path in tables)
    assert do(store, folder, robots)[0] == [None] * 3
    assert all(path.exists() for path in tables)
    edit(store, "images/12", lambda data: data[:-9])
    results, report = do(store, folder, robots, start=8)
    assert (sum(result["failure"] is not None for result in results), report) == (1, {})
    assert not any(path.exists() for path in tables)


@pytest.mark.parametrize("made", [False, True])
def test_a_store_that_is_none_is_named_before_the_calibration(robots, tmp_path, run_here, made):
    if made:
        (tmp_path / "a.zarr").mkdir()
    options = ("--object", "cube_v2", "--calibration", robots, "-o", tmp_path / "out")
    result = run_here("batch", "run", tmp_path / "a.zarr", *options)
    assert result.returncode == 2
    assert re.search(r"a\.zarr: found (nothing|no image store) there", result.stderr), result.stderr


def test_results_are_never_inside_of_a_store(robots, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a.zarr")
    asked = Options("cube_v2", calibration=(str(robots),))
    with pytest.raises(LogError, match=r"a\.zarr: found its results inside of it in \.; expected another"):
        Retracking.of(["a.zarr"], Path(), asked)
    assert Retracking.of(["a.zarr"], Path("out"), asked).pairs


def test_all_nan_of_an_array_have_the_same_bits():
    computed = np.array([[1.0, -np.nan], [np.nan, -2.0]])
    taken = _taken(computed, np.array([1, -1, 0]))
    np.testing.assert_array_equal(taken, [[np.nan, -2.0], [np.nan, np.nan], [1.0, np.nan]])
    assert len(np.unique(taken[np.isnan(taken)].view(np.int64))) == 1


OTHER = robot_stores.observations("push")


def with_robots(numbers) -> np.ndarray:
    rows = OTHER.copy()
    rows[:, 78] = numbers
    return rows


def test_stored_values_that_are_not_finite_are_left_out(robots, tmp_path):
    rows = OTHER.copy()
    rows[10, 12], rows[15, 13] = np.inf, np.nan  # confidence and delay
    _, report = do(write(tmp_path / "a.zarr", observations=rows), tmp_path / "out", robots)
    assert report["episodes"][0]["share_only_found"] == pytest.approx(1 / 12)
    assert report["episodes"][0]["stored_delay_s"] == pytest.approx(0.12)


@pytest.mark.parametrize(
    ("changes", "damage", "message"),
    [
        ({"observations": None}, None, "found none with a robot_id, expected 97 numbers .* --robot"),
        ({"observations": OTHER[:, :96]}, None, "found none with a robot_id"),
        ({"observations": with_robots(2)}, None, "episode 0: found robot r2, expected .*r1, r3; --robot"),
        ({"observations": with_robots(SHOWN)}, None, "episode 0: robot_id: found 0, 1, 2, 3, 4, expected"),
        ({"observations": with_robots(np.nan)}, None, "episode 0: robot_id: found nan"),
        ({"observations": OTHER[:-1]}, None, f"observations: found {STEPS - 1} steps, expected {STEPS}"),
        ({}, ("observations/1.0", lambda data: data[:-1]), "observations: block 1.0: found 1399 bytes"),
        ({}, ("observations/.zarray", head(chunks=[0, 50])), "observations: .zarray: .* expected zarr 2"),
        ({}, ("obs_to_image_index/.zarray", lambda data: None), "obs_to_image_index is missing"),
    ],
)  # fmt: skip
def test_a_damaged_store_is_one_error_and_leaves_nothing(
    changes, damage, message, robots, tmp_path, run_here
):
    store = write(tmp_path / "a.zarr", **changes)
    if damage is not None:
        edit(store, *damage)
    base = ["batch", "run", store, "--calibration", robots, "--object", "cube_v2", "-o", tmp_path / "out"]
    result = run_here(*base, "--jobs", 1)
    assert_one_line_error(result, "a.zarr")
    assert re.search(message, result.stderr), result.stderr
    assert not (tmp_path / "out").exists()


def test_the_command_tracks_a_named_robot_and_reports_a_damaged_episode(
    robots, tmp_path, run_here, monkeypatch
):
    monkeypatch.setattr("tracker.cli.batch.processes", lambda _: engine(1))
    monkeypatch.setattr("tracker.recordings.Options", partial(Options, make_tracker=NoiseTracker))
    store, folder = write(tmp_path / "a.zarr", observations=with_robots(2)), tmp_path / "out"
    base = ["batch", "run", store, "--calibration", robots, "--object", "cube_v2", "-o", folder]
    done = run_here(*base, "--robot", "r1", "--from", 8, "--to", 14)
    assert (done.returncode, done.stderr) == (0, "")
    assert "within 5 mm" in done.stdout
    assert "\nr1 " in done.stdout
    assert read_array(place(store, folder) / "poses.zarr" / "object_position").shape == (STEPS, 3)
    pattern = run_here("batch", "run", f"{tmp_path}/**/*.zarr", *base[3:], "--robot", "r1", "--to", 14, "-q")
    assert (pattern.returncode, pattern.stderr) == (0, "")
    edit(store, "images/12", lambda data: data[:-9])
    failed = run_here(*base, "--robot", "r1", "-q", "-o", tmp_path / "two")
    assert failed.returncode == 2
    assert failed.stderr.startswith("tracker: 1 of 3 recordings failed, see ")
    reasons = json.loads((tmp_path / "two" / "failures.json").read_text())
    assert [one["recording"] for one in reasons] == [f"{store}: episode 1"]
    assert not list((tmp_path / "two").rglob("images.parquet"))
    status = json.loads(run_here("batch", "status", tmp_path / "two", "--json").stdout)
    assert (status["done"], status["failed"]) == (2, 1)
    twice = ["batch", "run", store, store, *base[3:], "--robot", "r1"]
    assert_one_line_error(run_here(*twice), "expected each recording once")
    for wrong, words in [("r9", "--robot: found r9"), ("", "expected one of r1, r3")]:
        assert_one_line_error(run_here(*base, "--robot", wrong), words)
