import dataclasses
import itertools

import cv2
import numpy as np
import pytest

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from tests.helpers import look_at, make_camera, random_rotations
from tests.helpers.kept_stills import bare
from tests.helpers.pushed_cube import MODEL, pose_at, shot
from tracker import Arena
from tracker.geometry import cuboid, so3
from tracker.geometry.lens import project, stack_lenses
from tracker.objects.model import Box
from tracker.pose.align import WHOLLY, align, count_labels, explanation_score
from tracker.pose.estimate import REFINED, PoseEstimator
from tracker.pose.evidence import NUMBERS, RESIZED, resized
from tracker.pose.fit import SEEN, Fit
from tracker.pose.hypotheses import EVERYWHERE, LIKELIEST, NEARBY, TURNS, Search
from tracker.pose.judge import settled
from tracker.pose.rotations import ROTATIONS, even_rotations, likely_rotations, rotation_grid
from tracker.pose.scale import label_camera, label_factors
from tracker.pose.schedule import FIRST
from tracker.pose.strips import MAX_STRIPS, STRIP
from tracker.pose.views import PICTURE
from tracker.pose.votes import CELL, DOUBT, MOST_POINTS, TIGHT, PositionSearch, _grid, vote
from tracker.segmentation.sensor import LOUD

BOX = Box.of(MODEL)
FACES = BOX.half, BOX.face_labels
STILL = np.zeros((3, 6))


@pytest.fixture(scope="module")
def scene():
    """Perfect label maps of the reduced images of a cube without fingers, and the truth."""
    cameras = default_cameras()
    truth = bare(MODEL, cameras, 5, Sensor.clean())
    small = [label_camera(camera, 2) for camera in cameras]
    # The middle one of each 2×2 block would shift by half a pixel; any of the four is as good here.
    labels = np.stack([image[::2, ::2] for image in truth.labels])
    return small, labels, truth


def counted_at(scene, rotation, position, blur=0.0):
    cameras, labels, _ = scene
    seen, lenses = np.zeros(3, SEEN), stack_lenses(cameras)
    seen["blur"] = blur
    count_labels(lenses, labels, pictures_of(labels), FACES, rotation, position, STILL, seen)
    return seen


def test_rotations_are_even():
    rotations = even_rotations(ROTATIONS)
    squares = rotations @ rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=1e-12)
    traces = np.einsum("nij,mij->nm", random_rotations(np.random.default_rng(1), 300), rotations)
    nearest = np.degrees(np.arccos(np.clip((traces.max(axis=1) - 1) / 2, -1, 1)))
    assert nearest.max() < 25
    assert np.median(nearest) < 15


def pictures_of(labels):
    """(C,) of PICTURE of label maps (C, h, w) that all count; the images are twice as large."""
    pictures = np.zeros(len(labels), PICTURE)
    pictures["height"], pictures["width"] = 2 * labels.shape[1], 2 * labels.shape[2]
    pictures["used"], pictures["colored"] = True, (labels > 0).sum(axis=(1, 2))
    return pictures


def test_search_finds_position_and_rotation(scene):
    cameras, labels, truth = scene
    pictures = pictures_of(labels)
    search = PositionSearch(cameras, BOX, Arena())
    positions = list(search(search.views(labels, pictures), labels, pictures, 3))
    assert np.linalg.norm(positions[0] - truth.position) < 0.015
    rotations = np.empty((5, 3, 3))
    likely_rotations(stack_lenses(cameras), labels, pictures, FACES, positions[0], rotation_grid(), rotations)
    turned = [so3.angle_between(r, truth.rotation) for r in rotations]
    assert np.degrees(min(turned)) < 30


def test_points_that_one_camera_views_do_not_outvote_the_place_that_all_view():
    model, cameras = tracker.load_object("cuboid_2x2x8_v2"), default_cameras()
    truth, small = bare(model, cameras, 8, Sensor.clean()), [label_camera(one, 2) for one in cameras]
    labels = np.stack([image[::2, ::2] for image in truth.labels])
    for radius in (0.4, 0.6):
        search = PositionSearch(small, Box.of(model), Arena(radius=radius, height=radius, table=None))
        pictures = pictures_of(labels)
        (place,) = search(search.views(labels, pictures), labels, pictures, 1)
        assert np.linalg.norm(place - truth.position) < 0.015


@pytest.mark.parametrize("degrees", [45, 55, 65, 75])
def test_cameras_that_look_aside_rank_no_rotation(scene, degrees):
    cameras, labels, truth = scene
    turn = so3.transform(so3.exp([0.0, np.radians(degrees), 0.0]), np.zeros(3))
    aside = [dataclasses.replace(one, camera_from_world=turn @ one.camera_from_world) for one in cameras]
    alone, wider = np.empty((2, 20, 3, 3))
    for rig, seen, out in (
        (cameras, labels, alone),
        ([*cameras, *aside], np.concatenate([labels, np.zeros_like(labels)]), wider),
    ):
        likely_rotations(
            stack_lenses(rig), seen, pictures_of(seen), FACES, truth.position, rotation_grid(), out
        )
    np.testing.assert_array_equal(wider, alone)


@pytest.mark.parametrize("label", [4, 6])
def test_a_block_in_a_faces_colour_beside_the_object_hides_no_rotation(label):
    model, cameras = tracker.load_object("cuboid_2x2x8_v2"), default_cameras()
    box, truth = Box.of(model), bare(model, cameras, 8, Sensor.clean())
    small, best = [label_camera(camera, 2) for camera in cameras], np.empty((10, 3, 3))
    for angle in np.radians([0, 90, 180, 270]):
        away = np.array([np.cos(angle), np.sin(angle), 0.0])
        middle = truth.position + (abs(away @ truth.rotation) @ box.half + 0.03) * away
        middle[2] = 0.025
        block = cuboid.corners((0.06, 0.06, 0.05)) @ so3.exp(np.array([0, 0, angle])).T + middle
        labels = np.stack([image[::2, ::2] for image in truth.labels])
        for camera, one in zip(small, labels, strict=True):
            outline = cv2.convexHull(np.rint(camera.project(block)).astype(np.int32))
            one[(cv2.fillConvexPoly(np.zeros_like(one), outline, 1) > 0) & (one == 0)] = label
        faces, lenses, pictures = (box.half, box.face_labels), stack_lenses(small), pictures_of(labels)
        likely_rotations(lenses, labels, pictures, faces, truth.position, rotation_grid(), best)
        assert min(so3.angle_between(one, truth.rotation) for one in best) < np.radians(25)


def counted(labels, camera, points):
    """Shares (N, 2) of the object in the wide and the tight square around points (N, 3), a third per colour.

    By the definition, from every pixel; and whether the camera sees the points (N,).
    """
    pixels, depth = camera.project_in_view(points), points @ camera.camera_from_world[2, :3]
    depth += camera.camera_from_world[2, 3]
    focal = camera.matrix[(0, 1), (0, 1)]
    surface = 8 * sum(np.prod(np.delete(BOX.half, k)) for k in range(3))
    height, width = camera.height // CELL * CELL, camera.width // CELL * CELL
    rows, columns = np.nonzero(labels[:height, :width])
    shown = labels[rows, columns] == np.arange(1, 7)[:, None]
    seen = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    pixels, result = np.where(seen[:, None], pixels, 0.0), []
    for share in (1.0, TIGHT):
        reach = share * BOX.radius * focal / depth[:, None]
        low, high = CELL * np.rint((pixels - reach) / CELL), CELL * np.rint((pixels + reach + 1) / CELL)
        inside = (columns >= low[:, :1]) & (columns < high[:, :1])
        inside &= (rows >= low[:, 1:]) & (rows < high[:, 1:])
        expected = np.maximum(surface / 4 * focal.prod() / depth**2, 1.0)
        result.append(np.minimum(inside.astype(int) @ shown.T / expected[:, None], 1 / 3).sum(axis=1))
    return np.stack(result, axis=1), seen & (depth > 1.5 * BOX.radius)


def scattered(rng, lenses, small):
    """Label maps that show three faces somewhere in the arena, and patches in their colours that are none.

    An object that no camera shows is none.
    """
    labels = np.zeros((len(small), max(c.height for c in small), max(c.width for c in small)), np.uint8)
    rows, columns = np.mgrid[: labels.shape[1], : labels.shape[2]]
    angle, away = rng.uniform(0, 2 * np.pi), 0.2 * np.sqrt(rng.uniform())
    place = away * np.cos(angle), away * np.sin(angle), rng.uniform(0.03, 0.15)
    for c, camera in enumerate(small):
        u, v, depth = project(lenses, c, *place)
        discs = [(u, v, 0.8 * BOX.radius * camera.matrix[0, 0] / depth)] if depth > BOX.radius else []
        discs += rng.uniform([0, 0, 1], [camera.width, camera.height, 6], (3, 3)).tolist()
        for u, v, radius in discs:
            sector = np.floor(1.5 * np.arctan2(rows - v, columns - u) / np.pi).astype(int) % 3
            inside = np.hypot(columns - u, rows - v) < radius
            labels[c][inside] = (sector[inside] + rng.integers(6)) % 6 + 1
        labels[c, camera.height :], labels[c, :, camera.width :] = 0, 0
    return labels


def test_votes_are_what_the_cameras_show_around_the_points():
    rng = np.random.default_rng(6)
    for count in (3, 2, 1):
        cameras = list(default_cameras())[:count]
        for c in range(count):
            angle = rng.uniform(0, 2 * np.pi)
            place = 0.3 * np.array([0.7 * np.cos(angle), 0.7 * np.sin(angle), 0.71])
            if c == 1:
                cameras[c] = dataclasses.replace(make_camera(), name="near", camera_from_world=look_at(place))
        factors = label_factors(cameras, BOX, Arena())
        small = [label_camera(camera, factor) for camera, factor in zip(cameras, factors, strict=True)]
        search = PositionSearch(small, BOX, Arena())
        labels = scattered(rng, search.lenses, small)
        pictures, votes = pictures_of(labels), np.empty(len(search.points), np.float32)
        views = search.views(labels, pictures)
        shown = [counted(*pair, search.points) for pair in zip(labels, small, strict=True)]
        for left_out in (None, *range(count if count > 1 else 0)):
            pictures["used"] = np.arange(count) != left_out
            most, total, seen = vote(views, pictures, votes), 0.0, DOUBT
            for shares, inside in itertools.compress(shown, pictures["used"]):
                total, seen = total + np.where(inside, shares.sum(axis=1), 0.0), seen + inside
            # A pixel on the border of a square is in or out by rounding.
            assert np.mean(np.abs(votes - DOUBT * total / seen) < 1e-5) > 0.999
            assert most == votes.max() > 0.5


def test_points_fill_the_arena_however_small_and_nothing_else():
    for radius in np.linspace(0.001, 0.05, 99):
        points = PositionSearch(default_cameras(), BOX, Arena(radius=float(radius))).points
        assert len(points) > 0
        assert np.hypot(points[:, 0], points[:, 1]).max() <= max(radius, 0.36 * BOX.radius)
    low = PositionSearch(default_cameras(), BOX, Arena(height=1e-17, table=1.0, table_std=(0.0, 0.0))).points
    assert len(low) > 0
    assert (low[:, 2] == 1.0).all()
    for height in np.geomspace(1e-6, 10.0, 40):
        wide = Arena(radius=10.0, height=float(height), table_std=(0.0, 0.0))
        assert 0.1 * MOST_POINTS < len(_grid(wide, 0.01)) <= MOST_POINTS
    arena = Arena(center=(0.1, -0.2), radius=0.3, height=0.2)
    points = PositionSearch(default_cameras(), BOX, arena).points
    away = points - [*arena.center, 0.0]
    assert np.hypot(away[:, 0], away[:, 1]).max() <= arena.radius
    step = np.unique(np.round(points[:, 0], 9))
    assert np.diff(step).max() < 0.6 * BOX.radius
    assert points[:, 2].min() < arena.lowest + 0.6 * BOX.radius
    assert points[:, 2].max() > arena.ground + arena.height - 0.6 * BOX.radius


@pytest.mark.parametrize("size", [(0.02, 0.3, 0.02), (0.2, 0.2, 0.01)])
def test_bars_and_plates_are_found_as_other_boxes_are(size):
    cameras = default_cameras()
    model = dataclasses.replace(tracker.load_object("cuboid_2x2x8_v2"), size=size)
    one, errors = tracker.ObjectTracker(model, tracker.CameraRig(cameras)), []
    for k in range(4):
        truth = bare(model, cameras, [70, k])
        fit = one.fit(truth.images)
        assert isinstance(fit, Fit), k
        errors.append(np.linalg.norm(fit.position - truth.position))
    assert np.median(errors) < 0.05e-3
    assert max(errors) < 0.2e-3


def test_alignment_reaches_the_truth_from_far_away(scene):
    truth = scene[2]
    lenses, labels = stack_lenses(default_cameras()), np.stack(truth.labels)
    rng = np.random.default_rng(2)
    strips = np.empty(MAX_STRIPS, STRIP)
    errors = []
    for _ in range(20):
        axis = rng.normal(size=3)
        rotation = so3.exp(np.radians(20) * axis / np.linalg.norm(axis)) @ truth.rotation
        position = truth.position + rng.normal(0, 0.004, 3)
        reaches = np.array([10, 10, 8, 6, 5])
        align(lenses, labels, pictures_of(labels), FACES, rotation, position, reaches, strips)
        turned = so3.angle_between(rotation, truth.rotation)
        errors.append([np.linalg.norm(position - truth.position), turned])
    shifts, turns = np.transpose(errors)
    assert np.median(shifts) < 0.4e-3
    assert np.mean((shifts < 5e-3) & (turns < np.radians(5))) >= 0.9


def test_explanation_counts_what_the_truth_shows_and_a_worse_pose_scores_less(scene):
    truth, shown = scene[2], (scene[1] > 0).sum(axis=(1, 2))
    counts = counted_at(scene, truth.rotation, truth.position)
    assert (np.abs(counts["predicted"] - shown) < 0.06 * shown).all()
    assert (counts["agree"] > 0.93 * shown).all()
    colored = counts["elsewhere"] + counts["extra"] + counts["agree"] + counts["wrong"]
    np.testing.assert_array_equal(colored, shown)
    inside = counts["agree"] + counts["missing"] + counts["wrong"]
    np.testing.assert_array_equal(inside, counts["predicted"])
    pictures = pictures_of(scene[1])
    best = explanation_score(counts, pictures)
    for step in np.eye(3):
        shifted = counted_at(scene, truth.rotation, truth.position + 0.01 * step)
        turned = counted_at(scene, so3.exp(0.3 * step) @ truth.rotation, truth.position)
        assert max(explanation_score(other, pictures) for other in (shifted, turned)) < best


@pytest.mark.parametrize("blur", [0.0, 0.9, 2.2])
def test_pixels_inside_a_face_keep_away_from_its_outline(scene, blur):
    cameras, labels, truth = scene
    counts = counted_at(scene, truth.rotation, truth.position, blur)
    corners, checked = cuboid.corners(MODEL.size) @ truth.rotation.T + truth.position, 0
    for c, camera in enumerate(cameras):
        pixels = camera.project(corners).astype(np.float32)
        for face in np.flatnonzero(counts["faces"][c].sum(axis=1)):
            outline = pixels[cuboid.FACE_CORNERS[face]]
            away = [
                cv2.pointPolygonTest(outline, (float(i), float(j)), True)
                for j, i in np.ndindex(camera.height, camera.width)
            ]
            inner = np.array(away).reshape(camera.height, camera.width) >= max(WHOLLY, blur / 2)
            found = labels[c, : camera.height, : camera.width][inner]
            np.testing.assert_array_equal(counts["inner"][c, face], np.bincount(found, minlength=7))
            checked += 1
    assert checked >= 6


def gain(scene, faces=FACES, moved=(0.0, 0.0, 0.0), labels=None, room=np.inf):
    """By how much another body explains more than a box that is moved along its axes from the truth."""
    cameras, shown, truth = scene
    labels = shown if labels is None else labels
    place, seen = (truth.rotation, truth.position + truth.rotation @ moved, STILL), np.zeros(3, SEEN)
    sight = stack_lenses(cameras), labels, pictures_of(labels), faces
    count_labels(*sight, *place, seen)
    return (resized(*sight, place, room, seen, NUMBERS) - NUMBERS.resized) / NUMBERS.end


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("factor", [factor for factor, _ in RESIZED])
def test_a_body_of_which_an_edge_is_shorter_or_longer_is_known(scene, axis, factor):
    assert gain(scene) < 0.0
    # What one camera lacks alone may be hidden.
    labels = scene[1].copy()
    columns = np.flatnonzero(labels[axis].any(axis=0))
    labels[axis, :, : columns[len(columns) // 3]] = 0
    assert gain(scene, labels=labels) < 1.0
    half, moved = BOX.half.copy(), np.zeros(3)
    half[axis] /= factor
    for side in (1.0, -1.0):
        moved[axis] = side * (half[axis] - BOX.half[axis])
        assert gain(scene, (half, BOX.face_labels), moved) > 5.0


def test_no_body_reaches_into_the_table(scene):
    truth, half, moved = scene[2], BOX.half.copy(), np.zeros(3)
    axis = int(np.argmax(abs(truth.rotation[2])))
    half[axis] /= RESIZED[-1][0]
    moved[axis] = np.sign(truth.rotation[2, axis]) * (BOX.half[axis] - half[axis])  # its upper end is right
    below = 2 * abs(moved @ truth.rotation[2])
    assert gain(scene, (half, BOX.face_labels), moved, room=below + 1e-6) > 5.0
    assert gain(scene, (half, BOX.face_labels), moved, room=below - 1e-6) < 1.0


@pytest.fixture(scope="module")
def estimator(rig):
    return PoseEstimator(BOX, rig, tracker.load_colors(MODEL.colors))


@pytest.fixture(scope="module")
def images(rig):
    return shot(rig, pose_at(0.0), 7)


def test_rounds_begin_each_hypothesis_once_whatever_the_rounds_before(estimator, images, monkeypatch):
    ends, begun, begin = [], [], Search.begun

    def noted(self, sight, place, which, left_out=()):
        begun.extend((tuple(place), turn, left_out) for turn in which)
        return begin(self, sight, place, which, left_out)

    monkeypatch.setattr(Search, "begun", noted)
    for order in ((LIKELIEST, TURNS), (LIKELIEST, NEARBY, EVERYWHERE), (EVERYWHERE,)):
        begun.clear()
        next_of = estimator.search.rounds(estimator.reader(images))
        for wide in order:
            scores = [one.score for one in next_of(wide)]
            assert scores == sorted(scores, reverse=True)
        assert len(begun) == len(set(begun))
        first = begun[0][0]
        assert sum(place == first and not left for place, _, left in begun) == order[-1].first
        ends.append(set(begun))
    assert ends[1] == ends[2]
    # A clear view needs one.
    begun.clear()
    fits = estimator.candidates(estimator.reader(images))
    assert len(begun) == len(fits) == 1
    assert settled(fits[0])


def test_an_object_is_found_before_a_table_in_any_of_its_colours(estimator, images):
    sight, (position, rotation) = estimator.reader(images), pose_at(0.0)
    for color in range(1, 7):
        flooded = sight._replace(labels=sight.labels.copy(), pictures=sight.pictures.copy())
        flooded.labels[:, 40:][sight.labels[:, 40:] == 0] = color
        flooded.pictures["colored"] = np.count_nonzero(flooded.labels, axis=(1, 2))
        best = estimator.search.rounds(flooded)(TURNS)[0]
        assert np.linalg.norm(best.position - position) < 0.005
        assert np.degrees(so3.angle_between(best.rotation, rotation)) < 5


@pytest.mark.parametrize("exposure", [1.0, 0.3])
def test_a_dark_image_is_as_loud_as_a_bright_one_in_the_light_in_which_its_colours_are_read(
    estimator, rng, exposure
):
    grey = np.full((270, 270, 3), 115.0)
    for sigma, loud in ((0.8 * LOUD, False), (1.3 * LOUD, True)):
        image = np.rint(exposure * (grey + rng.normal(0, sigma, grey.shape))).astype(np.uint8)
        assert estimator.reader.lit([image])["loud"][0] == loud


@pytest.mark.parametrize("shown", [(0, 1), (2,)])
def test_a_camera_without_an_image_explains_nothing(estimator, images, rig, shown):
    fewer = dataclasses.replace(rig, cameras=tuple(rig[c] for c in shown))
    few = PoseEstimator(BOX, fewer, tracker.load_colors(MODEL.colors))
    sights = (
        estimator.reader([image if c in shown else None for c, image in enumerate(images)]),
        few.reader([images[c] for c in shown]),
    )
    position, rotation = pose_at(0.0)
    poses = [(rotation, position), (rotation, position + 0.02)]
    scores = [
        [hypothesis.score for hypothesis in one.search.near(sight, poses)]
        for one, sight in zip((estimator, few), sights, strict=True)
    ]
    assert scores[0] == scores[1]


@pytest.mark.parametrize("left_out", [(), (1,)])
def test_colours_beside_the_object_are_elsewhere_in_an_image_that_was_left_out(estimator, images, left_out):
    position, rotation = pose_at(0.0)
    sight = estimator.reader([images[0], np.roll(images[1], 12, axis=1), images[2]])
    seen = estimator.refiner(sight, rotation, position, left_out=left_out).cameras[1]
    assert (seen["extra"] == 0) == bool(left_out)
    counted = seen["agree"] + seen["wrong"] + seen["extra"] + seen["elsewhere"]
    assert counted == sight.pictures["colored"][1] > 0


@pytest.mark.parametrize("spoilt", ["mixed", "one camera", "empty"])
def test_few_poses_are_refined_whatever_the_pictures_show(estimator, images, rig, spoilt, monkeypatch):
    moved = shot(rig, pose_at(1.2), 8)
    shown = {
        "mixed": [images[0], moved[1], np.ascontiguousarray(images[2][:, ::-1])],
        "one camera": [images[0], None, None],
        "empty": shot(rig, None, 9),
    }[spoilt]
    schedules, refine = [], PoseEstimator._fitted

    def noted(self, sight, one, schedule, lag):
        schedules.append(schedule)
        return refine(self, sight, one, schedule, lag)

    monkeypatch.setattr(PoseEstimator, "_fitted", noted)
    estimator.candidates(estimator.reader(shown))
    assert sum(one is not FIRST for one in schedules) <= REFINED


def test_a_plate_turned_about_the_face_that_all_cameras_see_competes(rig):
    """Its sides are so narrow that their colours hardly count beside those of the face."""
    plate = dataclasses.replace(MODEL, size=np.array([0.14, 0.14, 0.005]), rim=0.0, rim_std=1e-4)
    finder = tracker.ObjectTracker(plate, rig)
    still = bare(plate, rig.cameras, 3)  # lies flat
    fit = finder.fit(still.images)
    others = finder._estimator._alike(finder._estimator.reader(still.images), fit, None)
    assert others
    assert all(so3.angle_between(one.rotation, fit.rotation) > 1.0 for one in others)
