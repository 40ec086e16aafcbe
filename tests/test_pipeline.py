import time

import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers import apart, exposed, within
from tests.helpers.kept_stills import take
from tests.helpers.stills import bare_scene, scene_with_fingers
from tracker.errors import ImageError
from tracker.objects.model import to_toml
from tracker.pose import views

SCENES = 10
OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")


@pytest.fixture(scope="module")
def trackers(rig):
    return {name: tracker.ObjectTracker(name, rig) for name in OBJECTS}


@pytest.fixture(scope="module")
def scenes(rig):
    """Rendered scenes by object: half without fingers, all with a realistic sensor."""

    def filmed(name: str, k: int):
        rng = np.random.default_rng([20, k])
        scene = (scene_with_fingers if k % 2 else bare_scene)(tracker.load_object(name), rng)
        return take(scene, rig.cameras, Sensor.realistic(), rng)

    return {name: [filmed(name, k) for k in range(SCENES)] for name in OBJECTS}


@pytest.fixture(scope="module")
def poses(trackers, scenes):
    """What is found in the scenes."""
    return {
        name: [one.detect(truth.images).object_pose for truth in scenes[name]]
        for name, one in trackers.items()
    }


@pytest.fixture(scope="module")
def clear(scenes):
    """Which of the scenes show the whole object to every camera."""
    result = {
        name: [k for k, truth in enumerate(scenes[name]) if truth.visible_fraction.min() > 0.95]
        for name in OBJECTS
    }
    assert min(map(len, result.values())) >= SCENES // 2
    return result


@pytest.mark.parametrize("name", OBJECTS)
def test_poses_of_rendered_scenes_are_accurate_and_a_sure_pose_is_right(scenes, poses, clear, name):
    shift, turn = np.median([apart(poses[name][k], scenes[name][k]) for k in clear[name]], axis=0)
    assert shift < 0.2e-3
    assert turn < np.radians(0.4)
    sure = [k for k, pose in enumerate(poses[name]) if pose is not None and pose.confidence > 0.9]
    assert set(clear[name]) <= set(sure)
    for k in sure:
        assert within(poses[name][k], scenes[name][k], 5e-3, 5)


@pytest.mark.parametrize("name", OBJECTS)
def test_loud_images_are_enough(trackers, scenes, clear, name):
    rng = np.random.default_rng(6)
    for k in clear[name]:
        truth = scenes[name][k]
        loud = [exposed(image + rng.normal(0, 8, image.shape)) for image in truth.images]
        assert within(trackers[name].detect(loud).object_pose, truth, 0.5e-3, 2)


def test_two_cameras_are_less_sure_and_still_right_and_one_is_near_the_truth_or_not_sure(
    trackers, scenes, poses
):
    right, detect = 0, trackers["cube_v2"].detect
    for truth, full in list(zip(scenes["cube_v2"], poses["cube_v2"], strict=True))[::2]:
        pair = detect([truth.images[0], None, truth.images[2]]).object_pose
        assert within(pair, truth, 5e-3, 5)
        assert np.trace(pair.covariance[:3, :3]) > np.trace(full.covariance[:3, :3])
        alone = detect([truth.images[0], None, None]).object_pose
        if alone is not None and alone.confidence > 0.5:
            assert within(alone, truth, 20e-3, 5)
            right += 1
    assert right >= 2


def test_gains_and_exposure_do_not_move_the_pose(trackers, scenes, poses):
    rng = np.random.default_rng(3)
    for _ in range(5):
        gains = rng.uniform(0.8, 1.2, (3, 3)) * rng.uniform(0.6, 1.4, (3, 1))
        changed = [exposed(i, g) for i, g in zip(scenes["cube_v2"][0].images, gains, strict=True)]
        pose = trackers["cube_v2"].detect(changed).object_pose
        assert within(pose, poses["cube_v2"][0], 0.1e-3, 0.15)


GOOD = np.zeros((270, 270, 3), np.uint8)
NAMED = dict.fromkeys(("camera60", "camera180", "camera300"), GOOD)


@pytest.mark.parametrize(
    ("images", "says"),
    [
        ([GOOD, GOOD], "images: found 2, expected an image"),
        (GOOD, r"images: found uint8 of shape \(270, 270, 3\), expected an image"),
        (None, r"images: found None, expected an image \(H, W, 3\) or None for each camera: camera60, "),
        ("abc", "images: found 'abc'"),
        (iter([GOOD] * 3), "images: found <list_iterator"),
        ({"camera60": GOOD, "camera180": GOOD}, "missing camera300"),
        ({"camera60": GOOD, "camera1": GOOD, 3: None}, "unknown 'camera1', 3; missing camera180, camera300"),
        ({**NAMED, "top": GOOD}, "unknown 'top'; expected one"),
        (dict.fromkeys(NAMED), "found None for all"),
        ([GOOD, GOOD, GOOD[..., 0]], r"camera300.*shape \(270, 270\)"),
        ([GOOD, GOOD.astype(float), GOOD], "camera180.*float64, expected uint8"),
        ([GOOD, GOOD, np.zeros((540, 540, 3), np.uint8)], "camera300.*540×540.*270×270"),
        ([GOOD, "image.png", GOOD], "camera180.*found str"),
        ([None, None, None], r"found None for all.*cv2\.imread"),
        ([GOOD[:, :, [0, 1, 2, 2]], GOOD, GOOD], "camera60.*shape"),
    ],
)
def test_bad_images_are_named(trackers, images, says):
    with pytest.raises(ImageError, match=says):
        trackers["cube_v2"].detect(images)


def assert_same_pose(pose, expected):
    assert np.array_equal(pose.position, expected.position)
    assert np.array_equal(pose.orientation, expected.orientation)


def test_images_go_by_the_cameras_names_in_any_order_and_views_are_as_good_as_copies(trackers, scenes):
    one, truth = trackers["cube_v2"], scenes["cube_v2"][1]
    named = dict(zip(reversed(one.rig.names), reversed(truth.images), strict=True))
    expected = one.detect(truth.images).object_pose
    flipped = [np.ascontiguousarray(image[:, ::-1])[:, ::-1] for image in truth.images]
    assert_same_pose(one.detect(flipped).object_pose, expected)
    assert_same_pose(one.detect(named).object_pose, expected)
    one.reset()
    assert_same_pose(one.update(named, dict.fromkeys(named, 1.0)).object_pose, expected)
    one.reset()
    pair = one.detect({**named, "camera60": None}).object_pose
    assert_same_pose(pair, one.detect([None, *truth.images[1:]]).object_pose)


def test_the_time_that_taking_off_a_veil_takes_is_told(trackers, scenes, monkeypatch):
    def slowly(image):
        time.sleep(0.01)
        return image

    monkeypatch.setattr(views, "unveiled", slowly)
    one, images = trackers["cube_v2"], scenes["cube_v2"][0].images
    one.reset()
    for answer in (one.detect(images), one.update(images, 0.0), one.update(images, 0.1)):
        assert answer.timing_ms["light"] >= 10.0 * len(images)


def test_every_pose_of_a_tracker_has_keypoints(trackers, scenes):
    one, truth = trackers["cuboid_2x2x8_v2"], scenes["cuboid_2x2x8_v2"][0]
    one.reset()
    answer = one.update(truth.images, 0.0)
    forecast = one.predict(0.1)
    centre = one.detect(truth.images).object_pose.keypoints.mean(axis=0)
    assert np.abs(centre - truth.position).max() < 1e-3
    for pose in (answer.object_pose, answer.filtered_object_pose, forecast, *forecast.kinds):
        assert np.linalg.norm(pose.keypoints[0] - pose.keypoints[7]) == pytest.approx(np.sqrt(0.0072), 1e-6)
        expected = pose.position + pose.rotation @ (one.model.size / 2)
        np.testing.assert_allclose(pose.keypoints[0], expected, atol=1e-12)
        assert pose.keypoint_covariances.shape == (8, 3, 3)
    one.reset()


def test_a_tracker_is_shown_in_few_lines(trackers, scenes):
    one = tracker.ObjectTracker("cuboid_2x2x8_v2", trackers["cube_v2"].rig)
    text = repr(one)
    assert "CuboidModel('cuboid_2x2x8_v2': 20×80×20 mm, +x red, " in text
    assert "CameraRig(camera60, camera180, camera300 of 270×270 px; Arena(" in text
    assert "ColorModel('cuboid_2x2x8_v2': red, " in text
    assert repr(tracker.load_colors("dice")) == "ColorModel('dice': blue; greys normalised)"
    assert text.count("\n") == 2
    assert "last update" not in text
    one.update(scenes["cuboid_2x2x8_v2"][0].images, 1.5)
    assert "last update at 1.500 s" in repr(one)
    two = tracker.CameraRig((one.rig[0], one.rig[1].resized(540, 540)))
    assert repr(two).startswith("CameraRig(camera60 of 270×270 px, camera180 of 540×540 px; Arena")
    assert repr(one.rig[0]).startswith("Camera('camera60': 270×270 px, f 29")


def test_names_and_paths_do_as_well_as_what_they_name(trackers, scenes, tmp_path):
    one = trackers["cube_v2"]
    one.rig.save(tmp_path)
    one.colors.save(tmp_path / "mine.npz")
    (tmp_path / "mine.toml").write_text(to_toml(one.model))
    files = [tmp_path / f"{name}.yml" for name in one.rig.names]
    expected = one.detect(scenes["cube_v2"][1].images).object_pose
    for model, rig, colors in (
        ("cube_v2", tmp_path, None),
        (tmp_path / "mine.toml", files, tmp_path / "mine.npz"),
        (one.model, str(tmp_path), "cube_v2"),
        ("cube_v2", iter(files), None),
    ):
        named = tracker.ObjectTracker(model, rig, colors)
        pose = named.detect(scenes["cube_v2"][1].images).object_pose
        assert np.abs(pose.position - expected.position).max() < 1e-9


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"model": 3}, "model: found 3, expected a CuboidModel .* or its name or TOML file"),
        ({"model": "cube"}, "unknown object 'cube'; valid are cube_v1"),
        ({"rig": 3}, "rig: found 3, expected a CameraRig .* or the folder of its calibration files"),
        ({"rig": "nowhere"}, "nowhere"),
        ({"rig": []}, "expected at least one"),
        ({"rig": [3]}, "found 3, expected cameras' files"),
        ({"colors": 3}, "colors: found 3, expected a ColorModel .* or its name or file"),
        ({"tracking": {"coast_seconds": 1}}, "tracking: found a mapping of 1, expected Track"),
        ({"table_prior": None}, "table_prior: found None, expected bool"),
        ({"colors": "pink"}, "unknown colour model 'pink'"),
    ],
)
def test_what_names_no_object_rig_or_colours_is_refused(trackers, changed, says):
    one = trackers["cube_v2"]
    parts = {"model": one.model, "rig": one.rig, "colors": one.colors}
    with pytest.raises(tracker.TrackerError, match=says):
        tracker.ObjectTracker(**{**parts, **changed})
