import dataclasses
import os

import cv2
import numpy as np
import pytest

from tests.helpers import make_camera, make_rig, opencv_pixels
from tests.helpers.pose_logs import random_poses
from tests.viz.conftest import black
from tracker.calibration.rig import CameraRig
from tracker.errors import ImageError, TaskError
from tracker.geometry import cuboid, so3
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import load_object
from tracker.pose.result import Observation, PoseEstimate, Status
from tracker.viz import (
    dice_overlay,
    goal_picture,
    overlay,
    paint,
    write_film,
    write_image,
    write_trajectory_plot,
)
from tracker.viz.overlays import DOUBTFUL

MODEL = load_object("cube_v2")
POSITION = np.array([0.03, -0.02, 0.06])
ROTATION = so3.exp([-1.5, -0.3, 0.9])  # shows every camera three faces, none of them edge-on
GAP = 6


def found(position=POSITION, rotation=ROTATION) -> Observation:
    pose = PoseEstimate(position, so3.quaternion_from_matrix(rotation), np.eye(6) * 1e-8, 0.99)
    return Observation(pose, None, Status.FOUND)


def edge_points(shares=(0.25, 0.4, 0.6, 0.75)) -> np.ndarray:
    """World points (12, K, 3) on the twelve edges."""
    corners = POSITION + cuboid.corners(MODEL.size) @ ROTATION.T
    a, b = corners[cuboid.EDGES[:, 0]], corners[cuboid.EDGES[:, 1]]
    return a[:, None] + np.asarray(shares)[:, None] * (b - a)[:, None]


def visible_edges(camera) -> np.ndarray:
    """(12,) bool, by the signs of the faces' planes."""
    in_object = ROTATION.T @ (camera.position - POSITION)
    seen = [n @ in_object > MODEL.size[0] / 2 for n in cuboid.FACE_NORMALS]
    return np.array([seen[f] or seen[g] for _, _, f, g in cuboid.EDGES])


def test_panels_stand_side_by_side_at_a_readable_size(rig):
    picture = overlay(black(rig), rig, MODEL, found())
    assert picture.dtype == np.uint8
    assert picture.shape[1] == 3 * 540 + 2 * GAP
    assert 540 + 60 < picture.shape[0] < 540 + 300


@pytest.mark.parametrize(("size", "panel"), [(100, 400), (135, 405), (270, 540), (400, 400), (540, 540)])
def test_images_are_enlarged_by_whole_numbers_to_400_pixels_at_least(size, panel):
    rig = CameraRig((make_camera().resized(size, size),))
    assert overlay(black(rig), rig, MODEL, found()).shape[1] == panel


def test_cameras_of_different_sizes_share_a_height(rig):
    mixed = CameraRig((rig[0], rig[1].resized(720, 540), rig[2].cropped(0, 100, 270, 100)))
    picture = overlay(black(mixed), mixed, MODEL, found())
    assert picture.shape[1] == 540 + 720 + 270 * 540 // 100 + 2 * GAP


def test_visible_edges_are_drawn_to_a_tenth_of_a_pixel_where_opencv_projects_them(rig):
    picture = overlay(black(rig), rig, MODEL, found())
    offsets = np.linspace(-2, 2, 41)
    for index, camera in enumerate(rig):
        panel = picture[:540, index * (540 + GAP) :].min(axis=2)
        for points in edge_points(np.linspace(0.2, 0.8, 200))[visible_edges(camera)]:
            # The centre of pixel u of an image is at 2u + ½ of the doubled one.
            pixels = 2 * opencv_pixels(camera, points) + 0.5
            along = pixels[-1] - pixels[0]
            normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
            lines = (pixels[:, None] + offsets[:, None] * normal).astype(np.float32)
            profile = cv2.remap(panel, lines, None, cv2.INTER_LINEAR).astype(float).mean(axis=0)
            assert profile.max() > 150
            assert abs(profile @ offsets / profile.sum()) < 0.1


def test_edges_that_the_object_hides_are_dashed_and_others_solid(rig):
    picture = overlay(black(rig), rig, MODEL, found())
    shares = np.linspace(0.2, 0.8, 200)
    for index, camera in enumerate(rig):
        panel = picture[:540, index * (540 + GAP) :].min(axis=2)
        for points, visible in zip(edge_points(shares), visible_edges(camera), strict=True):
            columns, rows = np.rint(2 * opencv_pixels(camera, points) + 0.5).astype(int).T
            bright = panel[rows, columns] > 90
            assert bright.mean() > 0.99 if visible else 0.25 < bright.mean() < 0.8
            if not visible:
                assert np.count_nonzero(np.diff(bright.astype(int)) == 1) >= 2


@pytest.mark.parametrize(("confidence", "amber"), [(0.49, True), (0.5, False)])
def test_a_hint_is_drawn_in_amber(rig, confidence, amber):
    sure = found()
    doubtful = dataclasses.replace(sure.object_pose, confidence=confidence)
    picture = overlay(black(rig), rig, MODEL, dataclasses.replace(sure, object_pose=doubtful))
    points = edge_points(np.linspace(0.2, 0.8, 50))[visible_edges(rig[0])].reshape(-1, 3)
    columns, rows = np.rint(2 * opencv_pixels(rig[0], points) + 0.5).astype(int).T
    blue, _, red = picture[rows, columns].astype(int).T
    assert (np.median(red - blue) > 100) == amber
    assert (picture[540:] == np.array(DOUBTFUL)).all(axis=2).any() == amber


def test_a_face_is_tinted_in_its_colour(rig):
    picture = overlay(black(rig), rig, MODEL, found())
    face = int(np.argmax(cuboid.FACE_NORMALS @ (ROTATION.T @ (rig[0].position - POSITION))))
    center = POSITION + ROTATION @ cuboid.face_centers(MODEL.size)[face]
    ((column, row),) = 2 * opencv_pixels(rig[0], [center]) + 0.5
    color = DISPLAY_COLORS_BGR[MODEL.face_labels[face]]
    np.testing.assert_array_equal(picture[round(row), round(column)] > 20, color > 0)


@pytest.mark.parametrize("distance", [0.6, 1.0, 5.0])
def test_an_object_out_of_sight_is_not_drawn(distance):
    rig = CameraRig((make_camera(),))
    camera = rig[0]
    nothing = overlay(black(rig), rig, MODEL, Observation(None, None, Status.POOR_FIT))[:540]
    backwards = -camera.camera_from_world[2, :3]
    for direction in (backwards, camera.camera_from_world[0, :3] + 0.1 * backwards):
        away = found(camera.position + distance * direction)
        np.testing.assert_array_equal(overlay(black(rig), rig, MODEL, away)[:540], nothing)


def test_an_object_at_the_cameras_own_place_is_drawn_without_a_warning():
    rig = CameraRig((make_camera(),))
    for offset in (0.0, 0.02, 0.033, 0.05):
        assert overlay(black(rig), rig, MODEL, found(rig[0].position + offset)).shape[1] >= 270


def test_a_missing_image_is_a_panel_that_shows_no_object(rig):
    images = [*black(rig)[:1], None, *black(rig)[2:]]
    here, elsewhere = (overlay(images, rig, MODEL, found(POSITION + dx)) for dx in (0, 0.03))
    middle = slice(540 + GAP, 2 * 540 + GAP)
    np.testing.assert_array_equal(here[:540, middle], elsewhere[:540, middle])
    assert (here[:540, :540] != elsewhere[:540, :540]).any()


def test_without_a_pose_the_caption_gives_the_reason(rig):
    answers = (Observation(None, None, status) for status in (Status.AMBIGUOUS, Status.POOR_FIT))
    first, second = (overlay(black(rig), rig, MODEL, answer) for answer in answers)
    np.testing.assert_array_equal(first[:540], second[:540])
    assert (first[540:] != second[540:]).any()


def test_a_predicted_pose_is_drawn_but_not_called_found(rig):
    measured = found()
    predicted = Observation(None, measured.object_pose, Status.NO_OBJECT_COLORS)
    first, second = (overlay(black(rig), rig, MODEL, seen) for seen in (measured, predicted))
    np.testing.assert_array_equal(first[:540], second[:540])
    assert (first[540:] != second[540:]).any()


def test_the_caption_of_one_camera_wraps_instead_of_running_out(rig):
    one = CameraRig((rig[0],))
    narrow, wide = (overlay(black(r), r, MODEL, found()) for r in (one, rig))
    assert narrow.shape[0] > wide.shape[0]
    margin = narrow[540:, -16:]
    assert (margin == margin[0, 0]).all()


def test_the_title_is_shown(rig):
    plain, titled = (overlay(black(rig), rig, MODEL, found(), title=title) for title in ("", "frame 7"))
    assert plain.shape == titled.shape
    assert (plain != titled).any()


@pytest.mark.parametrize("cameras", [1, 3])
def test_a_note_stands_below_the_numbers_whatever_the_width(rig, cameras):
    few, missed = CameraRig(rig.cameras[:cameras]), Observation(None, None, Status.POOR_FIT)
    plain, noted, longer = (
        overlay(black(few), few, MODEL, missed, note=note)
        for note in ("", "blurred", "camera60: blurred " * 20)
    )
    np.testing.assert_array_equal(noted[: len(plain)], plain)
    assert len(plain) < len(noted) < len(longer)
    margin = longer[540:, -16:]
    assert (margin == margin[0, 0]).all()


def test_an_overlay_changes_nothing_and_is_always_the_same(rig, rng):
    images = [rng.integers(0, 256, image.shape, dtype=np.uint8) for image in black(rig)]
    copies = [image.copy() for image in images]
    first = overlay(images, rig, MODEL, found())
    np.testing.assert_array_equal(first, overlay(images, rig, MODEL, found()))
    for image, copy in zip(images, copies, strict=True):
        np.testing.assert_array_equal(image, copy)


def test_a_written_png_is_read_back_to_the_bit(tmp_path, rng):
    image = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    write_image(tmp_path / "a.PNG", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.PNG")), image)
    write_image(tmp_path / "a.jpg", image)
    assert cv2.imread(str(tmp_path / "a.jpg")).shape == image.shape
    umask = os.umask(0)
    os.umask(umask)
    assert (tmp_path / "a.jpg").stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.gif", "'.gif', expected .png or .jpg"),
        ("a", "no suffix"),
        ("nowhere/a.png", "cannot be written: there is no folder /.*nowhere"),
        ("taken.png", "cannot be written"),
        ("a\0.png", "cannot be written"),
    ],
)
def test_a_file_that_cannot_be_written_is_named(name, message, tmp_path):
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(ImageError, match=message):
        write_image(tmp_path / name, np.zeros((4, 4, 3), np.uint8))
    assert [path.name for path in tmp_path.iterdir()] == ["taken.png"]


def test_a_write_that_breaks_off_leaves_the_old_file(tmp_path, monkeypatch):
    target = tmp_path / "a.png"
    target.write_bytes(b"old")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(ImageError, match=r"a\.png: cannot be written: No space left"):
        write_image(target, np.zeros((4, 4, 3), np.uint8))
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_observations_with_large_numbers_still_fit(rig):
    pose = found(np.array([-123.4567, 0.0, 99.0])).object_pose
    assert pose is not None
    unsure = dataclasses.replace(pose, covariance=np.eye(6) * 1e6)
    overlay(black(rig), rig, MODEL, Observation(unsure, None, Status.FOUND))


BOX = "\uffff"
"""A character of which there is none: fonts show a box, or nothing."""


def written(text: str, at=(8.0, 30.0), width: int = 60, **options) -> np.ndarray:
    picture = np.zeros((40, width, 3), np.uint8)
    paint.put_text(picture, text, at, paint.WHITE, **{"size": 16.0, **options})
    return picture


def test_letters_of_many_languages_and_signs_of_units_are_drawn():
    letters = [*"aouäöüÄÖÜßéèêçñåøłšžČ°±×µ²³–−≤σ√→αω", BOX]
    pictures = {written(letter).tobytes() for letter in letters}
    assert len(pictures) == len(letters)
    assert written("a").any()


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


def test_no_text_changes_nothing():
    assert not written("").any()


RIG = make_rig()
BLACK = [np.zeros((270, 270, 3), np.uint8)] * 3
MASKS = [np.zeros((270, 270), np.uint8)] * 3


def overlaid(images):
    overlay(images, RIG, MODEL, Observation(None, None, Status.LOST))


@pytest.mark.parametrize(
    ("images", "words"),
    [
        (BLACK[:2], "images: found 2, expected an image .* or None for each camera: camera60"),
        ([BLACK[0], BLACK[1][:100], None], "camera180: 270×100 px, but its calibration is for 270×270"),
        ([BLACK[0] / 255.0, None, None], "float64"),
    ],
)
def test_images_that_do_not_fit_the_rig_are_refused(images, words):
    with pytest.raises(ImageError, match=words):
        overlaid(images)


@pytest.mark.parametrize(
    ("error", "images", "goals", "seen", "positions", "words"),
    [
        (ImageError, BLACK[:2], MASKS, MASKS, None, "images: found 2"),
        (TaskError, BLACK, MASKS[:2], MASKS, None, "goal masks: found 2, expected one of each of camera60"),
        (TaskError, BLACK, MASKS, [*MASKS, MASKS[0]], None, "dice masks: found 4"),
        (
            TaskError,
            BLACK,
            None,
            [MASKS[0], MASKS[1][:9], None],
            None,
            r"dice mask of camera180: found shape \(9, 270\)",
        ),
        (TaskError, BLACK, MASKS, [MASKS[0] / 255, None, None], None, "found type float64"),
        (TaskError, BLACK, MASKS, MASKS, [[0.0, 0.0]], "dice: found shape"),
    ],
)
def test_masks_that_do_not_fit_the_rig_are_refused(error, images, goals, seen, positions, words):
    with pytest.raises(error, match=words):
        dice_overlay(images, RIG, goals, seen, positions=positions)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([[0, 0]],), "goal: found shape"),
        (([], [[0, 0]]), "dice: found shape"),
        (([[0, 0, 0]], [[0, 0, 0]], [(0, 1)]), "pairs: found place 0 and die 1, expected less than 1 and 1"),
        (([[0, 0, 0]], [[0, 0, 0]], [(0, -1)]), "pairs: found place 0 and die -1"),
        (([[0, 0, 0]], None, [(0, 0)]), "pairs: found place 0 and die 0"),
    ],
)
def test_a_picture_of_what_does_not_belong_together_is_refused(arguments, words):
    with pytest.raises(TaskError, match=words):
        goal_picture(*arguments)


@pytest.mark.parametrize("yaws", [[0.0], [0.0, np.nan], 0.0])
def test_yaws_that_are_not_those_of_the_dice_are_refused(yaws):
    with pytest.raises(TaskError, match="yaws: found"):
        goal_picture([], [[0, 0, 0], [0.1, 0, 0]], yaws=yaws)


def test_other_formats_are_refused(tmp_path, rng):
    with pytest.raises(ImageError, match=r"expected \.mp4"):
        write_film(tmp_path / "film.gif", BLACK, 10)
    with pytest.raises(ImageError, match=r"found suffix '\.pdf', expected \.png"):
        write_trajectory_plot(tmp_path / "plot.pdf", random_poses(rng, 1))
