import dataclasses
import functools
import itertools

import cv2
import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers import LENSES, exposed, veiled, within
from tests.helpers.fits import deviation
from tests.helpers.kept_stills import bare, take
from tracker.calibration.by_object.table import moved
from tracker.geometry import so3
from tracker.pipeline import Status
from tracker.pose.fit import Fit
from tracker.pose.judge import log_odds
from tracker.pose.schedule import SCHEDULE

OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")
SCENES, CYAN = 3, 4
CONVERGED = 2 * np.sqrt(SCHEDULE.negligible[0])
"""How far two fits that ended may be apart, in standard deviations."""


@pytest.fixture(scope="module", params=OBJECTS)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def pairs(rig, name):
    """Images of scenes, and their fits by the rig as it is."""
    scenes = [bare(name, rig.cameras, [70, k]) for k in range(SCENES)]
    return [(truth, new(name, rig).fit(truth.images)) for truth in scenes]


def new(name, rig):
    return tracker.ObjectTracker(name, rig)


ORIGINS = [0.31, -0.2, 0.0], [0.0, 0.0, -0.9], [0.05, 0.02, 0.7], [-1.0, 2.0, 1.5]
TURNED = [([0.2, -0.1, 0.3], turn) for turn in (0.7, np.pi / 2, 3.0)]


@pytest.mark.parametrize(("shift", "turn"), [*((origin, 0.0) for origin in ORIGINS), *TURNED])
def test_where_the_worlds_origin_is_and_how_its_axes_are_turned_does_not_matter(
    rig, name, pairs, shift, turn
):
    # The same cameras and arena.
    new_from_old = so3.transform(so3.exp([0.0, 0.0, turn]), shift)
    center = new_from_old @ [*rig.arena.center, rig.arena.table, 1.0]
    arena = dataclasses.replace(rig.arena, center=tuple(center[:2]), table=center[2])
    there = dataclasses.replace(moved(rig, np.linalg.inv(new_from_old)), arena=arena)
    one, axes = new(name, there), new_from_old[:3, :3]
    for truth, reference in pairs:
        fit = one.fit(truth.images)
        position, rotation = axes.T @ (fit.position - new_from_old[:3, 3]), axes.T @ fit.rotation
        back = dataclasses.replace(fit, position=position, rotation=rotation)
        # Where axes are turned, other hypotheses of the even grid lead to it.
        assert deviation(back, reference) < CONVERGED
        assert log_odds(fit) == pytest.approx(log_odds(reference), abs=0.5 if turn else 0.02)
        if not turn:
            assert within(back, reference, 1e-6, np.degrees(2e-5))
            # The floor under a calibration's errors is an angle at the origin, and counts more afar.
            deviations = np.sqrt(np.diag(fit.covariance) / np.diag(reference.covariance))
            np.testing.assert_allclose(deviations, 1.0, rtol=0.1)
    # Nor does it over time.
    images, here = pairs[0][0].images, new(name, rig)
    for k in range(0 if turn else 4):
        pose = here.update(images, 0.1 * k).filtered_object_pose
        other = one.update(images, 0.1 * k).filtered_object_pose
        np.testing.assert_allclose(other.position - new_from_old[:3, 3], pose.position, rtol=0, atol=1e-6)
        np.testing.assert_allclose(other.orientation, pose.orientation, rtol=0, atol=1e-5)
        np.testing.assert_allclose(other.velocity, pose.velocity, rtol=0, atol=1e-5)


def away(rig, degrees, axis, name):
    """Cameras at the same places that look away."""
    turn = so3.transform(so3.exp(np.radians(degrees) * np.asarray(axis, dtype=float)), np.zeros(3))
    return [
        dataclasses.replace(
            camera, name=f"{camera.name} {name}", camera_from_world=turn @ camera.camera_from_world
        )
        for camera in rig
    ]


def counts(fit):
    """(C, 9) what is counted of the images of each camera."""
    names = "expected", "usable", "inliers", "squares", "predicted", "agree", "missing", "wrong", "extra"
    return np.stack([fit.cameras[name] for name in names], axis=1)


RIGHT, UP, DOWN = (0, 1, 0), (1, 0, 0), (-1, 0, 0)
AWAY = [[(90, RIGHT)], [(90, UP)], [(135, RIGHT)], [(180, RIGHT)], [(180, UP)]]


@pytest.mark.parametrize("turns", [*AWAY, *([(by, RIGHT), (by, DOWN)] for by in (55, 60, 65, 75))])
def test_cameras_that_look_away_or_far_aside_neither_help_nor_harm(rig, name, pairs, turns):
    more = [camera for k, turn in enumerate(turns) for camera in away(rig, *turn, f"away {k}")]
    for truth, reference in pairs:
        others = take(truth.scene, more, Sensor.realistic(), np.random.default_rng(1), points=1)
        blind = [c for c, labels in enumerate(others.labels) if not labels.any()]
        assert blind if len(turns) > 1 else len(blind) == 3
        wider = tracker.CameraRig((*rig.cameras, *(more[c] for c in blind)))
        fit = new(name, wider).fit([*truth.images, *(others.images[c] for c in blind)])
        assert not (counts(fit)[3:, [0, 4]] if len(turns) > 1 else counts(fit)[3:]).any()
        assert deviation(fit, reference) < CONVERGED
        np.testing.assert_allclose(np.diag(fit.covariance), np.diag(reference.covariance), rtol=0.02)
        assert log_odds(fit) == pytest.approx(log_odds(reference), abs=0.5)


def test_cameras_without_images_are_as_if_there_were_none_and_their_order_does_not_matter(rig, name, pairs):
    one = new(name, tracker.CameraRig((*rig.cameras, *away(rig, 10, UP, "aside"))))
    for truth, reference in pairs:
        fit = one.fit([*truth.images, None, None, None])
        assert counts(fit)[:3, :4].all()
        assert not counts(fit)[3:].any()
        for field in ("position", "rotation", "covariance"):
            np.testing.assert_array_equal(getattr(fit, field), getattr(reference, field))
        assert log_odds(fit) == log_odds(reference)
        for order in ((1, 2, 0), (2, 1, 0)):
            other = new(name, tracker.CameraRig(tuple(rig[c] for c in order)))
            fit = other.fit([truth.images[c] for c in order])
            assert deviation(fit, reference) < 0.1
            assert log_odds(fit) == pytest.approx(log_odds(reference), abs=0.1)


def test_a_pose_outside_the_arena_is_refused_and_one_at_its_rim_found(rig, name, pairs):
    for truth, reference in pairs:
        x, y, z = map(float, truth.position)
        arenas = {
            "beside": dataclasses.replace(rig.arena, center=(x - 0.25, y), radius=0.15),
            "above": dataclasses.replace(rig.arena, table=z + 0.15),
            "below": dataclasses.replace(rig.arena, table=z - 0.4, height=0.1),
        }
        for where, arena in arenas.items():
            answer = new(name, dataclasses.replace(rig, arena=arena)).detect(truth.images)
            if answer.object_pose is not None:
                assert np.linalg.norm(answer.object_pose.position - truth.position) > 0.05, where
                assert answer.object_pose.confidence < 0.5, where
            else:
                assert answer.status not in (Status.FOUND, Status.TRACKING)
        arena = dataclasses.replace(rig.arena, center=(x - 0.15, y), radius=0.155)
        fit = new(name, dataclasses.replace(rig, arena=arena)).fit(truth.images)
        assert isinstance(fit, Fit)
        assert deviation(fit, reference) < CONVERGED


def test_larger_pictures_of_the_same_view_or_of_one_camera_or_magnified_ones_give_the_same_pose(
    rig, name, pairs
):
    larger, limits = rig.resized(540, 540), (0.2e-3, 0.3) if name == OBJECTS[0] else (0.4e-3, 0.6)
    one, mixed = new(name, larger), new(name, tracker.CameraRig((rig[0], larger[1], rig[2])))
    for k, (truth, reference) in enumerate(pairs):
        large = bare(name, larger.cameras, [70, k])
        magnified = [cv2.resize(image, (540, 540), interpolation=cv2.INTER_LINEAR) for image in truth.images]
        fit = one.fit(large.images)
        assert within(fit, reference, 0.2e-3, 0.6)
        assert np.linalg.norm(fit.position - truth.position) < 0.1e-3
        for other in (mixed.fit([truth.images[0], large.images[1], truth.images[2]]), one.fit(magnified)):
            assert within(other, reference, *limits)


def ramp(image, blue, red):
    """The image in light that has so much more blue at its right border than in the middle, and red below."""
    factors = np.ones(image.shape)
    factors[..., 0] += blue * np.linspace(-1.0, 1.0, image.shape[1])
    factors[..., 2] += red * np.linspace(-1.0, 1.0, image.shape[0])[:, None]
    return exposed(image, factors)


@functools.cache
def overlap(rig, name, k, blue=0.0, red=0.0):
    """Mean over cameras of the intersection over union of the pixels that show the right face in a ramp."""
    values, colors, truth = [], tracker.load_colors(name), bare(name, rig.cameras, [70, k])
    for image, true in zip(truth.images, truth.labels, strict=True):
        found = tracker.segment(ramp(image, blue, red), colors)
        right = np.count_nonzero((found == true) & (true > 0))
        values.append(right / np.count_nonzero((found > 0) | (true > 0)))
    return np.mean(values)


RAMPS = [(1, 0), (0, 1), (1, -1), (-1, 1)]


@pytest.mark.parametrize(
    ("name", "share", "scenes", "ramps"),
    [
        *((OBJECTS[0], share, range(SCENES), RAMPS) for share in (0.15, 0.3)),
        (OBJECTS[1], 0.3, range(SCENES), RAMPS),
        *((OBJECTS[1], share, (1, 3, 4, 5, 7), RAMPS[2:]) for share in (0.1, 0.15, 0.2, 0.3)),
    ],
)
def test_a_ramp_of_coloured_light_leaves_the_labels(rig, name, share, scenes, ramps):
    for k, (blue, red) in itertools.product(scenes, ramps):
        plain = overlap(rig, name, k)
        assert plain > 0.7, k
        assert overlap(rig, name, k, share * blue, share * red) > 0.9 * plain, (k, blue, red)


LIGHTS = {
    **{f"a veil of {level}": (veiled, level) for level in (16, 60)},
    **{f"a ramp of {r}": (ramp, r, -r) for r in (0.15, -0.15, 0.3, -0.3)},
}


@pytest.mark.parametrize("light", LIGHTS)
def test_a_veil_of_stray_light_or_a_ramp_of_coloured_light_leaves_the_pose(rig, name, pairs, light):
    change, *sizes = LIGHTS[light]
    detect, follow = new(name, rig), new(name, rig)
    for truth, reference in pairs:
        images = [change(image, *sizes) for image in truth.images]
        assert within(detect.fit(images), reference, 0.3e-3, 0.5)
        follow.reset()
        assert follow.update(images, 0.0).object_pose.confidence > 0.9
        # Labels and poses are read in the same light.
        for image, labels in zip(images, detect._estimator.reader(images).labels, strict=True):
            found = tracker.segment(image, detect.colors)
            coarse = cv2.resize(found, labels.shape[::-1], interpolation=cv2.INTER_NEAREST)
            both = (coarse > 0) & (labels > 0)
            assert np.count_nonzero(both) > 100
            assert np.mean(coarse[both] == labels[both]) > 0.95


@pytest.mark.parametrize("count", [8, 14])
def test_lenses_of_more_coefficients_are_as_good(rig, name, pairs, count):
    cameras = (dataclasses.replace(camera, distortion=np.array(LENSES[count])) for camera in rig)
    bent = tracker.CameraRig(tuple(cameras), rig.arena)
    fit = new(name, bent).fit(bare(name, bent.cameras, [70, 0]).images)
    assert within(fit, pairs[0][1], 3e-4, 0.5)


TABLES = {"white": (235, 235, 235), "black": (12, 12, 12)}
"""Colours that are not grey, as all tables in the generator's and the platform's images are."""


def on_table(rig, name, color, seed):
    """A still, and its images with all around the object in one colour, but for noise."""
    still, rng, images = bare(name, rig.cameras, [31, seed]), np.random.default_rng(seed), []
    for image, labels in zip(still.images, still.labels, strict=True):
        around = cv2.dilate((labels > 0).astype(np.uint8), np.ones((3, 3))) == 0
        painted = image.copy()
        painted[around] = np.clip(rng.normal(color, 3.0, (np.count_nonzero(around), 3)), 0, 255)
        images.append(painted)
    return still, images


@pytest.mark.parametrize("table", TABLES)
def test_an_object_is_found_on_a_table_of_any_brightness(rig, name, table):
    finder, right = new(name, rig), []
    for seed in range(6):
        still, images = on_table(rig, name, TABLES[table], seed)
        fit = finder.fit(images)
        assert not isinstance(fit, Fit) or np.linalg.norm(fit.position - still.position) < 4e-3
        right.append(isinstance(fit, Fit))
    assert sum(right) >= 5


def test_the_light_in_which_an_object_was_found_is_kept_until_another_shows_it(rig):
    finder, found = new("cube_v2", rig), []
    still, black = on_table(rig, "cube_v2", TABLES["black"], 0)
    shown = [(0.1 * k, black) for k in range(4)] + [(5.0 + 0.1 * k, list(still.images)) for k in range(3)]
    for stamp, images in shown:
        answer = finder.update(images, stamp)
        assert np.linalg.norm(answer.object_pose.position - still.position) < 1e-3
        found.append((str(answer.status), finder._memory.as_they_are))
    assert found[:4] == [("found", True)] + [("tracking", True)] * 3
    assert found[4:] == [("refound", False)] + [("tracking", False)] * 2


SHADED = {"cube_v2": (1, 2, 3), "cuboid_2x2x8_v2": (0, 3, 6)}
"""Scenes whose cyan face reads as blue in shade."""


def test_a_face_in_deep_shade_is_not_mistaken_for_another_which_is_remembered(rig, name):
    lit = bare(name, rig.cameras, [31, 7])
    for seed in SHADED[name]:
        finder, found = new(name, rig), []
        still, dark = bare(name, rig.cameras, [31, seed]), []
        for image, labels in zip(still.images, still.labels, strict=True):
            dark.append(np.where((labels == CYAN)[..., None], 0.4 * image, image).round().astype(np.uint8))
        for stamp, images, truth in ((0.0, dark, still), (0.1, dark, still), (9.0, lit.images, lit)):
            pose = finder.update(images, stamp).object_pose
            assert np.linalg.norm(pose.position - truth.position) < 1e-3
            assert pose.confidence > 0.9
            found.append(finder._memory.shaded)
        assert found == [True, True, False]
