import dataclasses

import cv2
import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers import RIG, exposed
from tests.helpers.kept_stills import bare, take
from tests.helpers.stills import posed_scene
from tracker import Status
from tracker.geometry import so3

MODEL = tracker.load_object("cube_v2")
PLACE = np.array([-0.03, -0.05, 0.0325])
LIGHTS = (1000, 1001, 1002)
"""Seeds of colours, light and noise."""
RNG, SHAPE = np.random.default_rng(1), (270, 270, 3)


def even(level):
    return [np.full(SHAPE, level, np.uint8) for _ in range(3)]


def shot(position, rotation, light=LIGHTS[0], cameras=RIG.cameras):
    """A cube in a pose (no rotation: none) as the cameras see it."""
    pose = None if rotation is None else (position, rotation)
    scene = posed_scene(MODEL, pose, np.random.default_rng(light))
    return take(scene, cameras, Sensor.realistic(), np.random.default_rng(light))


@pytest.fixture(scope="module", params=LIGHTS)
def truth(request):
    return shot(PLACE, so3.exp([0.0, 0.0, 0.4]), request.param)


@pytest.fixture(scope="module")
def empty(truth):
    return take(truth.scene.emptied(), RIG.cameras, Sensor.realistic(), np.random.default_rng(30)).images


def new(rig=RIG):
    return tracker.ObjectTracker(MODEL, rig)


def patches(truth, size):
    """Pictures that show so many pixels of the object's height and width, and grey around."""
    pictures = even(115)
    for picture, image, labels in zip(pictures, truth.images, truth.labels, strict=True):
        row, column = np.argwhere(labels).mean(axis=0).astype(int) - size // 2
        there = np.s_[row : row + size, column : column + size]
        picture[there] = image[there]
    return pictures


HIGH = dataclasses.replace(RIG, arena=dataclasses.replace(RIG.arena, table=0.15))
SMALL = dataclasses.replace(MODEL, size=0.7 * MODEL.size)

DETECTED = {
    "the cube": (Status.FOUND, lambda truth: new().detect(truth.images)),
    **{
        f"all of {level}": (Status.NO_OBJECT_COLORS, lambda _, level=level: new().detect(even(level)))
        for level in (0, 115, 255)
    },
    "noise": (Status.OTHER_OBJECT, lambda _: new().detect([RNG.integers(0, 256, SHAPE, np.uint8)] * 3)),
    "a colour of the cube all over": (
        Status.OTHER_OBJECT,
        lambda _: new().detect([exposed(RNG.normal((150, 84, 148), 4.0, SHAPE)) for _ in range(3)]),
    ),
    "another of its colours, without noise": (
        Status.OTHER_OBJECT,
        lambda _: new().detect([np.full(SHAPE, (40, 30, 200), np.uint8)] * 3),
    ),
    "a corner of the cube": (Status.TOO_FEW_PIXELS, lambda truth: new().detect(patches(truth, 9))),
    "a cube below the table": (Status.INCONSISTENT_VIEWS, lambda truth: new(HIGH).detect(truth.images)),
    "a cube larger than its model": (
        Status.OTHER_OBJECT,
        lambda truth: tracker.ObjectTracker(SMALL, RIG).detect(truth.images),
    ),
}


@pytest.mark.parametrize(("status", "detected"), DETECTED.values(), ids=DETECTED)
def test_the_status_says_why_there_is_a_pose_or_none(truth, status, detected):
    answer = detected(truth)
    assert answer.status is status
    assert (answer.object_pose is not None) == (status is Status.FOUND)


def test_pictures_that_show_no_cube_as_it_is_give_no_pose_that_is_sure(truth, empty):
    upside_down = [np.ascontiguousarray(image[::-1, ::-1]) for image in truth.images]
    out_of_focus = [cv2.GaussianBlur(image, (0, 0), 12) for image in truth.images]
    for images in (upside_down, out_of_focus):
        answer = new().detect(images)
        assert answer.object_pose is None or answer.object_pose.confidence < 0.5
    # As behind wavy glass every row and every column is shifted back and forth.
    y, x = np.indices(SHAPE[:2]).astype(np.float32)
    moved = (base + 11 * np.sin(2 * np.pi * other / 9, dtype=np.float32) for base, other in ((x, y), (y, x)))
    waves, border = [*moved, cv2.INTER_LINEAR], cv2.BORDER_REPLICATE
    glass = new().detect([cv2.remap(image, *waves, borderMode=border) for image in truth.images])
    assert glass.status in (Status.POOR_FIT, Status.AMBIGUOUS, Status.OTHER_OBJECT)
    nothing = new().detect(empty)
    # Here and there something has a colour of the object.
    assert nothing.status in (Status.NO_OBJECT_COLORS, *REFUSED)
    assert glass.object_pose is nothing.object_pose is None


@pytest.mark.parametrize("c", range(3))
def test_one_face_to_one_camera_never_gives_a_pose_that_is_sure(c):
    towards = RIG[c].position / np.linalg.norm(RIG[c].position)
    aside = np.cross([0.0, 0.0, 1.0], towards)
    aside /= np.linalg.norm(aside)
    rotation = np.stack([aside, np.cross(towards, aside), towards], axis=1)
    for height in (0.05, 0.06, 0.07, 0.08):
        truth = shot(height * towards, rotation, cameras=RIG.cameras[c : c + 1])
        assert len(np.unique(truth.labels[0])) == 2
        answer = new().detect([truth.images[0] if k == c else None for k in range(3)])
        assert answer.object_pose is None or answer.object_pose.confidence < 0.5


REFUSED = (
    Status.TOO_FEW_PIXELS,
    Status.INCONSISTENT_VIEWS,
    Status.POOR_FIT,
    Status.OTHER_OBJECT,
    Status.AMBIGUOUS,
)


@pytest.mark.parametrize("status", REFUSED)
def test_what_refuses_a_fit_is_the_status(truth, monkeypatch, status):
    for user in ("tracker.tracking.follow", "tracker.pose.estimate"):
        monkeypatch.setattr(f"{user}.refusal", lambda _: status)
    one = new()
    answer = one.detect(truth.images)
    assert answer.status is status
    assert answer.object_pose is None
    answer = one.update(truth.images, 0.0)
    assert (answer.status, answer.reason) == (Status.LOST, status)


def test_another_cubes_faces_are_the_reason_even_where_a_fit_is_not_refused_at_once():
    found, one = [], new()
    for seed in (0, 5, 8, 20):
        images = bare("cube_v1", RIG.cameras, [77, seed]).images
        found.append(one.detect(images).object_pose is not None)
        answer = one.update(images, 0.0)
        assert (answer.object_pose, answer.status, answer.reason) == (None, Status.LOST, Status.OTHER_OBJECT)
        one.reset()
    assert any(found)


FOLLOWED = [Status.FOUND, Status.TRACKING, Status.COASTING, Status.REFOUND, Status.LOST]


def test_over_time_the_object_is_found_followed_lost_from_sight_and_found_again(truth, empty):
    far = shot(np.array([0.08, 0.06, 0.0325]), so3.exp([0.0, 0.0, 2.0])).images
    one = new()
    shown = [(0.0, truth.images), (0.1, truth.images), (0.2, empty), (0.8, far), (9.0, empty)]
    answers = [one.update(images, stamp) for stamp, images in shown]
    assert [answer.status for answer in answers] == FOLLOWED
    assert [answer.filtered_object_pose is None for answer in answers] == [False] * 4 + [True]


def test_every_status_is_seen_here():
    assert {*(status for status, _ in DETECTED.values()), *REFUSED, *FOLLOWED} == set(Status)
