import dataclasses
import itertools
import json
import re
import shutil

import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import RIG, look_at, nudged
from tests.helpers.filmed import on_wood
from tests.helpers.kept_stills import bare
from tests.helpers.log_writers import CAMERAS
from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import make_job, write_log
from tracker.cli.demo import DATA as DEMO
from tracker.errors import LogError
from tracker.geometry import so3
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.objects.model import load_object
from tracker.pose.result import CameraUse, Observation, PoseEstimate, Status
from tracker.poses.poses import Poses
from tracker.recordings import Tracked, run
from tracker.recordings.track import Job, Options, Recipe
from tracker.summaries import remarks, summary
from tracker.tasks.job_goal import JobGoal

FRAMES = 20
NOTHING = {"contradicting": 0.0, "no_image": 0.0, "frozen": 0.0, "black": 0.0}


def test_the_summary_counts_what_is_there(tmp_path):
    tracked = run(make_job(write_log(tmp_path, FRAMES), tmp_path / "poses.h5"))
    numbers = summary.summary(tracked)
    measured = float(np.mean(tracked.poses.measured.has_pose))
    assert numbers["frames"] == FRAMES
    assert numbers["measured"] == numbers["statuses"]["found"]["share"] == measured
    assert numbers["statuses"]["poor_fit"] == {"share": pytest.approx(1 - measured), "with_pose": 1.0}
    np.testing.assert_allclose(numbers["position_std_median_mm"], 1.0)
    uses = tracked.poses.cameras
    assert numbers["cameras"] == {
        "camera60": NOTHING,
        "camera180": {**NOTHING, "contradicting": 1.0},
        "camera300": {**NOTHING, "black": float(np.mean(uses[:, 2] == "black"))},
    }
    assert numbers["recorded"]["share_only_found"] == pytest.approx(1 / FRAMES)


def test_cameras_that_need_a_look_are_named_and_contradict_only_where_there_is_a_pose(rng):
    def cameras_of(poses: Poses):
        return summary.summary(Tracked(poses, len(poses), None, 0, 0.0))["cameras"]

    uses = np.full((1000, 3), "used", dtype="U20")
    uses[:11, 0], uses[:10, 1] = "no_image", "no_image"
    uses[:101, 2], uses[101:201, 1] = "contradicting", "contradicting"
    poses = dataclasses.replace(random_poses(rng, 1000, share=1), cameras=uses)
    assert summary.to_look_at(cameras_of(poses)) == {
        "camera60": {CameraUse.NO_IMAGE: 0.011},
        "camera300": {CameraUse.CONTRADICTING: 0.101},
    }
    unseen = cameras_of(dataclasses.replace(random_poses(rng, 10, share=0), cameras=np.full((10, 3), "used")))
    assert unseen["camera60"] == {**NOTHING, "contradicting": None}
    assert summary.to_look_at(unseen) == {}
    assert cameras_of(random_poses(rng, 5, cameras=False)) is None


def test_time_counts_from_the_recording_s_first_frame_wherever_poses_begin(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    whole = run(make_job(log, tmp_path / "whole.h5")).poses
    part = run(make_job(log, tmp_path / "part.h5", start=3)).poses
    expected = summary.seconds_since_beginning(log, whole)
    assert expected[0] == 0
    np.testing.assert_array_equal(summary.seconds_since_beginning(log, part), expected[3:])


@pytest.mark.parametrize("packed", [False, True])
def test_poses_of_another_recording_are_distinguished_from_its_own(packed, tmp_path):
    log = write_log(tmp_path / "log", FRAMES, packed=packed)
    own = run(make_job(log, tmp_path / "own.h5", start=2)).poses
    with tracker.open_log(log) as opened:

        def refuse(poses: Poses) -> None:
            summary.refuse_others(tmp_path / "poses.h5", poses, log, opened)

        refuse(own)
        refuse(own[:0])
        # Poses have the newest image's stamp; a folder's frame has the images' mean. Formats round them.
        for shift in (-0.0025, 0.0005):
            refuse(dataclasses.replace(own, timestamp=own.timestamp + shift))
        for change in ({"timestamp": own.timestamp + 0.0015}, {"index": own.index + FRAMES}):
            other = dataclasses.replace(own, **change)
            with pytest.raises(LogError, match=r"poses\.h5: found poses of another recording \(camera_data"):
                refuse(other)


def test_poses_are_a_recordings_own_if_its_last_images_are_older_than_those_before(tmp_path):
    stamps = [[10.0, 9.75, 10.25], [10.1, 9.85, 10.35], [10.2, 9.95, np.nan]]
    images = [np.full((270, 270, 3), 110, np.uint8)] * 3
    with Hdf5LogWriter(tmp_path / "log.h5", RIG) as writer:
        for row in stamps:
            given = [None if np.isnan(stamp) else image for image, stamp in zip(images, row, strict=True)]
            writer.append(given, row[0], row)
    poses = tracker.track(tmp_path / "log.h5", "cube_v2", rig=RIG).poses
    assert poses.timestamp[-1] > 10.35
    with tracker.open_log(tmp_path / "log.h5") as log:
        summary.refuse_others(tmp_path / "poses.h5", poses, tmp_path / "log.h5", log)
        later = dataclasses.replace(poses, timestamp=poses.timestamp + 0.2)
        with pytest.raises(LogError, match="another recording"):
            summary.refuse_others(tmp_path / "poses.h5", later, tmp_path / "log.h5", log)


def test_rewards_last_until_the_next_and_are_held_where_nothing_was_seen():
    nan = float("nan")
    found = summary.totals(np.array([nan, -1.0, nan, -3.0]), np.array([0.0, 1.0, 3.0, 4.0]))
    assert found == {"reward_total": -(1 + 2 + 1 + 3) * 1e3, "reward_mean": -7 / 5, "error_end": 3.0}
    for nothing in ([nan], []):
        assert summary.totals(np.array(nothing), np.zeros(len(nothing))) == dict.fromkeys(found)


def test_a_goal_of_later_is_that_of_later_frames(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    job = make_job(log, tmp_path / "part.h5", start=5)
    poses = run(job).poses

    def columns(goal: list) -> dict:
        (tmp_path / "log" / "goal.json").write_text(json.dumps(goal))
        return summary.goal_columns(log, poses, job.recipe.model)

    goal = [[0, [0.1, 0.0, 0.05]], [250, [0.0, 0.1, 0.05]], [450, [0.0, 0.0, 0.05]]]
    assert columns(goal)["reward_mean"] == columns([[0, goal[2][1]]])["reward_mean"]
    none = columns([[0, 5]])  # leaves a well tracked recording without a score
    assert list(none) == ["goal_fault"]
    assert "goal.json: trajectory: entry 0" in none["goal_fault"]
    log.write_bytes(bytes(8))  # of no frames
    assert "camera_data.dat: found no frame that can be read" in columns(goal)["goal_fault"]
    log.unlink()
    assert "camera_data.dat" in columns(goal)["goal_fault"]


def test_a_goal_begins_with_its_frame_whatever_the_first_stamp():
    goal = JobGoal("trajectory", trajectory=((0.0, (0.0, 0.0, 0.05)), (30000.0, (0.1, 0.0, 0.05))))
    states = np.tile([0.0, 0.0, 0.05, 1.0], (309, 1))
    for first in range(0, 1400, 7):
        stamps = (first + np.arange(309)) / 10
        rewards = goal.rewards(stamps - stamps[0], states[:, :3], states, load_object("cube_v2"))
        assert np.flatnonzero(rewards)[0] == 300


def test_an_object_at_rest_has_no_path(rng):
    still = rng.uniform(-1, 1, (500, 3)) * summary.STEP / 4
    assert summary.path_length(still) == 0
    way = np.linspace(0, 1, 101)[:, None] * [1.0, 0, 0]
    assert summary.path_length(way) == pytest.approx(1.0)


def test_what_lies_between_two_episodes_is_no_path(tmp_path):
    log, frames = tmp_path / "log", []
    shutil.copytree(DEMO, log, ignore=shutil.ignore_patterns("00*"))
    for number, name in enumerate(("000000", "000017", "000018")):
        shutil.copytree(DEMO / name, log / name)
        frames.append({"frame": name, "timestamp": number / 10})
    for sequence, expected in ((True, 0.0231), (False, 0.0)):
        truth = {"settings": {"sequence": sequence}, "frames": frames}
        (log / "ground_truth.json").write_text(json.dumps(truth))
        job = Job(log, tmp_path / "poses.h5", Recipe.of(Options("cube_v2")))
        for tracked in (run(job), run(job)):  # the second one reads what the first wrote
            assert summary.row(job, tracked, None)["path_length_m"] == pytest.approx(expected, abs=1e-4)


STRAIGHT = (0, 1, 2)


@pytest.fixture(scope="module")
def demo():
    """A tracker, and four sets of pictures that come with the package."""
    with tracker.open_log(DEMO) as log:
        return tracker.ObjectTracker("cube_v2", log.rig), [list(log[k].images) for k in (0, 5, 11, 17)]


@pytest.mark.parametrize("order", list(itertools.permutations(STRAIGHT))[1:])
def test_the_order_that_fits_is_found(demo, order):
    one, sets = demo
    given = [[images[k] for k in order] for images in sets]
    back = tuple(map(order.index, STRAIGHT))
    assert remarks.swapped(one, given[0]) == remarks.swap_message(back, CAMERAS)
    assert remarks.lasting_remark(one, [[None] * 3, *given]) == remarks.swap_message(back, CAMERAS)


def test_images_are_tried_only_with_cameras_of_their_size(demo):
    one, (images, *_) = demo
    rig = tracker.CameraRig((one.rig[0], one.rig[1].resized(540, 540), one.rig[2]))
    given = [images[2], cv2.resize(images[1], (540, 540)), images[0]]
    found = remarks.swapped(tracker.ObjectTracker("cube_v2", rig), given)
    assert found == remarks.swap_message((2, 1, 0), CAMERAS)


def test_there_is_no_warning_of_pictures_that_fit_or_that_are_wrong(demo):
    one, sets = demo
    assert remarks.lasting_remark(one, sets) is None
    for images, other in itertools.pairwise(sets[1:]):
        mirrored = [images[0], np.ascontiguousarray(images[1][:, ::-1]), images[2]]
        empty = [cv2.GaussianBlur(image, (0, 0), 40) for image in images]
        for wrong in (images, mirrored, empty, [images[0], None, None], [images[0], images[1], other[2]]):
            assert remarks.swapped(one, wrong) is None


def test_other_channels_and_other_objects_are_named(demo):
    one, sets = demo
    other = tracker.ObjectTracker(tracker.load_object("cube_v1"), one.rig)
    for images in sets[::2]:
        assert remarks.misplaced(one, images, one.detect(images)) is None
        turned = [np.ascontiguousarray(image[..., ::-1]) for image in images]
        for finder, given, word in ((one, turned, "swapped"), (other, images, "cube_v2")):
            answer = finder.detect(given)
            assert answer.object_pose is None or answer.object_pose.confidence < 0.5
            assert word in remarks.misplaced(finder, given, answer)


def test_a_colour_model_that_does_not_fit_is_named_not_another_object(demo):
    one, (images, *_) = demo
    finder = tracker.ObjectTracker("cube_v2", one.rig, "dice")
    found = remarks.misplaced(finder, images, finder.detect(images))
    assert found == "cube_v2 is found with the colour model cube_v2, not with dice"


def test_a_coloured_background_is_named_unless_the_colours_were_learned_on_it(demo):
    one, sets = demo
    as_they_are = dataclasses.replace(one.colors, normalise=False)
    learned = tracker.ObjectTracker(one.model, one.rig, as_they_are)
    found = set()
    for images in sets:
        brown = [on_wood(image, tracker.segment(image, one.colors)) for image in images]
        found.add(remarks.misplaced(one, brown, one.detect(brown)))
        assert remarks.misplaced(learned, brown, learned.detect(brown)) != remarks.COLOURED
    assert remarks.COLOURED in found <= {None, remarks.COLOURED}


def test_a_camera_that_moved_is_no_reason_to_doubt_the_object(demo):
    one, sets = demo
    finder = tracker.ObjectTracker("cube_v2", nudged(one.rig, 2, [0.0, np.radians(8.0), 0.0]))
    answers = [finder.detect(images) for images in sets]
    assert min(answer.object_pose.confidence for answer in answers) > 0.9
    found = {remarks.misplaced(finder, *pair) for pair in zip(sets, answers, strict=True)}
    assert remarks.DOUBTFUL in found <= {None, remarks.DOUBTFUL}


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda image: image, None),
        (lambda image: np.ascontiguousarray(image[..., ::-1]), "red and blue are swapped"),
        (lambda image: cv2.GaussianBlur(image, (0, 0), 12), "camera60: blurred by .* px: .*and 2 more"),
        (lambda image: image // 16, "camera60: dark, median grey level [0-9]: .*and 2 more"),
        (lambda image: (0.15 * image).astype(np.uint8), "camera60: dark, median grey level 18: "),
        (lambda image: np.minimum(image.astype(int) * 8, 255).astype(np.uint8), "camera60: over-exposed"),
    ],
)
def test_the_likely_cause_of_a_miss_is_named(demo, change, cause):
    one, sets = demo
    images = [change(image) for image in sets[0]]
    found = remarks.likely_cause(one, images, one.detect(images))
    assert found is None if cause is None else re.search(cause, found)
    assert found is None or "\n" not in found


def test_a_rig_that_looks_the_same_from_each_camera_cannot_tell(rig):
    places = [(0.4 * np.cos(a), 0.4 * np.sin(a), 0.4) for a in np.radians([60.0, 180.0, 300.0])]
    cameras = tuple(
        dataclasses.replace(rig[0], name=name, camera_from_world=look_at(place))
        for name, place in zip(CAMERAS, places, strict=True)
    )
    images = bare("cube_v2", cameras, 3).images
    one = tracker.ObjectTracker("cube_v2", tracker.CameraRig(cameras))
    for order in ((1, 2, 0), (1, 0, 2)):
        assert remarks.swapped(one, [images[k] for k in order]) is None


@pytest.mark.parametrize(
    ("confidences", "expected"),
    [
        ({"cube_v1, RGB": 0.8, "cube_v2": 0.97}, "the images show cube_v2 rather than cube_v1"),
        ({"cube_v1, RGB": 0.99, "cube_v2": 0.97}, "cube_v1 is found if red and blue are swapped"),
        ({"cube_v1, RGB": 0.5, "cube_v2": 0.5}, ""),
    ],
)
def test_what_fits_better_is_named_of_another_object_and_swapped_channels(rig, confidences, expected):
    class Scripted:
        """A tracker of given confidences; BGR images are red."""

        def __init__(self, name, rig):
            self.model, self.rig, self.colors = load_object(name), rig, None

        def detect(self, images):
            name = self.model.name + (", RGB" if images[0][0, 0, 0] else "")
            pose = dataclasses.replace(resting(0.0), confidence=confidences.get(name, 0.1))
            return Observation(pose, None, Status.FOUND, {}, None, (CameraUse.USED,))

    red = np.zeros((9, 9, 3), np.uint8)
    red[..., 2] = 255
    assert (remarks.mistaken(Scripted("cube_v1", rig), [red]) or "").partition(":")[0] == expected


RING = (
    "the images of camera60, camera180 and camera300 look swapped: camera180's fits camera60, "
    "camera300's fits camera180, camera60's fits camera300"
)


@pytest.mark.parametrize(
    ("order", "sought", "expected"),
    [
        ((1, 0, 2), "cube_v2", "the images of camera60 and camera180 look swapped"),
        # Most frames have a pose, though none is sure.
        ((2, 0, 1), "cube_v2", RING),
        (STRAIGHT, "cube_v1", "the images show cube_v2 or cube_v3 rather than cube_v1"),
        (STRAIGHT, "cube_v2", None),
    ],
)
def test_a_recording_is_marked_in_its_line_if_little_came_of_it(tmp_path, order, sought, expected):
    log = tmp_path / "log"
    shutil.copytree(DEMO, log)
    for folder in log.glob("0*"):
        for k, name in zip(order, CAMERAS, strict=True):
            shutil.copy(DEMO / folder.name / f"{CAMERAS[k]}.jpg", folder / f"{name}.jpg")
    job = Job(log, tmp_path / "poses.h5", Recipe.of(Options(sought, stop=8)))
    tracked = run(job)
    remark = remarks.remark_on_recording(job, tracked.poses)
    line = summary.row(job, tracked, remark)["warning"]
    assert line == expected
    assert summary.row(job, tracked, "of \udce9.npz")["warning"] == "of \ufffd.npz"
    shutil.rmtree(log)
    assert remarks.remark_on_recording(job, tracked.poses) is None


MODEL = load_object("cube_v2")
ARENA = tracker.Arena(table=0.01)


def resting(height: float, std: float = 2e-4, tilt: float = 0.0, confidence: float = 0.95) -> PoseEstimate:
    """A cube on a face, its centre `height` [m] too high, turned by `tilt` [rad]."""
    rotation = so3.exp([tilt, 0.0, 0.0]) @ so3.exp([0.0, 0.0, 0.7]) @ so3.exp([np.pi / 2, 0.0, 0.0])
    position = np.array([0.05, -0.02, 0.01 + MODEL.size[2] / 2 + height])
    return PoseEstimate(position, so3.quaternion_from_matrix(rotation), np.eye(6) * std**2, confidence)


@pytest.mark.parametrize(
    ("height", "std", "words"),
    [
        (4.2e-3, 2e-4, "cube_v2 floats 4.2 mm above the table (± 0.2 mm)"),
        (-3.1e-3, 1e-3, "cube_v2 sinks 3.1 mm into the table (± 1.0 mm)"),
        (4.2e-3, 2.2e-3, None),
        (-2.8e-3, 1e-4, None),
        (0.0, 1e-4, None),
        (0.03, 1e-3, None),
    ],
)
def test_an_object_off_the_table_by_two_deviations_is_named_with_the_remedy(height, std, words):
    found = remarks.off_table(resting(height, std), MODEL, ARENA)
    remedy = ": if it rests, `tracker calibrate table RECORDING --object OBJECT -o DIR` corrects this"
    assert found == (None if words is None else words + remedy)


def test_nothing_is_named_unless_it_seems_to_rest():
    high = resting(5e-3)
    assert remarks.off_table(high, MODEL, ARENA)
    for pose in (None, resting(5e-3, tilt=0.1), resting(5e-3, confidence=0.4)):
        assert remarks.off_table(pose, MODEL, ARENA) is None
    for change in ({"table": None}, {"table_std": (1e-3, 0.0)}):
        assert remarks.off_table(high, MODEL, dataclasses.replace(ARENA, **change)) is None


def test_a_table_that_is_not_at_the_height_of_the_world_is_named_by_detect(run_here, tmp_path):
    rig = tracker.CameraRig.load(DEMO)
    dataclasses.replace(rig, arena=tracker.Arena(table=-0.004)).save(tmp_path)
    given = ["detect", "--object", "cube_v2", DEMO]
    assert run_here(*given).stderr == ""
    (line,) = run_here(*given, "--calibration", tmp_path).stderr.splitlines()
    assert line.startswith("tracker: warning: cube_v2 floats 3.9 mm above the table")
