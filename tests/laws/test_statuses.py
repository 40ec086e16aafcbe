import dataclasses

import cv2
import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers import RIG
from tests.helpers.kept_stills import take
from tests.helpers.stills import posed_scene
from tracker import Status
from tracker.geometry import so3

MODEL = tracker.load_object("cube_v2")
PLACE = np.array([-0.03, -0.05, 0.0325])
LIGHTS = (1000, 1001, 1002)
"""Seeds of colours, light and noise."""
GREY = [np.full((270, 270, 3), 115, np.uint8)] * 3


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
    pictures = [grey.copy() for grey in GREY]
    for picture, image, labels in zip(pictures, truth.images, truth.labels, strict=True):
        row, column = np.argwhere(labels).mean(axis=0).astype(int) - size // 2
        there = np.s_[row : row + size, column : column + size]
        picture[there] = image[there]
    return pictures


def wavy(image, reach=11.0, period=9.0):
    """The image with every row and every column shifted back and forth by `reach` pixels."""
    y, x = np.indices(image.shape[:2]).astype(np.float32)
    moved = (
        base + np.float32(reach) * np.sin(2 * np.pi * other / period) for base, other in ((x, y), (y, x))
    )
    return cv2.remap(image, *moved, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


HIGH = dataclasses.replace(RIG, arena=dataclasses.replace(RIG.arena, table=0.15))
SMALL = dataclasses.replace(MODEL, size=0.7 * MODEL.size)

DETECTED = {
    "the cube": (Status.FOUND, lambda truth: new().detect(truth.images)),
    "nothing": (Status.NO_OBJECT_COLORS, lambda _: new().detect(GREY)),
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


SPOILT = {
    "upside down": lambda image: np.ascontiguousarray(image[::-1, ::-1]),
    "out of focus": lambda image: cv2.GaussianBlur(image, (0, 0), 12),
}


@pytest.mark.parametrize("spoilt", SPOILT.values(), ids=SPOILT)
def test_pictures_that_show_no_cube_as_it_is_give_no_pose_that_is_sure(truth, spoilt):
    answer = new().detect([spoilt(image) for image in truth.images])
    assert answer.object_pose is None or answer.object_pose.confidence < 0.5


def test_a_cube_behind_wavy_glass_fits_poorly_or_in_several_ways(truth):
    answer = new().detect([wavy(image) for image in truth.images])
    assert answer.status in (Status.POOR_FIT, Status.AMBIGUOUS, Status.OTHER_OBJECT)
    assert answer.object_pose is None


def test_an_empty_arena_gives_no_pose(empty):
    answer = new().detect(empty)
    # Here and there something has a colour of the object.
    assert answer.status in (Status.NO_OBJECT_COLORS, *REFUSED)
    assert answer.object_pose is None


def face_on(c, height):
    """What camera c alone sees of a cube that shows it one face and no other, so far above the centre [m]."""
    towards = RIG[c].position / np.linalg.norm(RIG[c].position)
    aside = np.cross([0.0, 0.0, 1.0], towards)
    aside /= np.linalg.norm(aside)
    rotation = np.stack([aside, np.cross(towards, aside), towards], axis=1)
    truth = shot(height * towards, rotation, cameras=RIG.cameras[c : c + 1])
    assert len(np.unique(truth.labels[0])) == 2
    return [truth.images[0] if k == c else None for k in range(len(RIG))]


def test_one_face_to_one_camera_never_gives_a_pose_that_is_sure():
    answers = [new().detect(face_on(c, height)) for c in range(3) for height in (0.05, 0.06, 0.07, 0.08)]
    assert all(one.object_pose is None or one.object_pose.confidence < 0.5 for one in answers)


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
