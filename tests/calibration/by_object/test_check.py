import dataclasses
import math
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import make_camera, misplaced, off_as_stated
from tracker.calibration.by_object.check import LIMIT, check, check_calibration
from tracker.calibration.by_object.looks import ACROSS, ALONG, OFTEN, ROLL, TILT, CameraErrors, Look
from tracker.calibration.by_object.sightings import Footage
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.cuboid import corners

CAMERAS = [make_camera(azimuth) for azimuth in (60.0, 180.0, 300.0)]
SIZE = np.array([0.065, 0.065, 0.065])
KNOWN = np.diag(np.repeat([2e-4, 3e-3], 3) ** -2.0)


def moved(camera, shift, turn):
    """A camera that a file has elsewhere by a shift (3,) [m], and turned by (3,) [rad], in the world."""
    rotation = camera.camera_from_world[:3, :3] @ so3.exp(turn)
    elsewhere = so3.transform(rotation, -rotation @ (camera.position + shift))
    return dataclasses.replace(camera, camera_from_world=elsewhere)


STATED = 5e-4, 1.5e-3
"""Standard deviations of a camera, as its file states them [m, rad]."""


def looks(true, given, count=20, seed=1):
    """What each camera sees of an object in many places: truly in `true`, but taken to be in `given`."""
    rng = np.random.default_rng(seed)
    result = []
    for _ in range(count):
        turn = so3.exp(rng.normal(size=3))
        place = so3.transform(turn, rng.uniform([-0.12, -0.12, 0.02], [0.12, 0.12, 0.08]))
        seen = [
            np.linalg.inv(g.camera_from_world) @ t.camera_from_world @ place
            for t, g in zip(true, given, strict=True)
        ]
        d = np.array([np.r_[s[:3, 3] - place[:3, 3], so3.log(s[:3, :3] @ place[:3, :3].T)] for s in seen])
        noise = rng.normal(size=d.shape) / np.sqrt(np.diag(KNOWN))
        # Of where all together have it, only what each sees beside counts.
        ends = corners(SIZE) @ place[:3, :3].T + place[:3, 3]
        result.append(Look(place[:3, 3], np.tile(KNOWN, (3, 1, 1)), d + noise, np.zeros(3, bool), ends))
    return result


def test_exact_cameras_fit():
    found = check_calibration(looks(CAMERAS, CAMERAS), CAMERAS)
    assert found.fits
    assert not any(one.moved for one in found.cameras)
    assert found.miss < 0.3 * LIMIT
    assert [one.looks for one in found.cameras] == [20] * 3


@pytest.mark.parametrize("c", range(3))
@pytest.mark.parametrize(
    ("shift", "turn"), [((4e-3, -2e-3, 1e-3), (0, 0, 0)), ((0, 0, 0), (0.006, -0.006, 0.004))]
)
def test_a_camera_that_was_moved_is_named_and_its_correction_undoes_it(c, shift, turn):
    given = list(CAMERAS)
    given[c] = moved(CAMERAS[c], np.array(shift), np.array(turn))
    found = check_calibration(looks(CAMERAS, given), given)
    assert not found.fits
    assert [one.moved for one in found.cameras] == [k == c for k in range(3)]
    mended = found.cameras[c].correction @ given[c].camera_from_world
    np.testing.assert_allclose(mended[:3, :3], CAMERAS[c].camera_from_world[:3, :3], atol=2e-3)
    point = np.array([0.02, -0.03, 0.03, 1.0])
    # Along the line of sight it is known less well.
    across = (mended @ point - CAMERAS[c].camera_from_world @ point)[:2]
    np.testing.assert_allclose(across, 0.0, atol=0.6e-3)
    assert found.cameras[c].shift_mm == pytest.approx(1e3 * np.linalg.norm(shift), abs=1.2)


@pytest.mark.parametrize("c", range(2))
def test_of_two_cameras_both_are_named_each_with_what_would_reconcile_it_alone(c):
    given = list(CAMERAS[:2])
    given[c] = moved(CAMERAS[c], np.zeros(3), np.array([0.006, -0.006, 0.004]))
    seen = [
        one._replace(information=one.information[:2], moved=one.moved[:2], lost=one.lost[:2])
        for one in looks(CAMERAS, [*given, CAMERAS[2]])
    ]
    found = check_calibration(seen, given)
    assert [one.moved for one in found.cameras] == [True, True]
    true = CAMERAS[0].camera_from_world @ np.linalg.inv(CAMERAS[1].camera_from_world)
    first, second = (one.camera_from_world for one in given)
    mended = found.cameras[0].correction @ first, found.cameras[1].correction @ second
    for pair in ((mended[0], second), (first, mended[1])):
        between = pair[0] @ np.linalg.inv(pair[1])
        np.testing.assert_allclose(between[:3, :3], true[:3, :3], atol=2e-3)


@pytest.mark.parametrize("still", range(3))
def test_if_one_of_three_alone_has_not_moved_all_are_named_since_nothing_tells_which(still):
    shifts = np.array([[0.008, 0.002, -0.003], [-0.004, 0.007, 0.005]])
    given = list(CAMERAS)
    for c, shift in zip([c for c in range(3) if c != still], shifts, strict=True):
        given[c] = moved(CAMERAS[c], shift, np.zeros(3))
    found = check_calibration(looks(CAMERAS, given), given)
    assert [one.moved for one in found.cameras] == [True, True, True]


def test_the_cameras_of_another_platform_do_not_fit_and_one_look_names_none():
    rng = np.random.default_rng(3)
    given = [moved(camera, rng.normal(0, 8e-3, 3), rng.normal(0, 0.02, 3)) for camera in CAMERAS]
    found = check_calibration(looks(CAMERAS, given), given)
    assert not found.fits
    assert found.miss > LIMIT
    given = [moved(CAMERAS[0], np.array([0.0, 0.012, 0.0]), np.zeros(3)), *CAMERAS[1:]]
    found = check_calibration(looks(CAMERAS, given, count=OFTEN - 1), given)
    assert not found.fits
    assert not any(one.moved for one in found.cameras)


def test_a_world_that_is_moved_as_a_whole_fits():
    # Its cameras see the object where they have it, all of them.
    shift, turn = np.array([0.02, -0.01, 0.03]), so3.exp([0.0, 0.0, 0.1])
    back = np.linalg.inv(so3.transform(turn, shift))
    given = [dataclasses.replace(c, camera_from_world=c.camera_from_world @ back) for c in CAMERAS]
    turned = np.kron(np.eye(2), turn)
    world = [
        one._replace(
            position=turn @ one.position + shift,
            information=turned @ one.information @ turned.T,
            moved=one.moved @ turned.T,
            corners=one.corners @ turn.T + shift,
        )
        for one in looks(CAMERAS, CAMERAS)
    ]
    assert check_calibration(world, given).fits


def test_a_camera_that_was_moved_is_named_however_far_the_origin_of_the_world_is_from_the_object():
    cameras = [dataclasses.replace(camera, camera_from_world_std=None) for camera in CAMERAS]
    given = [cameras[0], moved(cameras[1], np.array([2e-3, 1.5e-3, 0.0]), np.zeros(3)), cameras[2]]
    shift, seen = np.array([1.3, -2.4, 0.73]), looks(cameras, given)
    back = so3.transform(np.eye(3), -shift)
    elsewhere = [dataclasses.replace(c, camera_from_world=c.camera_from_world @ back) for c in given]
    there = [one._replace(position=one.position + shift, corners=one.corners + shift) for one in seen]
    near, far = check_calibration(seen, given), check_calibration(there, elsewhere)
    assert [one.moved for one in far.cameras] == [one.moved for one in near.cameras] == [False, True, False]
    assert far.cameras[1].shift_mm == pytest.approx(near.cameras[1].shift_mm, abs=1e-3)


def test_errors_as_large_as_files_state_are_no_motion():
    named = 0
    for seed in range(12):
        rng = np.random.default_rng([5, seed])
        given = [misplaced(camera, rng, *STATED) for camera in CAMERAS]
        named += not check_calibration(looks(CAMERAS, given, seed=seed), given).fits
    assert named <= 1


@pytest.mark.parametrize("count", [3, 20])
def test_errors_as_large_as_files_of_rougher_calibrations_state_are_no_motion_either(count):
    rough, named = (1.1e-3, 2.7e-3), 0  # of the recorded cubes
    for seed in range(20):
        rng = np.random.default_rng([8, seed])
        given = [off_as_stated(camera, rng, *rough) for camera in CAMERAS]
        found = check_calibration(looks(CAMERAS, given, count=count, seed=seed), given)
        named += any(one.moved for one in found.cameras)
    assert named <= 3


def test_many_looks_in_few_places_accuse_no_camera():
    named = 0
    for seed in range(12):
        rng = np.random.default_rng([5, seed])
        given = [misplaced(camera, rng, *STATED) for camera in CAMERAS]
        seen = looks(CAMERAS, given, count=2, seed=seed)
        views = [one.moved + rng.normal(size=(3, 6)) * np.repeat([5e-4, 5e-3], 3) for one in seen]
        few = [one._replace(moved=view) for one, view in zip(seen, views, strict=True)]
        named += not check_calibration(20 * few, given).fits
    assert named == 0


def test_a_look_that_is_far_off_does_not_convict_a_camera():
    seen = looks(CAMERAS, CAMERAS)
    astray = seen[3].moved.copy()
    astray[1, :3] += 0.03
    seen[3] = seen[3]._replace(moved=astray)
    assert check_calibration(seen, CAMERAS).fits


def test_a_camera_that_is_hidden_is_not_asked_and_one_that_cannot_use_what_it_shows_is_named():
    seeing = np.array([1.0, 1.0, 0.0])[:, None, None]
    hidden = [one._replace(information=seeing * one.information) for one in looks(CAMERAS, CAMERAS)]
    found = check_calibration(hidden, CAMERAS)
    assert found.fits
    assert found.cameras[2].looks == 0
    assert np.isnan(found.cameras[2].miss_px)
    assert found.warnings[0].startswith("camera300: not checked")
    lost = [one._replace(lost=np.array([False, False, True])) for one in hidden]
    found = check_calibration(lost, CAMERAS)
    assert not found.fits
    assert found.is_lost(found.cameras[2])


def test_looks_of_one_camera_alone_are_not_counted():
    seen = looks(CAMERAS, CAMERAS)
    for one in seen[3:]:
        one.information[1:] = 0.0
    found = check_calibration(seen, CAMERAS)
    assert found.looks == found.cameras[0].looks == 3


@pytest.mark.parametrize(("count", "share"), [(1, 0.01), (3, 0.01), (20, 0.001)])
def test_a_camera_that_sees_the_object_seldom_or_badly_is_not_accused(count, share, rng):
    spread = np.sqrt(np.diag(KNOWN) * share)
    for seed in range(4):
        seen = looks(CAMERAS, CAMERAS, seed=seed)
        for n, one in enumerate(seen):
            one.information[2] *= share * (n < count)
            one.moved[2] += rng.normal(size=6) / spread
        found = check_calibration(seen, CAMERAS)
        assert found.fits
        assert not any(one.moved for one in found.cameras)
        assert found.cameras[2].looks == count


def test_one_camera_is_refused_before_anything_is_read_and_so_is_no_look_of_two():
    unread, alone = Mock(side_effect=AssertionError), tracker.CameraRig(CAMERAS[:1])
    with pytest.raises(CalibrationError, match="camera60 alone"):
        check(tracker.load_object("cube_v2"), [Mock(shots=unread)], alone, tracker.load_colors("cube_v2"))
    lone = [one._replace(information=np.zeros((3, 6, 6))) for one in looks(CAMERAS, CAMERAS, count=2)]
    lone[0].information[1] = KNOWN
    lone[0].lost[0] = True
    # Each camera in turn sees the object alone, and another cannot use what it shows.
    turns = [one._replace(information=np.zeros((3, 6, 6))) for one in looks(CAMERAS, CAMERAS, count=12)]
    for n, one in enumerate(turns):
        one.information[n % 3], one.lost[(n + 1) % 3] = KNOWN, True
    for nothing in ([], lone, turns):
        with pytest.raises(CalibrationError, match="no set of images"):
            check_calibration(nothing, CAMERAS)


def test_stated_deviations_predict_the_misses_of_cameras_that_are_off_by_them():
    squares = []
    for seed in range(40):
        rng = np.random.default_rng([6, seed])
        given = [off_as_stated(camera, rng, *STATED) for camera in CAMERAS]
        for one in check_calibration(looks(CAMERAS, given, count=1, seed=seed), given).cameras:
            squares.append((one.corners_seen_px**2, one.corners_stated_px**2))
    seen, expected = np.sqrt(np.mean(squares, axis=0))
    assert seen == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(
    ("move", "part"), [((0, 0, 3e-3, 0, 0, 0), "shift"), ((0, 0, 0, 0, 0, 0.05), "shape")]
)
def test_a_shift_moves_all_corners_alike_and_a_turn_none_of_their_middle(move, part):
    one = looks(CAMERAS, CAMERAS, count=1)[0]
    seen = np.zeros((3, 6))
    seen[1] = move
    silent = [dataclasses.replace(CAMERAS[0], camera_from_world_std=None), *CAMERAS[1:]]
    found = check_calibration([one._replace(moved=seen)], silent).cameras[1]
    assert getattr(found, f"corners_{part}_px") > 0.98 * found.corners_seen_px > 0.5
    assert math.hypot(found.corners_shift_px, found.corners_shape_px) == pytest.approx(found.corners_seen_px)
    assert math.isnan(found.corners_stated_px)


def test_what_a_camera_has_nearer_along_its_line_of_sight_is_no_miss_wherever_the_object_is():
    one = looks(CAMERAS, CAMERAS, count=1)[0]._replace(position=np.array([0.12, -0.1, 0.03]))
    seen = np.zeros((3, 6))
    seen[0, :3] = 0.02 * (CAMERAS[0].position - one.position)
    assert check_calibration([one._replace(moved=seen)], CAMERAS).cameras[0].miss_px < 0.01


def test_cameras_that_observe_the_object_along_one_axis_disagree_along_it():
    one, seen = looks(CAMERAS, CAMERAS, count=1)[0], np.zeros((3, 6))
    one.information[:], seen[0, 0] = np.diag([1e8, 0, 0, 0, 0, 0]), 1e-3
    expected = CAMERAS[0].project_with_jacobian(one.position[None])[1][0, :, 0] * 1e-3
    missed = CameraErrors([one._replace(moved=seen)], CAMERAS).misses()
    np.testing.assert_allclose(missed[0, 0], expected, rtol=1e-2)


def test_errors_of_a_view_are_along_and_across_the_line_of_sight_wherever_the_object_is():
    one = looks(CAMERAS, CAMERAS, count=1)[0]._replace(position=np.array([0.12, -0.1, 0.03]))
    for c, camera in enumerate(CAMERAS):
        one.information[c] = 1e14 * np.eye(6)
        noise = np.linalg.inv(CameraErrors([one], CAMERAS).known[0, c])
        sight, away = one.position - camera.position, np.linalg.norm(camera.position - one.position)
        for first, along, across in ((0, ALONG * away, ACROSS * away), (3, ROLL, TILT)):
            part = noise[first : first + 3, first : first + 3]
            np.testing.assert_allclose(part @ sight, along**2 * sight, rtol=1e-3, atol=1e-9)
            assert np.trace(part) == pytest.approx(along**2 + 2 * across**2, rel=1e-3)


def test_pixels_that_are_not_square_change_no_angle():
    seen = looks(CAMERAS, [moved(CAMERAS[0], np.array([0.0, 0.0, 4e-3]), np.zeros(3)), *CAMERAS[1:]])
    tall = [camera.resized(camera.width, 2 * camera.height) for camera in CAMERAS]
    assert check_calibration(seen, tall).miss == pytest.approx(check_calibration(seen, CAMERAS).miss)


def test_focal_lengths_that_differ_are_named_with_the_depth_that_they_leave_open():
    given = []
    for camera, ratio in zip(CAMERAS, (1.0074, 0.998, 1.0), strict=True):
        matrix = camera.matrix.copy()
        matrix[1, 1] = ratio * matrix[0, 0]
        given.append(dataclasses.replace(camera, matrix=matrix))
    seen = [one._replace(position=np.zeros(3)) for one in looks(CAMERAS, CAMERAS, count=1)]
    found = check_calibration(seen, given, {"camera300": 0.01})
    assert len(found.warnings) == 1
    assert "camera60: fy/fx is 1.0074, expected 1 within 0.3 %" in found.warnings[0]
    for one, off, given_one in zip(found.cameras, (0.0037, 0.001, 0.01), given, strict=True):
        away = np.linalg.norm(given_one.position)
        assert one.depth_off_mm == pytest.approx(1e3 * off * away)
        assert one.focal_needed_percent == pytest.approx(0.2 / away)
    assert math.isnan(check_calibration(seen, given).cameras[2].depth_off_mm)  # nothing is known


@pytest.mark.parametrize(
    ("name", "stated"), [("cube_v1", 1.44), ("cube_v2", 1.44), ("cuboid_2x2x8_v2", 0.71)]
)
def test_of_recorded_platforms_focal_lengths_are_named_and_no_camera_however_often_images_are_repeated(
    name, stated, real
):
    rig = tracker.CameraRig.load(real / "pose" / name)
    images = [cv2.imread(str(real / "pose" / name / f"{camera}.png")) for camera in rig.names]
    model = tracker.load_object(name)
    for times in (1, 40):
        found = check(model, [Footage([images] * times)], rig, tracker.load_colors(model.colors))
        assert found.fits
        assert np.mean([one.corners_stated_px for one in found.cameras]) == pytest.approx(stated, abs=0.1)
        assert len(found.warnings) == 3
