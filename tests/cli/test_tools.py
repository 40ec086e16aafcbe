import json
from dataclasses import replace

import numpy as np
import pytest

import tracker
from tests.helpers import make_rig
from tests.helpers.command import assert_one_line_error, well
from tests.helpers.log_writers import CAMERAS, make_content, write_native
from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import make_job, tiny_rig, write_log
from tests.logs.test_folders import write_triplets, write_truth
from tests.logs.test_native import assert_same, with_errors
from tracker.errors import LogError
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.objects.model import load_object, to_toml
from tracker.poses.exports import write_bop, write_csv, write_tum
from tracker.poses.file import write_poses
from tracker.recordings import run
from tracker.tasks import move_object, rearrange_dice
from tracker.tasks.job_goal import read_job_goal
from tracker.tasks.move_object import keypoints

FRAMES = 8


@pytest.fixture
def poses(rng, tmp_path):
    poses = random_poses(rng, 20)
    write_poses(tmp_path / "poses.h5", poses)
    return poses


def test_info_tells_what_is_in_a_recording(tmp_path, run_here):
    write_log(tmp_path / "log", FRAMES)
    found = json.loads(run_here("info", tmp_path / "log", "--json").stdout)
    assert found["format"] == "native camera log, with poses"
    assert (found["frames"], found["readable"], found["recorded_poses"]) == (FRAMES, FRAMES, FRAMES - 1)
    assert found["cameras"] == found["calibration"] == ["camera60", "camera180", "camera300"]
    assert (found["sizes_px"], found["rate_hz"], found["gaps"]) == ([[28, 24]] * 3, 10.0, 0)
    assert found["seconds"] == pytest.approx(0.1 * (FRAMES - 1))
    assert found["calibration_fault"] is found["fault"] is None
    shown = run_here("info", tmp_path / "log").stdout
    assert "rate hz" in shown
    assert "28×24, 28×24, 28×24" in shown


def test_info_tells_gaps_damage_and_what_is_wrong_with_a_calibration(tmp_path, run_here):
    content = make_content(FRAMES)
    content.stamps[5:] += 2.0
    content.camera_stamps[5:] += 2.0
    log = write_native(tmp_path / "camera_data.dat", content)
    tracker.CameraRig(tuple(camera.resized(56, 48) for camera in tiny_rig())).save(tmp_path)
    log.write_bytes(log.read_bytes()[:-100])
    assert_one_line_error(run_here("info", log), "camera_data.dat")
    found = json.loads(run_here("info", log, "--recover", "--json").stdout)
    assert (found["gaps"], found["longest_gap_s"]) == (1, pytest.approx(2.1))
    assert found["readable"] == FRAMES - 1
    assert found["fault"]
    assert "56×48" in found["calibration_fault"]
    inverse = (replace(one, camera_from_world=np.linalg.inv(one.camera_from_world)) for one in tiny_rig())
    tracker.CameraRig(tuple(inverse)).save(tmp_path)
    found = json.loads(run_here("info", log, "--recover", "--json").stdout)
    assert found["calibration"] == ["camera60", "camera180", "camera300"]
    assert "the arena in few or no images" in found["calibration_fault"]


def test_info_tells_what_is_in_a_file_of_poses(poses, tmp_path, run_here):
    found = json.loads(run_here("info", tmp_path / "poses.h5", "--json").stdout)
    assert (found["format"], found["object"], found["frames"]) == ("file of poses", "cube_v2", 20)
    assert found["measured"] == poses.measured.has_pose.sum()
    assert sum(found["statuses"].values()) == 20
    assert "tracking" in run_here("info", tmp_path / "poses.h5").stdout


def test_exports_are_those_of_tracking(poses, tmp_path, run_here):
    files = ["--csv", "a.csv", "--tum", "a.tum", "--bop", "b.csv", "--camera", "camera180"]
    well(run_here("export", "poses.h5", *files, folder=tmp_path))
    write_csv(tmp_path / "a2.csv", poses)
    write_tum(tmp_path / "a2.tum", poses)
    write_bop(tmp_path / "b2.csv", poses, make_rig()[1])
    for one, two in (("a.csv", "a2.csv"), ("a.tum", "a2.tum"), ("b.csv", "b2.csv")):
        assert (tmp_path / one).read_bytes() == (tmp_path / two).read_bytes()


def test_parquet_and_data_frames_hold_the_bits_of_the_csv(poses, tmp_path, run_here):
    pandas = pytest.importorskip("pandas", reason="bench: no module pandas")
    pytest.importorskip("pyarrow", reason="cluster: no module pyarrow")
    run_here("export", "poses.h5", "--parquet", "a.parquet", "--csv", "a.csv", folder=tmp_path)
    table = pandas.read_parquet(tmp_path / "a.parquet")
    text = pandas.read_csv(tmp_path / "a.csv", float_precision="round_trip", keep_default_na=True)
    names = list(poses.table())
    assert list(table.columns) == names
    frame = poses.to_dataframe()
    for name in names[3:-1]:
        np.testing.assert_array_equal(table[name].to_numpy(), text[name].to_numpy())
        np.testing.assert_array_equal(frame[name].to_numpy(), text[name].to_numpy())
    assert frame.index.tolist() == poses.index.tolist()
    assert frame["status"].tolist() == table["status"].tolist() == poses.status.tolist()


def test_keypoints_are_columns_on_request(poses, tmp_path, run_here):
    pandas = pytest.importorskip("pandas", reason="bench: no module pandas")
    model = load_object("cube_v2")
    well(run_here("export", "poses.h5", "--csv", "a.csv", "--keypoints", folder=tmp_path))
    table = pandas.read_csv(tmp_path / "a.csv", float_precision="round_trip")
    names = list(poses.table())
    assert list(table.columns[: len(names)]) == names
    assert len(table.columns) == len(names) + 3 * 24
    expected = keypoints(poses.filtered.position, poses.filtered.orientation, model.size)
    found = table[[f"filtered_keypoint{i}_{axis}_m" for i in range(8) for axis in "xyz"]]
    np.testing.assert_allclose(found.to_numpy().reshape(-1, 8, 3), expected, atol=1e-15)
    assert poses.to_dataframe(model)["measured_keypoint7_z_m"].notna().sum() == poses.measured.has_pose.sum()
    mine = replace(poses, about=replace(poses.about, object_name="mine"))
    write_poses(tmp_path / "own.h5", mine)
    result = run_here("export", "own.h5", "--csv", "c.csv", "--keypoints", folder=tmp_path)
    assert_one_line_error(result, "--object", "TOML file of 'mine'", "own.h5")
    (tmp_path / "mine.toml").write_text(to_toml(replace(model, name="mine", size=model.size / 2)))
    other = ["--keypoints", "--object", "mine.toml"]
    well(run_here("export", "own.h5", "--csv", "b.csv", *other, folder=tmp_path))
    assert (tmp_path / "a.csv").read_bytes() != (tmp_path / "b.csv").read_bytes()
    with pytest.raises(LogError, match="keypoints: found 'cube_v2', expected CuboidModel"):
        poses.table("cube_v2")


def test_an_xarray_holds_whole_arrays_along_the_frames(poses):
    pytest.importorskip("xarray", reason="xarray: no module xarray")
    found = poses.to_xarray(load_object("cube_v2"))
    assert found["filtered_keypoints"].dims == ("frame", "keypoint", "axis")
    assert found["filtered_keypoints"].shape == (20, 8, 3)
    assert found["filtered_covariance"].dims == ("frame", "twist", "twist_too")
    assert found["frame"].values.tolist() == poses.index.tolist()
    for kind, columns in (("measured", poses.measured), ("filtered", poses.filtered)):
        for name, array in columns.arrays().items():
            np.testing.assert_array_equal(found[f"{kind}_{name}"].values, array)
    heights = found["filtered_position"].sel(axis="z").values
    np.testing.assert_array_equal(heights, poses.filtered.position[:, 2])
    used = found["cameras"].sel(camera="camera180").values
    assert used.tolist() == poses.cameras[:, poses.about.rig.names.index("camera180")].tolist()
    assert found.attrs["object_name"] == poses.about.object_name


def test_a_log_becomes_a_film_also_with_its_poses(tmp_path, run_here):
    av = pytest.importorskip("av", reason="video: no module av")
    run(make_job(write_log(tmp_path / "job", FRAMES), tmp_path / "own.h5"))
    well(run_here("convert", "job", "-o", "new.mp4", folder=tmp_path))
    with av.open(str(tmp_path / "new.mp4")) as film:
        pictures = [frame.to_ndarray(format="bgr24") for frame in film.decode(video=0)]
    assert [picture.shape for picture in pictures] == [(24, 84, 3)] * FRAMES
    well(run_here("export", "own.h5", "--video", "film.mp4", "--log", "job", folder=tmp_path))
    assert (tmp_path / "film.mp4").stat().st_size > 1000


def test_frames_that_a_folder_does_not_keep_are_counted(tmp_path, run_here):
    log = write_log(tmp_path / "job", FRAMES)
    result = run_here("convert", "job", "-o", "same", folder=tmp_path)
    assert "warning" not in well(result).stderr
    write_native(log, with_errors([3], FRAMES))
    result = well(run_here("convert", "job", "-o", "fewer", folder=tmp_path))
    assert f"{FRAMES} frames become {FRAMES - 1}" in result.stderr


def test_a_film_draws_each_cameras_view_in_its_own_image_in_whatever_order(tmp_path, run_here, monkeypatch):
    pytest.importorskip("av", reason="video: no module av")
    run(make_job(write_log(tmp_path / "job", FRAMES), tmp_path / "own.h5"))
    with tracker.open_log(tmp_path / "job") as log:
        names, turned = log.rig.names, replace(log.rig, cameras=log.rig.cameras[::-1])
        with Hdf5LogWriter(tmp_path / "turned.h5", turned) as writer:
            for frame in log:
                writer.append(frame.raw[::-1], frame.timestamp, frame.camera_timestamps[::-1])
    drawn, overlay = [], tracker.viz.overlay

    def noted(images, rig, *rest, **options):
        drawn.append(rig.names)
        return overlay(images, rig, *rest, **options)

    monkeypatch.setattr(tracker.viz, "overlay", noted)
    well(run_here("export", "own.h5", "--video", "film.mp4", "--log", "turned.h5", folder=tmp_path))
    assert set(drawn) == {names[::-1]}


def test_a_log_becomes_hdf5_with_all_its_bits(tmp_path, run_here):
    log = write_log(tmp_path / "log", FRAMES)
    well(run_here("convert", log, "-o", tmp_path / "new.h5"))
    content = make_content(FRAMES)
    with tracker.open_log(tmp_path / "new.h5") as found:
        assert found.format == "HDF5 camera log, version 2.1, with poses"
        assert found.camera_names == CAMERAS
        assert_same(found, content, poses=1)
        assert np.array_equal([frame.raw for frame in found], content.raw)
        for old, new in zip(tiny_rig(), found.rig, strict=True):
            np.testing.assert_allclose(old.camera_from_world, new.camera_from_world, atol=1e-12)


@pytest.mark.parametrize(("part", "warned"), [((), True), (("--from", 1, "--to", 2), False)])
def test_converting_unrelated_scenes_says_that_they_become_one_recording(part, warned, tmp_path, run_here):
    scenes = write_triplets(tmp_path / "scenes", ["000000", "000001"])
    make_rig(30, 20).save(scenes)
    write_truth(scenes, {"000000": 0.0, "000001": 0.1}, sequence=False)
    result = well(run_here("convert", scenes, "-o", tmp_path / "new.h5", *part))
    assert ("2 episodes become one recording" in result.stderr) == warned


def test_a_log_becomes_a_folder_and_a_part_of_one(tmp_path, run_here):
    log = write_log(tmp_path / "log", FRAMES)
    well(run_here("convert", log, "-o", tmp_path / "new", "--from", 2, "--to", 6))
    with tracker.open_log(log) as one, tracker.open_log(tmp_path / "new") as two:
        assert len(two) == 4
        assert two.rig is not None
        for old, new in zip(one[2:6], two, strict=True):
            assert (np.array(old.images) == np.array(new.images)).all()
            np.testing.assert_allclose(old.camera_timestamps, new.camera_timestamps, atol=1e-6)


def test_the_score_is_the_sum_of_the_rewards(poses, tmp_path, run_here):
    goal = {"difficulty": 4, "goal": {"position": [0.1, 0, 0.05], "orientation": [0, 0, 0, 1]}}
    (tmp_path / "goal.json").write_text(json.dumps(goal))
    found = json.loads(run_here("score", tmp_path, "--poses", tmp_path / "poses.h5", "--json").stdout)
    own, seen = poses.filtered, poses.filtered.has_pose
    asked = ([0.1, 0, 0.05], own.position[seen], [0, 0, 0, 1], own.orientation[seen])
    expected = move_object.reward(4, *asked)
    assert [value for value in found["rewards"] if value is not None] == pytest.approx(expected.tolist())
    assert found["scored_frames"] == seen.sum()
    assert found["reward_mean"] * 1000 * 2.0 == pytest.approx(found["reward_total"], rel=1e-5)
    assert "move_object" in run_here("score", tmp_path, "--poses", tmp_path / "poses.h5").stdout


def test_dice_are_scored_over_a_whole_recording(tmp_path, run_here):
    log = write_log(tmp_path / "job", 3)
    (tmp_path / "job" / "goal.json").write_text(json.dumps([[0.0, 0.0, 0.011]] * 25))
    found = json.loads(run_here("score", tmp_path / "job", "--json").stdout)
    masks = rearrange_dice.goal_masks(tiny_rig(), np.tile([0.0, 0.0, 0.011], (25, 1)))
    with tracker.open_log(log) as opened:
        dice = [[rearrange_dice.segment_dice(image) for image in frame.images] for frame in opened]
    errors = [rearrange_dice.error(masks, seen) for seen in dice]
    assert found["task"] == "rearrange_dice"
    assert found["rewards"] == [-error for error in errors]
    assert found["error_end"] == errors[-1]


def test_while_an_object_is_unseen_a_new_goal_counts_for_its_last_pose(rng, tmp_path, run_here):
    poses = random_poses(rng, 20, share=[1] * 10 + [0] * 10)
    there = poses[:10]
    write_poses(tmp_path / "poses.h5", poses)
    place = there.filtered.position[-1]
    # A frame takes 100 control steps, and the second goal begins in the middle of one.
    goal = [[0, place.tolist()], [1350, (place + np.array([0.1, 0.0, 0.0])).tolist()]]
    (tmp_path / "goal.json").write_text(json.dumps({"_goal": goal}))
    found = json.loads(run_here("score", tmp_path, "--poses", tmp_path / "poses.h5", "--json").stdout)
    assert found["rewards"][10:] == [None] * 10
    expected = move_object.trajectory_reward([(0, goal[0][1])], 0, there.filtered.position)
    new = move_object.trajectory_reward([(0, goal[1][1])], 0, place)
    assert found["error_end"] == pytest.approx(-new)
    assert found["reward_total"] == pytest.approx(100 * (expected.sum() + 6.5 * new), rel=1e-6)


@pytest.mark.parametrize("every", [1, 2, 4])
def test_the_total_of_dice_is_that_of_the_whole_time_however_few_frames_are_looked_at(
    every, tmp_path, monkeypatch, run_here
):
    write_log(tmp_path / "job", FRAMES)
    (tmp_path / "job" / "goal.json").write_text(json.dumps([[0.0, 0.0, 0.011]] * 25))
    everywhere = np.ones((24, 28), bool)
    monkeypatch.setattr(rearrange_dice, "segment_dice", lambda image: everywhere)
    found = json.loads(run_here("score", tmp_path / "job", "--json", "--every", every).stdout)
    assert (found["frames"], found["scored_frames"]) == (FRAMES, -(-FRAMES // every))
    whole = json.loads(run_here("score", tmp_path / "job", "--json").stdout)
    assert found["reward_total"] == pytest.approx(whole["reward_total"])


def test_a_frame_without_images_of_all_cameras_gets_no_reward_of_dice(tmp_path, run_here):
    image = np.full((24, 28, 3), 90, np.uint8)
    with Hdf5LogWriter(tmp_path / "camera_data.h5", tiny_rig()) as writer:
        for stamp, images in ((1.0, [image] * 3), (1.1, [None] * 3), (1.2, [None, image, image])):
            writer.append(images, stamp)
    (tmp_path / "goal.json").write_text(json.dumps([[0.0, 0.0, 0.011]] * 25))
    found = json.loads(run_here("score", tmp_path, "--json").stdout)
    assert found["rewards"] == [0.0, None, None]
    assert found["scored_frames"] == 1


@pytest.mark.parametrize(
    ("content", "task"),
    [
        ([[0, [0, 0, 0.05]], [30000, [0.1, 0, 0.08]]], "trajectory"),
        ({"_goal": [[0, [0, 0, 0.05]]]}, "trajectory"),
        ({"goal": [[0, 0, 0.011]] * 25}, "rearrange_dice"),
        ({"difficulty": 1, "goal": {"position": [0, 0, 0.03], "orientation": [0, 0, 0, 1]}}, "move_object"),
    ],
)
def test_goals_of_every_task_are_read(content, task, tmp_path):
    (tmp_path / "goal.json").write_text(json.dumps(content))
    assert read_job_goal(tmp_path / "goal.json").task == task


@pytest.mark.parametrize(
    "content",
    [
        *["", "3", "{}", "[]", "[[1]]", '[["a", [0, 0, 0]]]', "[[5, [0, 0, 0]]]", "[[0, 5]]", "[[0, null]]"],
        *["[[[0, 1], [0, 0, 0]]]", "[[0.1, 0, 0]]", "[[0, [NaN, 0, 0]]]", "[" * 100_000],
        f"[[0, [1{'0' * 400}, 0.5, 0]]]",
        '{"difficulty": [1], "goal": {"position": [0, 0, 0]}}',
        '{"goal": {"position": 3}}',
        '{"difficulty": 4, "goal": {"position": [0, 0, 0]}}',
        '{"difficulty": 7, "goal": {"position": [0, 0, 0]}}',
        '{"difficulty": 4, "goal": {"position": [0, 0, 0], "orientation": [0, 0, 0, 0]}}',
        '{"difficulty": 4, "goal": {"position": [0, 0, 0], "orientation": [0, 0, true, 1]}}',
        '{"difficulty": 1, "goal": {"position": [true, 0.5, 1]}}',
        *["[[0, [true, 0.5, 1]]]", "[[false, [0, 0, 0.5]]]"],
    ],
)
def test_what_is_no_goal_is_refused(content, tmp_path):
    (tmp_path / "goal.json").write_text(content)
    with pytest.raises(tracker.TrackerError, match=r"goal\.json: "):
        read_job_goal(tmp_path / "goal.json")
