import dataclasses

import numpy as np
import pytest
from scipy.optimize import nnls

from tests.helpers import make_camera, make_rig, numerical_jacobian, random_rotations
from tracker.calibration.by_object.edges import Contour, pose_errors, pose_information, seen_motion
from tracker.calibration.by_object.table import FLOOR, Rest, _equations, fit_table, levelled
from tracker.calibration.deviations import calibration_covariance, element_std, rotation_vector_variance
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.cuboid import corners

SIZES = np.array([(0.065, 0.065, 0.065), (0.02, 0.08, 0.02)])
RIG = make_rig()
OWN = np.diag(np.repeat(np.square([0.06e-3, 1e-3]), 3))


def world(height=0.005, degrees=1.0, azimuth=0.7):
    """Rotation and shift from the table's world to a tilted one that floats."""
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return so3.exp(np.radians(degrees) * axis), np.array([0.0, 0.0, height])


TILTED = world()


def truth(tilt, shift, center=(0.0, 0.0)):
    """Height and slopes of the table in that world."""
    normal = tilt[:, 2]
    slope = -normal[:2] / normal[2]
    return np.array([shift[2] + slope @ center, *slope])


def rests(count, rng, size=SIZES[0], *, held=0, placed=TILTED, radius=0.17, noise=1.0):
    """Poses at rest and others held flat above the table, with their own errors."""
    tilt, shift = placed
    result = []
    for k in range(count + held):
        axis = rng.integers(3)
        lying = so3.exp(np.eye(3)[axis] * np.pi / 2 * rng.integers(4))
        angle, distance = rng.uniform(0, 2 * np.pi), radius * np.sqrt(rng.random())
        rotation = so3.exp([0, 0, rng.uniform(0, 2 * np.pi)]) @ lying
        lowest = np.abs(rotation[2]) @ size / 2
        position = np.array([distance * np.cos(angle), distance * np.sin(angle), lowest])
        if k >= count:
            position[2] += rng.uniform(0.001, 0.03)
            rotation = so3.exp(np.radians(rng.normal(0, 1.0, 3)) * [1, 1, 0]) @ rotation
        error = noise * np.sqrt(np.diag(OWN)) * rng.normal(size=6)
        position, rotation = tilt @ position + shift + error[:3], so3.exp(error[3:]) @ tilt @ rotation
        # As three cameras with equal weights see an object at the origin.
        result.append(Rest(position, rotation, OWN, np.tile(np.eye(6)[:, None] / 3, (1, 3, 1))))
    return result


@pytest.mark.parametrize("size", SIZES)
def test_moves_of_the_equations_are_their_derivatives(size, rng):
    for rest in rests(6, rng, size):
        values, design, moves = _equations(rest, size, (0.01, -0.02))

        def left(error, rest=rest, slope=values[1:]):
            turned = dataclasses.replace(
                rest, position=rest.position + error[:3], rotation=so3.exp(error[3:]) @ rest.rotation
            )
            found, its, _ = _equations(turned, size, (0.01, -0.02))
            return found - its @ [0.0, *slope]

        np.testing.assert_allclose(numerical_jacobian(left, np.zeros(6)), moves, atol=1e-6)
        ends = corners(size) @ rest.rotation.T + rest.position
        contact = ends[np.argsort(ends[:, 2])[:4]].mean(axis=0)
        np.testing.assert_allclose(design[0, 1:], contact[:2] - [0.01, -0.02])
        assert values[0] == pytest.approx(contact[2])


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("height", "degrees"), [(0.0, 0.0), (0.005, 1.0), (-0.006, 2.0)])
def test_exact_rests_give_the_table_exactly(size, height, degrees, rng):
    placed = world(height, degrees)
    found = fit_table(rests(8, rng, size, placed=placed, noise=0.0), size, RIG)
    np.testing.assert_allclose([found.height, *found.slope], truth(*placed), atol=1e-9)
    assert found.scatter < 1e-9
    np.testing.assert_allclose(found.used, 1.0)


def test_objects_held_flat_most_of_the_time_do_not_lift_the_table():
    for seed in range(20):
        found = fit_table(rests(10, np.random.default_rng(seed), held=40), SIZES[0], RIG)
        off = np.array([found.height, *found.slope]) - truth(*TILTED)
        assert abs(off[0]) < 0.2e-3
        assert np.degrees(np.linalg.norm(off[1:])) < 0.1


def test_what_all_poses_share_is_not_averaged_away():
    few, many = (fit_table(rests(n, np.random.default_rng(1)), SIZES[0], RIG).covariance for n in (8, 200))
    shared = sum(calibration_covariance(camera) for camera in RIG)[2, 2] / 9
    assert many[0, 0] < few[0, 0]
    np.testing.assert_allclose(many[0, 0], shared, rtol=0.05)


def test_the_covariance_covers_errors_of_the_cameras():
    values = []
    for seed in range(150):
        rng = np.random.default_rng([2, seed])
        roots = [np.linalg.cholesky(calibration_covariance(camera)) for camera in RIG]
        moved = sum(root @ rng.normal(size=6) for root in roots) / 3
        turn = so3.exp(moved[3:])
        seen = [
            dataclasses.replace(rest, position=rest.position + moved[:3], rotation=turn @ rest.rotation)
            for rest in rests(8, rng)
        ]
        found = fit_table(seen, SIZES[0], RIG)
        off = np.array([found.height, *found.slope]) - truth(*TILTED)
        values.append(off @ np.linalg.solve(found.covariance, off))
    # The floors count for errors of real tables, which these poses have not.
    assert 1.5 < np.mean(values) < 4.0


@pytest.mark.parametrize("placed", [world(-0.005, 1.2), world(0.75, 1.0), world(0, 0)])
def test_in_the_new_world_the_table_is_level_and_the_rest_as_before(placed, rng):
    found = fit_table(rests(8, rng, placed=placed, noise=0.0), SIZES[0], RIG)
    rig = levelled(RIG, found)
    assert rig.arena.table == 0.0
    assert rig.arena.table_std == found.std
    for before, after in zip(RIG, rig, strict=True):
        new_from_old = np.linalg.inv(after.camera_from_world) @ before.camera_from_world
        # The table's points of the old world are at z = 0 in the new one, the middle at the same x and y.
        points = np.array(
            [[x, y, found.height + found.slope @ [x, y], 1.0] for x, y in ((0, 0), (0.1, 0), (0, 0.1))]
        )
        moved = points @ new_from_old.T
        np.testing.assert_allclose(moved[:, 2], 0.0, atol=1e-9)
        np.testing.assert_allclose(moved[0, :2], 0.0, atol=1e-9)
        assert abs(so3.log(new_from_old[:3, :3])[2]) < 1e-9
        # Deviations of a position are those of the new origin in the camera: an error turns it about the old.
        origin = np.linalg.inv(new_from_old)[:3, 3]
        rotation, std = before.camera_from_world[:3, :3], before.camera_from_world_std
        swing = so3.hat(rotation @ origin)
        turns = swing @ np.diag(rotation_vector_variance(rotation, std[:3, :3])) @ swing.T
        expected = np.sqrt(std[:3, 3] ** 2 + np.diag(turns))
        np.testing.assert_allclose(after.camera_from_world_std[:3, 3], expected, rtol=1e-6)
        if not placed[1].any():
            np.testing.assert_allclose(new_from_old, np.eye(4), atol=1e-9)
            before, after = calibration_covariance(before), calibration_covariance(after)
            np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-12)


def test_without_a_stated_table_the_arena_stays_where_it_is(rng):
    arena = dataclasses.replace(RIG.arena, table=None)
    found = fit_table(rests(8, rng, placed=world(-0.15, 0), noise=0.0), SIZES[0], RIG)
    assert levelled(dataclasses.replace(RIG, arena=arena), found).arena.height == pytest.approx(0.335)
    assert levelled(RIG, found).arena.height == RIG.arena.height


def in_a_line(rng):
    return [
        dataclasses.replace(rest, position=np.array([0.03 * k - 0.1, 0.05, rest.position[2]]))
        for k, rest in enumerate(rests(8, rng, placed=world(0, 0)))
    ]


@pytest.mark.parametrize(
    ("seen", "message"),
    [
        (lambda rng: rests(3, rng), "found 3 places in which the object rests, expected 5"),
        (lambda rng: rests(1, rng, held=8), "to lie on one plane"),
        (in_a_line, r"spread by 0 mm only.*lay it also near"),
    ],
)
def test_rests_that_give_no_plane_are_refused_with_the_reason(seen, message, rng):
    with pytest.raises(CalibrationError, match=message):
        fit_table(seen(rng), SIZES[0], RIG)


def test_five_rests_that_err_as_is_assumed_are_enough():
    errors = np.array([0.0, 0.0, FLOOR[0], FLOOR[1], FLOOR[1], 0.0])
    for seed in range(40):
        rng = np.random.default_rng([7, seed])
        seen = []
        for rest, azimuth in zip(rests(5, rng, placed=world(0, 0)), np.arange(5) * 0.4 * np.pi, strict=True):
            error, place = errors * rng.normal(size=6), 0.1 * np.array([np.cos(azimuth), np.sin(azimuth), 0])
            height = rest.position * [0, 0, 1]
            turn = so3.exp(error[3:])
            moved = place + turn @ height + error[:3]  # turned about where it stands
            seen.append(dataclasses.replace(rest, position=moved, rotation=turn @ rest.rotation))
        assert np.count_nonzero(fit_table(seen, SIZES[0], RIG).used) == 5


POSITION = np.array([0.06, -0.09, 0.03])
RIM_STD = 3e-4


def made_contour(rng, count=60):
    jacobian = rng.normal(size=(count, 6)) * np.repeat([500.0, 12.0], 3)
    return Contour(
        jacobian=jacobian,
        lens=np.zeros((count, 3)),
        bloom=rng.uniform(0, 0.2, count),
        rim=rng.uniform(200, 500, count),
        offset=rng.normal(0, 0.1, count),
        variance=np.full(count, 0.1**2),
        edge=rng.integers(0, 9, count),
        foot=np.zeros(count),
    )


def test_own_and_shared_errors_add_up_to_what_joint_least_squares_says(rng):
    contours = [made_contour(rng, count) for count in (60, 40, 90)]
    own, common = pose_errors(contours, POSITION, RIG.cameras, RIM_STD)
    known = np.zeros((24, 24))
    motion = seen_motion(POSITION)
    for c, (contour, camera) in enumerate(zip(contours, RIG.cameras, strict=True)):
        its = np.zeros((6, 24))
        its[:, :6], its[:, 6 + 6 * c : 12 + 6 * c] = np.eye(6), motion
        known += its.T @ pose_information(contour, RIM_STD) @ its
        block = slice(6 + 6 * c, 12 + 6 * c)
        known[block, block] += np.linalg.inv(calibration_covariance(camera))
    expected = np.linalg.inv(known)[:6, :6]
    total = own.copy()
    for c, camera in enumerate(RIG.cameras):
        total += common[:, c] @ calibration_covariance(camera) @ common[:, c].T
    np.testing.assert_allclose(total, expected, rtol=2e-3, atol=1e-3 * np.abs(expected).max())


def test_cameras_that_err_alike_move_the_pose_as_much_and_one_that_sees_nothing_not(rng):
    _, common = pose_errors([made_contour(rng) for _ in RIG.cameras], POSITION, RIG.cameras, RIM_STD)
    np.testing.assert_allclose(common.sum(axis=1), seen_motion(POSITION), atol=5e-3)
    _, common = pose_errors([made_contour(rng), None, made_contour(rng)], POSITION, RIG.cameras, RIM_STD)
    assert not common[:, 1].any()
    assert common[:, 0].any()


def test_a_point_moves_as_the_world_does(rng):
    error = rng.normal(size=6) * 1e-6
    moved = so3.exp(error[3:]) @ POSITION + error[:3]
    np.testing.assert_allclose(seen_motion(POSITION) @ error, [*(moved - POSITION), *error[3:]], atol=1e-11)


@pytest.mark.parametrize("own", [0.0, 0.05**2])
def test_offsets_that_pieces_share_are_as_unknowns_of_their_own(own, rng):
    contour = made_contour(rng, 30)
    columns, weight = rng.normal(size=(30, 4)), rng.uniform(0, 1, 30)
    covariance = np.diag(contour.variance / weight) + own * (contour.edge[:, None] == contour.edge)
    expected = columns.T @ np.linalg.solve(covariance, columns)
    np.testing.assert_allclose(contour.information(columns, weight, own), expected, rtol=1e-9)


def test_rotation_vectors_are_those_of_element_wise_std_or_come_nearest_to_them(rng):
    negative = 0
    for rotation in random_rotations(rng, 20):
        design = np.stack([(so3.hat(axis) @ rotation).ravel() ** 2 for axis in np.eye(3)], axis=1)
        variances = rng.uniform(0.5, 2.0, 3) * 1e-6
        found = rotation_vector_variance(rotation, np.sqrt(design @ variances).reshape(3, 3))
        np.testing.assert_allclose(found, variances, rtol=1e-6, atol=1e-12)
        std = rng.uniform(0.0, 2e-3, (3, 3))  # of no rotation vector
        expected, _ = nnls(design, std.ravel() ** 2)
        negative += expected.min() == 0.0
        np.testing.assert_allclose(rotation_vector_variance(rotation, std), expected, rtol=1e-9, atol=1e-18)
    assert 0 < negative < 20


@pytest.mark.parametrize("azimuth", [0, 77, 300])
def test_what_is_stated_element_by_element_reads_back_as_the_same_covariance_else_as_exact(azimuth, rng):
    camera = make_camera(azimuth)
    rotation = camera.camera_from_world[:3, :3]
    # Errors along the camera's own axes, which is all that elements can state.
    turned = np.kron(np.eye(2), rotation.T)
    stated = turned @ np.diag(rng.uniform(0.2, 2.0, 6) * 1e-6) @ turned.T
    known = dataclasses.replace(camera, camera_from_world_std=element_std(rotation, stated))
    np.testing.assert_allclose(calibration_covariance(known), stated, rtol=1e-5, atol=1e-11)
    np.testing.assert_allclose(calibration_covariance(known, -1) @ stated, np.eye(6), atol=1e-5)
    silent = dataclasses.replace(camera, camera_from_world_std=None)
    assert np.sqrt(np.diag(calibration_covariance(silent))).max() < 1e-4


def test_edges_that_may_stand_in_a_shadow_say_less(rng):
    contour = made_contour(rng)
    columns, weight = np.column_stack([contour.jacobian, contour.rim]), np.ones(60)
    for own in (0.0, 0.1**2):
        sharp = contour.information(columns, weight, own)
        standing = dataclasses.replace(contour, foot=np.where(contour.edge < 3, 0.5, 0.0))
        less = sharp - standing.information(columns, weight, own)
        assert np.linalg.eigvalsh(less).min() > -1e-9 * np.abs(sharp).max()
        # An offset of each of three edges is unknown, each of which takes one direction.
        assert np.linalg.matrix_rank(less, tol=1e-9 * np.abs(sharp).max()) == 3
