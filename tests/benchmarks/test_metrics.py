from __future__ import annotations

import numpy as np
import pytest

import tracker
from benchmarks.score import errors as metrics
from benchmarks.score import shares, summary
from benchmarks.score.records import FrameRecord, frame_of
from tests.helpers import make_camera, random_rotations
from tracker.geometry import so3

CUBE, CUBOID = tracker.load_object("cube_v2").size, tracker.load_object("cuboid_2x2x8_v2").size
CAMERAS = [make_camera(angle) for angle in (60, 180, 300)]


def poses(rng, count=20, spread=0.1):
    return rng.normal(0, spread, (count, 3)), random_rotations(rng, count)


def near(rng, pose, shift=1e-3, turn=1e-2):
    position, rotation = pose
    return position + rng.normal(0, shift, position.shape), (
        so3.exp(rng.normal(0, turn, position.shape)) @ rotation
    )


def moved(pose, position, rotation):
    return pose[0] @ rotation.T + position, rotation @ pose[1]


ALL = {
    "position": lambda a, b: metrics.position_error(a[0], b[0]),
    "rotation": lambda a, b: metrics.rotation_error(a[1], b[1]),
    "axis": lambda a, b: metrics.axis_error(a[1], b[1], 1),
    "roll": lambda a, b: metrics.roll_error(a[1], b[1], 1),
    "add": lambda a, b: metrics.surface_error(CUBOID, a, b)[0],
    "mssd": lambda a, b: metrics.surface_error(CUBOID, a, b)[1],
    "mspd": lambda a, b: metrics.image_error(CUBOID, CAMERAS, a, b),
    "task position": lambda a, b: metrics.task_errors(CUBE, a, b)[0],
    "task rotation": lambda a, b: metrics.task_errors(CUBE, a, b)[1],
    "task axis": lambda a, b: metrics.task_errors(CUBOID, a, b)[1],
}


@pytest.mark.parametrize("name", ALL)
def test_an_error_is_zero_for_the_truth_and_the_same_when_swapped(rng, name):
    a = poses(rng)
    b = near(rng, a)
    np.testing.assert_allclose(ALL[name](a, a), 0, atol=1e-7)
    np.testing.assert_allclose(ALL[name](a, b), ALL[name](b, a), rtol=1e-9, atol=1e-12)
    assert (ALL[name](a, b) > 0).all()


@pytest.mark.parametrize("name", [n for n in ALL if n not in ("mspd", "task position")])
def test_an_error_does_not_depend_on_where_the_world_is(rng, name):
    a = poses(rng)
    b = near(rng, a)
    frame = rng.normal(size=3), random_rotations(rng, 1)[0]
    np.testing.assert_allclose(
        ALL[name](moved(a, *frame), moved(b, *frame)), ALL[name](a, b), rtol=1e-6, atol=1e-9
    )


def test_a_pure_shift_moves_every_point_alike(rng):
    a = poses(rng)
    b = a[0] + [0.003, 0.0, -0.004], a[1]
    for error in (metrics.position_error(a[0], b[0]), *metrics.surface_error(CUBE, a, b)):
        np.testing.assert_allclose(error, 0.005)
    np.testing.assert_allclose(metrics.task_errors(CUBE, a, b)[0], (0.003 / 0.39 + 0.004 / 0.1) / 2)


def test_rotation_splits_into_axis_and_roll(rng):
    _, rotations = poses(rng)
    across, roll = 0.02, 0.3
    turned = rotations @ so3.exp([across, 0, 0]) @ so3.exp([0, roll, 0])
    np.testing.assert_allclose(metrics.axis_error(rotations, turned, 1), across, atol=1e-9)
    np.testing.assert_allclose(metrics.roll_error(rotations, turned, 1), roll, atol=1e-9)
    half = rotations @ so3.exp([0, 0, np.pi])
    np.testing.assert_allclose(
        metrics.task_errors(CUBOID, (rotations[:, 0], rotations), (rotations[:, 0], half))[1], 1
    )
    np.testing.assert_allclose(metrics.rotation_error(rotations, half), np.pi, atol=1e-6)


def test_the_greatest_distance_is_at_a_corner_and_above_the_mean(rng):
    a = poses(rng)
    b = near(rng, a)
    mean, greatest = metrics.surface_error(CUBOID, a, b)
    assert (mean < greatest).all()
    points = metrics.surface_points(CUBOID)
    assert len(np.unique(points, axis=0)) == len(points) == metrics.GRID**3 - (metrics.GRID - 2) ** 3
    assert np.linalg.norm(points, axis=1).max() == pytest.approx(metrics.diameter(CUBOID) / 2)


def test_a_shift_along_a_camera_axis_shows_in_the_others(rng):
    position, rotation = np.zeros((1, 3)), np.eye(3)[None]
    depth = CAMERAS[0].position / np.linalg.norm(CAMERAS[0].position)
    b = position + 0.005 * depth, rotation
    own = metrics.image_error(CUBE, CAMERAS[:1], (position, rotation), b)
    assert own < 0.3 * metrics.image_error(CUBE, CAMERAS, (position, rotation), b)


def test_only_the_cuboid_has_a_longest_axis():
    assert metrics.longest_axis(CUBE) is None
    assert metrics.longest_axis(CUBOID) == 1


def test_nees_of_a_true_covariance_is_chi_squared(rng):
    root = rng.normal(size=(6, 6)) * 1e-3
    covariance = root @ root.T + 1e-8 * np.eye(6)
    d = rng.multivariate_normal(np.zeros(6), covariance, 4000)
    position, rotation = rng.normal(size=3), random_rotations(rng, 1)[0]
    true = position + d[:, :3], so3.exp(d[:, 3:]) @ rotation
    found = np.tile(position, (4000, 1)), np.tile(rotation, (4000, 1, 1))
    values = metrics.nees(true, found, np.tile(covariance, (4000, 1, 1)))
    assert values.mean() == pytest.approx(6, abs=0.2)
    assert np.median(values) == pytest.approx(5.348, abs=0.2)
    np.testing.assert_allclose(metrics.nees(true, found, 4 * covariance), values / 4)


def record(**values):
    plain = {"workload": "realistic", "object": "cube_v2", "index": 0, "cameras": 3, "visible_fraction": 0.8}
    return FrameRecord(**{**plain, "present": True, "status": "found", "found": True, **values})


def test_a_summary_counts_right_wrong_and_missing():
    good = {"position_mm": 0.5, "rotation_deg": 0.4, "confidence": 0.9, "mssd_mm": 1.0, "mspd_px": 0.5}
    records = [record(**good)] * 6 + [
        record(position_mm=6.0, rotation_deg=1.0, confidence=0.8, mssd_mm=50.0, mspd_px=60.0),
        record(position_mm=1.0, rotation_deg=6.0, confidence=0.2, mssd_mm=200.0, mspd_px=60.0),
        record(found=False, status="poor fit"),
        record(found=False, status="ambiguous", visible_fraction=0.4),
    ]
    frames = frame_of(records)
    result = summary.summarise(frames)
    assert result["n"] == 10
    assert result["within_1"] == result["within_5"] == 60
    assert (result["misses"], result["wrong"], result["wrong_and_sure"]) == (20, 20, 10)
    assert result["median_mm"] == 0.5
    # 50 mm is 0.444 of the diameter: right for the last two thresholds of ten.
    assert result["ar_mssd"] == pytest.approx(60 + 10 * 0.2)
    assert result["ar_mspd"] == pytest.approx(60)
    assert result["brier"] == pytest.approx((6 * 0.01 + 0.64 + 0.04) / 8)
    rows = summary.accuracy_rows(frames)
    assert [(row["bin"], row["n"]) for row in rows if row["part"] == "visibility"] == [
        ("0.7-0.9", 9),
        ("0.3-0.5", 1),
    ]
    assert sum(row["n"] for row in rows if row["part"] == "confidence") == 8


def test_bins_are_filled_up_with_realistic_frames():
    records = [record(position_mm=1.0, rotation_deg=1.0, index=k) for k in range(3)]
    records.append(record(workload="occlusion bins", position_mm=1.0, rotation_deg=9.0, index=7))
    rows = [row for row in summary.accuracy_rows(frame_of(records)) if row["part"] == "accuracy"]
    assert [(row["group"], row["n"], row["within_5"]) for row in rows] == [
        ("realistic", 3, 100.0),
        ("occlusion bins", 4, 75.0),
    ]


def test_shares_of_honest_poses_inside_their_ellipsoids(rng):
    records = [
        record(position_mm=1.0, rotation_deg=1.0, nees=nees, index=k)
        for k, nees in enumerate(rng.chisquare(6, 4000).tolist())
    ]
    result = summary.summarise(frame_of(records))
    for share in (50, 90, 95):
        assert result[f"inside_{share}"] == pytest.approx(share, abs=2.0)


def test_the_interval_of_a_share_holds_it_and_shrinks_with_the_count():
    for share, count in ((0.0, 10), (50.0, 10), (100.0, 10), (50.0, 1000)):
        low, high = shares.interval(share, count)
        assert 0 <= low <= share + 1e-9
        assert share - 1e-9 <= high <= 100
    assert np.ptp(shares.interval(50.0, 1000)) < np.ptp(shares.interval(50.0, 10))
    assert shares.interval(np.nan, 0) == (0, 100)


def test_without_an_object_only_finds_count():
    records = [record(present=False, found=k == 0, confidence=0.3) for k in range(4)]
    assert summary.summarise(frame_of(records)) == {"n": 4, "false_finds": 1}


def test_average_recall_is_that_of_each_threshold():
    errors = np.array([0.01, 0.12, np.nan])
    assert summary.average_recall(errors, np.array([0.1, 0.2])) == pytest.approx((1 + 2) / 6)


def test_an_honest_confidence_lies_on_the_diagonal(rng):
    confidence = rng.uniform(0, 1, 20_000)
    right = rng.uniform(0, 1, 20_000) < confidence
    for row in shares.reliability(confidence, right):
        if row["n"] > 300:
            low, high = map(float, row["bin"].split("-"))
            assert row["right"] == pytest.approx(row["confidence"], abs=3)
            assert low <= row["confidence"] / 100 <= high
    assert shares.brier_score(confidence, right) == pytest.approx(1 / 6, abs=0.01)
    assert shares.brier_score(np.full(4, 0.5), [0, 1, 0, 1]) == 0.25
