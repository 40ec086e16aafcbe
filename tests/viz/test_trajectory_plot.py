import dataclasses
import itertools
import os
import sys

import cv2
import numpy as np
import pytest

from tests.helpers import pose_logs, random_rotations
from tests.helpers.pose_logs import answer, moved, random_covariance, random_pose, random_poses
from tracker.errors import TrackerError
from tracker.geometry import so3
from tracker.pose.result import Status
from tracker.poses.file import PosesBuilder
from tracker.viz import paint, write_trajectory_plot
from tracker.viz.plots import STATUS_COLORS, angle_std, angles, series_of

pytest.importorskip("matplotlib", reason="plot: no module matplotlib")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "trajectory.png"


def drawn(path, poses, title=""):
    write_trajectory_plot(path, poses, title)
    assert os.listdir(path.parent) == [path.name]
    image = cv2.imread(str(path))
    assert image.shape == (1300, 1560, 3)
    assert image[2, 2].tolist() == list(paint.BACKGROUND)
    return image


def share_of(image, color):
    return np.mean((np.abs(image.astype(int) - np.array(color)) <= 2).all(axis=2))


def built(answers, seconds=1.0):
    """Poses of answers of a tracker, so many seconds apart."""
    builder = PosesBuilder(pose_logs.make_about())
    for number, one in enumerate(answers):
        builder.append(number, pose_logs.START + number * seconds, one)
    return builder.build()


@pytest.mark.parametrize(
    ("count", "share", "recorded"),
    [
        (0, 1, False),
        (1, 1, True),
        (2, 0.5, True),
        (40, 0, False),
        (40, 0, True),
        (40, 0.6, False),
        (40, 1, True),
    ],
)
def test_every_kind_of_recording_can_be_drawn(path, rng, count, share, recorded):
    title = ("a $\\frac{$ b", "ä 物体 \\frac{", "x" * 60)[count % 3]
    image = drawn(path, random_poses(rng, count, share=share, recorded=recorded), title)
    assert image.std() > 5  # axes and words at least


def test_without_filtered_poses_the_measured_ones_are_lines(path, rng):
    poses = built(answer(random_pose(rng), None, "found") for _ in range(9))
    assert share_of(drawn(path, poses), (110, 120, 240)) > 1e-4


def test_the_strip_has_the_colours_of_the_statuses(path, rng):
    names = ["tracking"] * 200 + ["coasting"] * 80 + ["lost"] * 80 + ["refound"] + ["tracking"] * 3639
    image = drawn(path, dataclasses.replace(random_poses(rng, 4000, share=0), status=np.array(names)))
    strip = image[100:130]
    found = [share_of(strip, STATUS_COLORS[name]) for name in ("tracking", "coasting", "lost")]
    assert found[0] > 10 * found[1] > 0
    assert found[1] == pytest.approx(found[2], rel=0.2)
    # One frame of 4000 is still seen.
    assert share_of(strip, STATUS_COLORS["refound"]) > 0


@pytest.mark.parametrize("count", [2, 40, 4000])
def test_the_last_frame_has_a_place_in_the_strip(path, rng, count):
    names = ["tracking"] * (count - 1) + ["lost"]
    image = drawn(path, dataclasses.replace(random_poses(rng, count, share=0), status=np.array(names)))
    strip = image[100:130]
    shares = [share_of(strip, STATUS_COLORS[name]) for name in ("lost", "tracking")]
    assert shares[0] / sum(shares) == pytest.approx(max(1 / count, 0.003), rel=0.3)


def test_each_status_has_a_colour_of_its_own():
    assert set(STATUS_COLORS) == {status.value for status in Status}
    for one, other in itertools.combinations(STATUS_COLORS.values(), 2):
        assert np.abs(np.subtract(one, other)).max() >= 20


def test_equal_motions_along_the_axes_look_equal():
    poses = [moved(np.eye(3), np.array([x, 0.02, 0.03 + x / 10])) for x in (0.0, 0.1)]
    for pose in poses:
        pose.covariance = np.eye(6) * 1e-8
    panels = series_of(built(answer(pose, None, "found") for pose in poses))
    lengths = np.ptp([panel.limits for panel in panels[:3]], axis=1)
    np.testing.assert_allclose(lengths, 116.0)
    for panel in panels:
        assert (panel.limits[0] < panel.values[np.isfinite(panel.values)]).all()


def test_recorded_poses_are_seen(path, rng):
    poses = random_poses(rng, 30)
    color = (90, 215, 250)
    # Circles are blended with what lies below.
    near = [np.abs(drawn(path, one).astype(int) - color).sum(axis=2) < 120
            for one in (poses, dataclasses.replace(poses, recorded=None))]  # fmt: skip
    assert near[0].sum() > near[1].sum() + 500
    high = dataclasses.replace(poses.recorded, confidence=1.5 * poses.recorded.confidence)
    panel = series_of(dataclasses.replace(poses, recorded=high))[-1]
    assert 1.04 < np.nanmax(panel.values) < panel.limits[1]


def test_a_missing_package_is_named(path, rng, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(TrackerError, match=r"pip install .*\[plot\]"):
        write_trajectory_plot(path, random_poses(rng, 1))
    assert not path.exists()


def test_angles_are_those_from_the_reference(rng):
    reference = random_rotations(rng, 1)[0]
    expected = np.array([0.0, 1e-6, 20.0, 90.0, 179.9])
    axes = rng.normal(size=(5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turned = so3.exp(axes * np.radians(expected)[:, None]) @ reference
    orientation = np.concatenate([so3.quaternion_from_matrix(turned), np.full((1, 4), np.nan)])
    found = angles(orientation, reference)
    assert found[:5] == pytest.approx(expected, abs=1e-9)
    assert np.isnan(found[5])
    assert angles(np.empty((0, 4)), reference).shape == (0,)


def test_the_angles_deviation_is_that_of_samples(rng):
    reference = random_rotations(rng, 1)[0]
    rotation = so3.exp(np.array([0.7, -0.4, 0.5])) @ reference
    covariance = 1e-6 * np.array([[4.0, 1.0, 0.5], [1.0, 2.0, -0.3], [0.5, -0.3, 9.0]])
    samples = so3.exp(rng.multivariate_normal(np.zeros(3), covariance, 20000)) @ rotation
    spread = angles(so3.quaternion_from_matrix(samples), reference).std()
    quaternion = so3.quaternion_from_matrix(rotation)[None]
    assert angle_std(quaternion, reference, covariance[None])[0] == pytest.approx(spread, rel=0.02)
    at_the_reference = angle_std(np.array([[0, 0, 0, 1.0]]), np.eye(3), np.diag([1e-6, 4e-6, 2e-6])[None])
    assert at_the_reference[0] == pytest.approx(np.degrees(2e-3))  # the largest of all axes


def test_frames_far_beyond_the_rest_in_uncertainty_do_not_set_the_scale(path, rng):
    """The band of a lost object leaves the panel; the line keeps its place in it."""
    images = []
    for size in (1e-8, 1e4, 1e200):
        poses = [moved(np.eye(3), np.array([0.01 * number, 0, 0.03])) for number in range(20)]
        for number, pose in enumerate(poses):
            pose.covariance = np.eye(6) * (size if number > 15 else 1e-8)
            pose.velocity, pose.velocity_covariance = np.zeros(6), random_covariance(rng)
        images.append(drawn(path, built((answer(None, pose, "coasting") for pose in poses), 0.1)))
    left = [image[160:380, 150:900].astype(int) for image in images]
    for other in left[1:]:
        assert np.abs(other - left[0]).max() < 8  # rounding along the band's edge
