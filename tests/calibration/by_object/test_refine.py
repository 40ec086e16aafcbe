import dataclasses

import numpy as np
import pytest

import tracker
from tests.helpers import RIG, make_rig, random_rotations
from tests.helpers.filmed import shots
from tests.helpers.moving_cube import PLACES, carried, knocked, relative_errors, rests
from tracker.calibration.by_object.check import check
from tracker.calibration.by_object.edges import Contour, seen_motion
from tracker.calibration.by_object.refine import (
    LEAST_STD,
    Unknowns,
    refine_cameras,
    relative_covariance,
    solve,
    wider,
)
from tracker.calibration.by_object.sightings import Footage, Shot, Sighting, different, observed, resting
from tracker.calibration.by_object.table import find_table, moved
from tracker.calibration.deviations import calibration_covariance
from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError, LogError
from tracker.geometry import so3
from tracker.logs.frame import LogFrame
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.logs.log import Log, Source
from tracker.pose.refine import EXPECTED_WEAR

TRUE = make_rig()
RIM = 0.2e-3, 0.3e-3
PIECES = 45


class World:
    """Poses of points on a cube, and what cameras would measure of them."""

    def __init__(self, rng, frames, noise):
        self.true = TRUE
        self.positions = rng.uniform([-0.1, -0.1, 0.03], [0.1, 0.1, 0.12], (frames, 3))
        self.rotations = random_rotations(rng, frames)
        size = (frames, len(TRUE), PIECES)
        self.points = rng.uniform(-0.0325, 0.0325, (*size, 3))
        angle = rng.uniform(0, 2 * np.pi, size)
        self.normals = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.edges = rng.integers(0, 9, size)
        self.rims = rng.uniform(-600, -200, size)
        common = rng.normal(0, EXPECTED_WEAR, (*size[:2], 9))
        white = rng.normal(0, 0.1, size)
        self.noise = noise * (white + np.take_along_axis(common, self.edges, axis=2))

    def view(self, f, cameras, rotation, position):
        contours = []
        for c, camera in enumerate(cameras):
            points = self.points[f, c] @ rotation.T + position
            pixels, slopes = camera.project_with_jacobian(points)
            normal = self.normals[f, c]
            along = np.einsum("ni,nij->nj", normal, slopes)
            truth = self.true[c].project(self.points[f, c] @ self.rotations[f].T + self.positions[f])
            offset = np.einsum("ni,ni->n", normal, truth - pixels) + self.rims[f, c] * 0.1e-3
            contours.append(
                Contour(
                    jacobian=np.concatenate([along, np.cross(points - position, along)], axis=1),
                    lens=np.column_stack([((pixels - camera.matrix[:2, 2]) * normal).sum(1), normal]),
                    bloom=np.zeros(PIECES),
                    rim=self.rims[f, c],
                    offset=offset + self.noise[f, c],
                    variance=np.full(PIECES, 0.1**2),
                    edge=self.edges[f, c],
                    foot=np.zeros(PIECES),
                )
            )
        return position, contours


def adjusted(world, start, *, focal=False, steps=6, rim=RIM):
    """Unknowns after some steps, and the last of these."""
    cameras = [dataclasses.replace(camera, camera_from_world_std=wider(camera)) for camera in start]
    now = Unknowns.of(cameras, rim, focal=focal)
    poses = list(zip(world.rotations, world.positions, strict=True))
    for _ in range(steps):
        step = solve([world.view(f, now.cameras, *pose) for f, pose in enumerate(poses)], now)
        poses = [(so3.exp(d[3:]) @ r, p + d[:3]) for (r, p), d in zip(poses, step.poses, strict=True)]
        now = now.moved(step.change, step.rim)
    return now, step


def test_without_noise_cameras_and_rim_are_found(rng):
    start = knocked(TRUE, seed=2)
    now, _ = adjusted(World(rng, 30, noise=0.0), start)
    found = CameraRig(now.cameras)
    assert np.abs(relative_errors(start, TRUE)[:, :3]).max() > 1e-3
    assert np.abs(relative_errors(found, TRUE)[:, :3]).max() < 0.02e-3
    assert np.degrees(np.abs(relative_errors(found, TRUE)[:, 3:]).max()) < 0.002
    assert now.rim == pytest.approx(0.1e-3, abs=0.005e-3)
    mean = now.errors[:, :6].mean(axis=0)  # what moves all cameras alike stays as it was
    assert np.abs(mean[:3]).max() < 0.05e-3
    assert np.degrees(np.abs(mean[3:]).max()) < 0.005


def test_of_cameras_that_state_unlike_deviations_the_weighted_mean_stays(rng):
    rough = 16.0 * TRUE[2].camera_from_world_std
    start = CameraRig((*TRUE[:2], dataclasses.replace(TRUE[2], camera_from_world_std=rough)))
    now, _ = adjusted(World(rng, 20, noise=0.0), knocked(start, seed=2))
    known, off = now.information[:, :6, :6], now.errors[:, :6]
    weighted = np.linalg.solve(known.sum(axis=0), np.einsum("cij,cj->i", known, off))
    np.testing.assert_allclose(weighted, 0.0, atol=1e-5)
    assert np.abs(off.mean(axis=0)).max() > 1e-4


def test_the_least_deviations_are_added_once_to_those_that_a_file_states():
    for stated in (None, np.zeros((4, 4)), TRUE[0].camera_from_world_std):
        given = dataclasses.replace(TRUE[0], camera_from_world_std=stated)
        wide = dataclasses.replace(given, camera_from_world_std=wider(given))
        prior = np.linalg.inv(Unknowns.of([wide], RIM, focal=False).information[0, :6, :6])
        added = prior - calibration_covariance(given)
        np.testing.assert_allclose(added, np.diag(np.repeat(np.square(LEAST_STD), 3)), atol=1e-12)


def test_lenses_are_found_where_they_may_be_wrong(rng):
    world = World(rng, 40, noise=0.0)
    wrong = []
    for c, camera in enumerate(TRUE):
        matrix = camera.matrix.copy()
        matrix[(0, 1), (0, 1)] *= 1.0 + 0.003 * (c - 1)
        matrix[0, 2] += 1.0
        wrong.append(dataclasses.replace(camera, matrix=matrix))
    start = CameraRig(wrong)
    now, _ = adjusted(world, start, focal=True)
    for camera, true in zip(now.cameras, TRUE, strict=True):
        assert camera.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=3e-4)
        assert camera.matrix[0, 2] == pytest.approx(true.matrix[0, 2], abs=0.1)
    kept, _ = adjusted(world, start, steps=1)
    for camera, before in zip(kept.cameras, start, strict=True):
        np.testing.assert_allclose(camera.matrix, before.matrix, rtol=1e-9)


def test_the_covariance_covers_the_errors():
    values = []
    for seed in range(12):
        world = World(np.random.default_rng([3, seed]), 20, noise=1.0)
        now, step = adjusted(world, TRUE, steps=2, rim=(0.1e-3, 1e-5))
        covariances = relative_covariance(step.covariance)
        for error, covariance in zip(relative_errors(CameraRig(now.cameras), TRUE), covariances, strict=True):
            values.append(error @ np.linalg.solve(covariance, error))
    # Six unknowns of each camera.
    assert 4.0 < np.mean(values) < 8.0


def test_edges_that_are_off_as_a_whole_make_the_cameras_less_certain(rng):
    world = World(rng, 20, noise=1.0)
    known = (0.1e-3, 1e-5)
    _, sharp = adjusted(world, TRUE, steps=3, rim=known)
    common = rng.normal(0, 0.2, (*world.edges.shape[:2], 9))
    world.noise = world.noise + np.take_along_axis(common, world.edges, axis=2)
    _, worn = adjusted(world, TRUE, steps=3, rim=known)
    assert worn.own == pytest.approx(0.2**2 + EXPECTED_WEAR**2, rel=0.3)
    assert sharp.own == pytest.approx(EXPECTED_WEAR**2, rel=0.5)
    spreads = [np.trace(relative_covariance(one.covariance)[0]) for one in (worn, sharp)]
    assert spreads[0] > spreads[1]


def test_a_rim_that_is_not_known_leaves_the_distances_open(rng):
    world = World(rng, 20, noise=1.0)
    stds = []
    for rim_std in (1e-5, 3e-4):
        _, step = adjusted(world, TRUE, steps=1, rim=(0.1e-3, rim_std))
        stds.append(np.sqrt([np.trace(one[:3, :3]) for one in relative_covariance(step.covariance)]))
    assert (stds[1] > 1.1 * stds[0]).all()


def test_eliminating_the_poses_changes_nothing(rng):
    """Against all unknowns solved for at once."""
    world, frames = World(rng, 4, noise=1.0), 4
    now = Unknowns.of(TRUE.cameras, RIM, focal=True)
    views = [world.view(f, now.cameras, world.rotations[f], world.positions[f]) for f in range(frames)]
    step = solve(views, now)
    size = 6 * frames + 31
    matrix, right = np.zeros((size, size)), np.zeros(size)
    for f, (position, contours) in enumerate(views):
        for c, contour in enumerate(contours):
            rows = np.zeros((PIECES, size))
            rows[:, 6 * f : 6 * f + 6] = contour.jacobian
            its = 6 * frames + 10 * c
            rows[:, its : its + 6] = contour.jacobian @ seen_motion(position)
            rows[:, its + 7 : its + 10] = contour.lens
            rows[:, -1] = contour.rim
            left = contour.offset - contour.rim * now.rim
            weight = np.clip(1.0 - (left / max(0.4, 4.685 * step.residual)) ** 2, 0.0, None) ** 2
            found = contour.information(np.column_stack([rows, left]), weight, step.own)
            matrix += found[:-1, :-1]
            right += found[:-1, -1]
        held = slice(6 * f, 6 * f + 6)
        matrix[held, held] += np.diag(np.repeat([2e-2**-2.0, 0.3**-2.0], 3))
    for c, information in enumerate(now.information):
        its = slice(6 * frames + 10 * c, 6 * frames + 10 * c + 10)
        matrix[its, its] += information
    matrix[-1, -1] += RIM[1] ** -2.0
    unit = 1.0 / np.sqrt(np.diag(matrix))
    expected = unit * np.linalg.solve(matrix * np.outer(unit, unit), unit * right)
    np.testing.assert_allclose(step.poses.ravel(), expected[: 6 * frames], rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(step.change.ravel(), expected[6 * frames : -1], rtol=1e-5, atol=1e-10)
    assert step.rim - now.rim == pytest.approx(expected[-1], rel=1e-5)


MODEL, COLORS = tracker.load_object("cube_v2"), tracker.load_colors("cube_v2")
ALONE = tracker.CameraRig((RIG[0],))
WRONG = knocked(RIG, seed=4)
BACK = dataclasses.replace(RIG[2], camera_from_world=np.linalg.inv(RIG[2].camera_from_world))
AWAY = tracker.CameraRig((*WRONG[:2], BACK))


def footage(stills):
    return Footage([still.images for still in stills])


class Film:
    """Pictures at 10 Hz, unless another period is given [s]; each camera's `lag` after the one before [s]."""

    def __init__(self, frames, period=0.1, lag=0.0):
        self.frames, self.period, self.lags = frames, period, lag * np.arange(3)

    def shots(self):
        for k, images in enumerate(self.frames):
            yield Shot(k, images, self.period * k + self.lags, k == 0)

    def images(self, numbers):
        return (self.frames[number] for number in numbers)


@pytest.fixture(scope="module")
def found():
    return refine_cameras(MODEL, [footage(carried())], WRONG, COLORS)


def test_cameras_come_to_stand_as_they_do(found):
    before, after = relative_errors(WRONG, RIG), relative_errors(found.rig, RIG)
    assert np.linalg.norm(before[:, :3], axis=1).max() > 1.5e-3
    assert np.linalg.norm(after[:, :3], axis=1).max() < 0.3e-3
    assert np.degrees(np.linalg.norm(after[:, 3:], axis=1).max()) < 0.05
    assert found.after < 0.2 < 0.5 * found.before


def test_what_is_stated_of_the_cameras_covers_their_errors(found):
    error = relative_errors(found.rig, RIG)
    assert (np.abs(error) < 4.0 * found.std).all()
    # Edges of real objects err as well, of which these pictures have nothing.
    assert 0.07 < np.sqrt(np.mean((error / found.std) ** 2)) < 0.15
    assert all(camera.camera_from_world_std is not None for camera in found.rig)


def test_the_rim_is_that_of_drawn_boxes_which_have_none(found):
    rim, std = found.rim
    assert 0.04e-3 < std < 0.3e-3  # better known than before, as far as edges can tell
    assert abs(rim) < 3.0 * std


def test_the_world_stays_where_the_old_cameras_have_it(found):
    assert found.plane is None
    for axis in range(3):
        before, after = (np.mean([camera.position[axis] for camera in rig]) for rig in (WRONG, found.rig))
        assert abs(before - after) < 1.5e-3


def test_rests_bring_the_world_to_the_table():
    world, both = moved(WRONG, floating(0.004, 0.0)), [footage(carried()), footage(rests())]
    found = refine_cameras(MODEL, both, world, COLORS)
    assert found.plane is not None
    assert found.rig.arena.table == 0.0
    pose = tracker.ObjectTracker(MODEL, found.rig).detect(rests()[0].images).object_pose
    assert abs(pose.position[2] - 0.0325) < 0.2e-3


def test_where_the_origin_of_the_world_is_changes_nothing_but_that(found):
    x, y, z = 1.3, -2.4, 0.73
    arena = dataclasses.replace(WRONG.arena, center=(-x, -y), table=-z)
    away = dataclasses.replace(moved(WRONG, so3.transform(np.eye(3), [x, y, z])), arena=arena)
    there = refine_cameras(MODEL, [footage(carried())], away, COLORS)
    np.testing.assert_allclose(there.moved, found.moved, atol=1e-6)
    np.testing.assert_allclose(there.std, found.std, rtol=1e-3)
    assert there.rig.arena == arena
    back = moved(there.rig, so3.transform(np.eye(3), [-x, -y, -z]))
    np.testing.assert_allclose(relative_errors(back, found.rig), 0.0, atol=1e-6)
    level = refine_cameras(MODEL, [footage(carried()), footage(rests())], away, COLORS)
    assert level.rig.arena.table == 0.0
    assert level.rig.arena.center == level.plane.center == arena.center
    assert level.plane.height == pytest.approx(-z, abs=0.01)
    pose = tracker.ObjectTracker(MODEL, level.rig).detect(rests()[0].images).object_pose
    np.testing.assert_allclose(pose.position, [*np.subtract(PLACES[0], (x, y)), 0.0325], atol=3e-3)


EMPTY = [np.full((270, 270, 3), 110, np.uint8)] * 3


def test_a_film_goes_on_where_a_camera_that_leads_by_more_than_a_period_misses_an_image(tmp_path):
    with Hdf5LogWriter(tmp_path / "log.h5", RIG) as writer:
        for stamp, first, leading in ((10.0, EMPTY[0], 10.15), (10.1, None, 10.15), (10.2, EMPTY[0], 10.35)):
            writer.append([first, *EMPTY[1:]], stamp, [leading, stamp, stamp])
    tracked = tracker.ObjectTracker(MODEL, RIG)
    with tracker.open_log(tmp_path / "log.h5") as log:
        assert len(list(observed(tracked, Footage(log)))) == 3


class Episodes(Source):
    """Two episodes of three frames; the first frame of the second is damaged."""

    format, camera_names, count, gaps, episode_starts = "", RIG.names, 6, True, (0, 3)

    def read(self, index):
        if index == 3:
            raise LogError("damaged")
        return LogFrame(index, float(index), np.full(3, float(index)), tuple(EMPTY), None, None)


def test_an_episode_whose_first_frame_is_damaged_begins_with_its_next(tmp_path):
    given = Footage(Log(Episodes(tmp_path), recover=True)).shots()
    assert [shot.number for shot in given if shot.begins] == [0, 4]


@pytest.mark.parametrize(
    ("film", "rig", "message"),
    [
        (lambda: footage(carried()), ALONE, "camera60 alone"),
        (lambda: footage(carried()), AWAY, "camera300: found that [01] of .* show cube_v2"),
        (lambda: Film([rests()[0].images] * 5), WRONG, "found 1 different poses .* expected 18"),
        (lambda: footage(rests() * 3), WRONG, "move and turn it .* need a board"),
        (lambda: Film([EMPTY] * 3), WRONG, "no frame in which cube_v2 is surely seen; .* need a board"),
        (
            lambda: Film([one.images for one in carried()], lag=0.005),
            RIG,
            "in 27 more it moved between the cameras' images",
        ),
    ],
    ids=["one camera", "an inverted camera", "at rest", "never turned", "no object", "too fast to follow"],
)
def test_what_betters_no_calibration_is_refused_with_the_reason(film, rig, message):
    with pytest.raises(CalibrationError, match=message):
        refine_cameras(MODEL, [film()], rig, COLORS)


@pytest.mark.parametrize("command", [refine_cameras, find_table, check])
def test_images_of_another_object_are_refused(command):
    """Whether the object is taken to be seen in some of them or in none, and wherever the cameras are."""
    shown = shots("cuboid_2x2x8_v2", 7, seed=513)
    for stills in (shown, shown[:1]):
        with pytest.raises(CalibrationError, match=r"the images show .*cuboid_2x2x8_v2.* rather"):
            command(MODEL, [footage(stills)], WRONG, COLORS)


@pytest.mark.parametrize("period", [0.1, 0.6, 5.0])
def test_what_rests_is_checked_at_any_frame_rate_and_what_moves_never(period):
    film = Film([still.images for still in rests() for _ in range(6)], period)
    assert check(MODEL, [film], RIG, COLORS).looks == len(rests())
    with pytest.raises(CalibrationError, match="no set of images"):
        check(MODEL, [Film([still.images for still in carried()], period)], RIG, COLORS)


def floating(height=0.005, degrees=1.0):
    """(4, 4) to the true world from one that floats."""
    return so3.transform(so3.exp(np.radians([degrees, 0.0, 0.0])), [0.0, 0.0, height])


@pytest.mark.parametrize("height", [0.005, -0.006])
def test_a_floating_world_comes_down_to_the_table(height):
    rig, plane, _ = find_table(MODEL, [footage(rests())], moved(RIG, floating(height)), COLORS)
    assert len(plane.used) == len(rests())
    for before, after in zip(RIG, rig, strict=True):
        new_from_true = np.linalg.inv(after.camera_from_world) @ before.camera_from_world
        assert abs(new_from_true[2, 3]) < 0.1e-3
        assert np.degrees(np.linalg.norm(so3.log(new_from_true[:3, :3])[:2])) < 0.05
    assert rig.arena.table == 0.0
    assert rig.arena.table_std[0] < 0.5e-3


def test_several_films_and_stills_count_together():
    parts, twice = [footage(rests()[:2]), footage(rests()[2:])], [footage(rests()), footage(rests())]
    given = parts, twice, [footage(rests())]
    one, again, other = (find_table(MODEL, films, RIG, COLORS)[1] for films in given)
    assert one.height == again.height == other.height
    assert again.std == other.std  # the same place is no further evidence


@pytest.mark.parametrize(
    ("seen", "rig", "message"),
    [
        (lambda images: images, ALONE, "found camera60 alone, expected two cameras"),
        (lambda images: [[one[0], None, None] for one in images], RIG, "one camera"),
        (lambda images: images[:3] * 2, RIG, "found 3 places in which the object rests, expected 5 or more"),
        (lambda images: np.full_like(images[:2], 110), RIG, "no set of images in which cube_v2 is surely"),
    ],
    ids=["one camera", "seen by one camera", "few places", "no object"],
)
def test_what_shows_no_table_is_refused_with_the_reason(seen, rig, message):
    with pytest.raises(CalibrationError, match=message):
        find_table(MODEL, [Footage(list(seen([still.images for still in rests()])))], rig, COLORS)


STILL, FILM = np.zeros(6), Film([])


def sighting(number, *, at=(0.0, 0.0), turn=(0.0, 0.0, 0.3), velocity=STILL, begins=False):
    return Sighting(FILM, number, np.array([*at, 0.0325]), so3.exp(turn), velocity, np.zeros(2), begins)


@pytest.mark.parametrize(
    ("film", "found"),
    [
        ([sighting(k, begins=k == 0) for k in range(30)], [15]),
        ([sighting(k, at=(0.05 * (k // 5), 0.0)) for k in range(15)], [2, 7, 12]),
        ([sighting(k, velocity=np.array([0.02, 0, 0, 0, 0, 0])) for k in range(10)], []),
        ([sighting(k, velocity=np.array([0, 0, 0, 0, 0.2, 0])) for k in range(10)], []),
        ([sighting(k, turn=(np.radians(20), 0.0, 0.0)) for k in range(10)], []),
        ([sighting(k) for k in range(2)], []),
        ([sighting(k) for k in (0, 2, 4, 6)], []),
        ([sighting(k, begins=k in (0, 2)) for k in range(4)], []),
        ([sighting(k, velocity=None, begins=True) for k in range(4)], [0, 1, 2, 3]),
    ],
    ids=["one", "places", "moves", "turns", "on an edge", "too short", "gaps", "two films", "stills"],
)
def test_a_rest_of_some_frames_in_a_row_counts_once(film, found):
    assert [one.number for one in resting(film)] == found


def anywhere(count, rng, *, speed=0.0, turning=0.0, skew=0.0):
    places = rng.uniform([-0.1, -0.1, 0.03], [0.1, 0.1, 0.1], (count, 3))
    velocity = np.array([speed, 0, 0, 0, turning, 0])
    return [
        Sighting(FILM, k, place, rotation, velocity, skew * np.array([speed, turning]), k == 0)
        for k, (place, rotation) in enumerate(zip(places, random_rotations(rng, count), strict=True))
    ]


def test_poses_are_taken_once_no_more_than_requested_spread_evenly_and_too_few_refused(rng):
    once = anywhere(30, rng)
    assert different("cube", once * 2, 100) == once
    with pytest.raises(CalibrationError, match=r"found 10 different poses .*expected 18 or more"):
        different("cube", anywhere(10, rng), 100)
    # Some are turned to both sides of the first: by 50° from each other.
    angles = np.radians([0.0, 25.0, -25.0] * 10)
    turned = [dataclasses.replace(p, rotation=so3.exp([0, 0, a])) for p, a in zip(once, angles, strict=True)]
    assert different("cube", turned, 100) == turned
    numbers = [one.number for one in different("cube", anywhere(90, rng), 30)]
    assert len(numbers) == 30
    assert numbers[0] == 0
    assert numbers[-1] == 89
    assert max(np.diff(numbers)) <= 4


def test_pictures_that_cameras_took_one_after_the_other_do_not_count_while_it_moves(rng):
    still, moving = anywhere(20, rng, skew=0.01), anywhere(20, rng, skew=0.01, speed=0.3)
    assert different("cube", still + moving, 100) == still
    with pytest.raises(CalibrationError, match="in 20 more it moved between the cameras' images"):
        different("cube", moving, 100)
    turning = anywhere(20, rng, skew=0.01, turning=1.5)
    assert different("cube", still + turning, 100) == still
