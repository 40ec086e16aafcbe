import dataclasses

import cv2
import numpy as np
import pytest

from tests.helpers import make_camera, opencv_pixels
from tracker.calibration.rig import CameraRig
from tracker.geometry import cuboid, so3
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import load_object
from tracker.pose.result import Observation, PoseEstimate, Status
from tracker.viz import overlay, paint
from tracker.viz.overlays import DOUBTFUL, GOOD

MODEL = load_object("cube_v2")
POSITION = np.array([0.03, -0.02, 0.06])
ROTATION = so3.exp([-1.5, -0.3, 0.9])  # shows every camera three faces, none of them edge-on
GAP = 6


def black(rig: CameraRig) -> list[np.ndarray]:
    """An image for each camera."""
    return [np.zeros((camera.height, camera.width, 3), np.uint8) for camera in rig]


def found(position=POSITION, rotation=ROTATION) -> Observation:
    pose = PoseEstimate(position, so3.quaternion_from_matrix(rotation), np.eye(6) * 1e-8, 0.99)
    return Observation(pose, None, Status.FOUND)


MISSED = Observation(None, None, Status.POOR_FIT)


def edge_points(shares) -> np.ndarray:
    """World points (12, K, 3) on the twelve edges."""
    corners = POSITION + cuboid.corners(MODEL.size) @ ROTATION.T
    a, b = corners[cuboid.EDGES[:, 0]], corners[cuboid.EDGES[:, 1]]
    return a[:, None] + np.asarray(shares)[:, None] * (b - a)[:, None]


def visible_edges(camera) -> np.ndarray:
    """(12,) bool, by the signs of the faces' planes."""
    in_object = ROTATION.T @ (camera.position - POSITION)
    seen = [n @ in_object > MODEL.size[0] / 2 for n in cuboid.FACE_NORMALS]
    return np.array([seen[f] or seen[g] for _, _, f, g in cuboid.EDGES])


def shown_at(camera, points) -> np.ndarray:
    """Pixels (N, 2) in a panel of twice the image's size: the centre of pixel u is at 2u + ½."""
    return 2 * opencv_pixels(camera, points) + 0.5


def test_panels_stand_side_by_side_at_a_readable_size_and_share_a_height(rig):
    picture = overlay(black(rig), rig, MODEL, found())
    assert picture.dtype == np.uint8
    assert picture.shape[1] == 3 * 540 + 2 * GAP
    assert 540 + 60 < picture.shape[0] < 540 + 300
    mixed = CameraRig((rig[0], rig[1].resized(720, 540), rig[2].cropped(0, 100, 270, 100)))
    picture = overlay(black(mixed), mixed, MODEL, found())
    assert picture.shape[1] == 540 + 720 + 270 * 540 // 100 + 2 * GAP


@pytest.mark.parametrize(("size", "panel"), [(100, 400), (135, 405), (270, 540), (400, 400), (540, 540)])
def test_images_are_enlarged_by_whole_numbers_to_400_pixels_at_least(size, panel):
    rig = CameraRig((make_camera().resized(size, size),))
    assert overlay(black(rig), rig, MODEL, found()).shape[1] == panel


def test_visible_edges_are_solid_where_opencv_projects_them_to_a_tenth_of_a_pixel_and_hidden_dashed(rig):
    picture = overlay(black(rig), rig, MODEL, found())
    offsets, shares = np.linspace(-2, 2, 41), np.linspace(0.2, 0.8, 200)
    for index, camera in enumerate(rig):
        panel = picture[:540, index * (540 + GAP) :].min(axis=2)
        for points, visible in zip(edge_points(shares), visible_edges(camera), strict=True):
            pixels = shown_at(camera, points)
            columns, rows = np.rint(pixels).astype(int).T
            bright = panel[rows, columns] > 90
            if not visible:
                assert 0.25 < bright.mean() < 0.8
                assert np.count_nonzero(np.diff(bright.astype(int)) == 1) >= 2
                continue
            assert bright.mean() > 0.99
            along = pixels[-1] - pixels[0]
            normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
            lines = (pixels[:, None] + offsets[:, None] * normal).astype(np.float32)
            profile = cv2.remap(panel, lines, None, cv2.INTER_LINEAR).astype(float).mean(axis=0)
            assert profile.max() > 150
            assert abs(profile @ offsets / profile.sum()) < 0.1


@pytest.mark.parametrize(("confidence", "amber"), [(0.49, True), (0.5, False)])
def test_a_hint_is_drawn_in_amber(rig, confidence, amber):
    sure = found()
    doubtful = dataclasses.replace(sure.object_pose, confidence=confidence)
    picture = overlay(black(rig), rig, MODEL, dataclasses.replace(sure, object_pose=doubtful))
    points = edge_points(np.linspace(0.2, 0.8, 50))[visible_edges(rig[0])].reshape(-1, 3)
    columns, rows = np.rint(shown_at(rig[0], points)).astype(int).T
    blue, _, red = picture[rows, columns].astype(int).T
    assert (np.median(red - blue) > 100) == amber
    assert (picture[540:] == np.array(DOUBTFUL)).all(axis=2).any() == amber


def test_a_face_is_tinted_in_its_colour(rig):
    picture = overlay(black(rig), rig, MODEL, found())
    face = int(np.argmax(cuboid.FACE_NORMALS @ (ROTATION.T @ (rig[0].position - POSITION))))
    center = POSITION + ROTATION @ (cuboid.FACE_NORMALS[face] * MODEL.size / 2)
    ((column, row),) = shown_at(rig[0], [center])
    color = DISPLAY_COLORS_BGR[MODEL.face_labels[face]]
    np.testing.assert_array_equal(picture[round(row), round(column)] > 20, color > 0)


@pytest.mark.parametrize("distance", [0.6, 1.0, 5.0])
def test_an_object_out_of_sight_is_not_drawn(distance):
    rig = CameraRig((make_camera(),))
    camera = rig[0]
    nothing = overlay(black(rig), rig, MODEL, MISSED)[:540]
    backwards = -camera.camera_from_world[2, :3]
    for direction in (backwards, camera.camera_from_world[0, :3] + 0.1 * backwards):
        away = found(camera.position + distance * direction)
        np.testing.assert_array_equal(overlay(black(rig), rig, MODEL, away)[:540], nothing)


def test_an_object_at_the_cameras_own_place_or_with_large_numbers_is_drawn_without_a_warning():
    rig = CameraRig((make_camera(),))
    for offset in (0.0, 0.02, 0.033, 0.05):
        assert overlay(black(rig), rig, MODEL, found(rig[0].position + offset)).shape[1] >= 270
    pose = found(np.array([-123.4567, 0.0, 99.0])).object_pose
    unsure = dataclasses.replace(pose, covariance=np.eye(6) * 1e6)
    overlay(black(rig), rig, MODEL, Observation(unsure, None, Status.FOUND))


def test_a_missing_image_is_a_panel_that_shows_no_object(rig):
    images = [*black(rig)[:1], None, *black(rig)[2:]]
    here, elsewhere = (overlay(images, rig, MODEL, found(POSITION + dx)) for dx in (0, 0.03))
    middle = slice(540 + GAP, 2 * 540 + GAP)
    np.testing.assert_array_equal(here[:540, middle], elsewhere[:540, middle])
    assert (here[:540, :540] != elsewhere[:540, :540]).any()


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"observation": MISSED}, {"observation": Observation(None, None, Status.AMBIGUOUS)}),
        ({}, {"observation": Observation(None, found().object_pose, Status.NO_OBJECT_COLORS)}),
        ({}, {"title": "frame 7"}),
    ],
    ids=["reason", "predicted", "title"],
)
def test_the_caption_alone_tells_the_reason_what_is_predicted_and_the_title(rig, first, second):
    one, other = (
        overlay(black(rig), rig, MODEL, **{"observation": found(), **given}) for given in (first, second)
    )
    np.testing.assert_array_equal(one[:540], other[:540])
    assert one.shape == other.shape
    assert (one[540:] != other[540:]).any()


@pytest.mark.parametrize("field", ["status", "reason"])
def test_a_pose_that_cameras_contradict_is_called_doubtful(rig, field):
    sure, against = found(), dataclasses.replace(found(), **{field: Status.INCONSISTENT_VIEWS})
    for observation, doubtful in ((sure, False), (against, True)):
        below = overlay(black(rig), rig, MODEL, observation)[540:]
        colors = [(below == np.array(color)).all(axis=2).any() for color in (DOUBTFUL, GOOD)]
        assert colors == [doubtful, not doubtful]


@pytest.mark.parametrize("cameras", [1, 3])
def test_a_note_stands_below_the_numbers_whatever_the_width(rig, cameras):
    few = CameraRig(rig.cameras[:cameras])
    plain, noted, longer = (
        overlay(black(few), few, MODEL, MISSED, note=note)
        for note in ("", "blurred", "camera60: blurred " * 20)
    )
    np.testing.assert_array_equal(noted[: len(plain)], plain)
    assert len(plain) < len(noted) < len(longer)
    margin = longer[540:, -16:]
    assert (margin == margin[0, 0]).all()


def written(text: str, at=(8.0, 30.0), width: int = 60, **options) -> np.ndarray:
    picture = np.zeros((40, width, 3), np.uint8)
    paint.put_text(picture, text, at, paint.WHITE, **{"size": 16.0, **options})
    return picture


def test_letters_of_many_languages_and_signs_of_units_are_drawn():
    letters = "aouäöüÄÖÜßéèêçñåøłšžČ°±×µ²³–−≤σ√→αω\uffff"  # no letter at the end: a box, or nothing
    pictures = {written(letter).tobytes() for letter in letters}
    assert len(pictures) == len(letters)
    assert written("a").any()
    assert not written("").any()


def test_text_is_as_wide_as_stated_and_starts_and_ends_where_it_should():
    text, image_width = "Würfel ±0.5°", 300
    width = paint.text_width(text, 16.0)
    for align in (0.0, 0.5, 1.0):
        picture = written(text, (150.0, 30.0), image_width, align=align)
        columns = np.flatnonzero(picture.any(axis=(0, 2)))
        assert abs(columns[0] - (150 - align * width)) < 3
        assert abs(columns[-1] - (150 + (1 - align) * width)) < 3


def test_digits_are_as_high_as_is_asked_for_and_equally_wide():
    for size in (9.0, 12.0, 14.4, 18.0):
        rows = np.flatnonzero(written("8", (8.0, 30.0), size=size).any(axis=(1, 2)))
        assert abs(rows[-1] - rows[0] + 1 - size) < 0.2 * size
        assert rows[-1] in (29, 30)
        assert len({paint.text_width(digit, size) for digit in "0123456789"}) == 1


@pytest.mark.parametrize(
    "at", [(-25.0, 30.0), (40.0, 30.0), (8.0, 3.0), (8.0, 48.0), (-400.0, 9.0), (8.0, 900.0)]
)
def test_text_beyond_the_borders_is_cut_off(at):
    large = np.zeros((3 * 1040, 3 * 460, 3), np.uint8)
    paint.put_text(large, "Text", (at[0] + 460, at[1] + 1040), paint.WHITE, size=16.0)
    np.testing.assert_array_equal(written("Text", at), large[1040:1080, 460:520])
