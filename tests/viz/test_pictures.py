"""What holds for every drawing, and the files of pictures."""

import os
import re
from functools import partial
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from tests.helpers import make_rig
from tests.helpers.pose_logs import random_poses
from tests.viz.test_overlays import MODEL, black, found
from tracker.calibration.rig import CameraRig
from tracker.errors import ImageError, TaskError, TrackerError
from tracker.tasks import rearrange_dice as dice
from tracker.viz import (
    dice_overlay,
    goal_picture,
    overlay,
    paint,
    write_film,
    write_image,
    write_trajectory_plot,
)
from tracker.viz.calibration import residual_picture
from tracker.viz.image_files import film_rate

RIG = make_rig()
BLACK = black(RIG)
GOAL, PLACES = dice.sample_goal(0), dice.sample_goal(1)
POSES = random_poses(np.random.default_rng(1), 3)


def of_object(images, *_):
    return overlay(images, RIG, MODEL, found())


def of_dice(images, goals, seen, places=None, rig=RIG, **more):
    return dice_overlay(images, rig, goals, seen, positions=places, **more)


def plot_to(path, poses=POSES, title=""):
    write_trajectory_plot(path, poses, title)


def of_goal(*_):
    return goal_picture(GOAL, PLACES, dice.assign(GOAL, PLACES).pairs)


@pytest.mark.parametrize("draw", [of_object, of_dice, of_goal])
def test_a_drawing_is_always_the_same_and_changes_nothing(draw, rng):
    images = [rng.integers(0, 256, image.shape, dtype=np.uint8) for image in BLACK]
    goals, seen = dice.goal_masks(RIG, GOAL), dice.goal_masks(RIG, PLACES)
    arrays = [*images, *goals, *seen, GOAL, PLACES]
    copies = [array.copy() for array in arrays]
    np.testing.assert_array_equal(draw(images, goals, seen), draw(images, goals, seen))
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_captions_wrap_instead_of_running_out(count):
    few = CameraRig(RIG.cameras[:count])
    masks, placed = dice.goal_masks(few, GOAL), dice.assign(GOAL, GOAL)
    pictures = (
        overlay(BLACK[:count], few, MODEL, found()),
        dice_overlay(BLACK[:count], few, masks, masks, positions=GOAL, assignment=placed),
    )
    for picture in pictures:
        margin = picture[540:, -8:]
        assert (margin == margin[0, 0]).all()
    assert count > 1 or len(pictures[0]) > len(of_object(BLACK))


MASKS = [np.zeros((270, 270), np.uint8)] * 3
PLACE, PAIR = [[0, 0, 0]], [[0, 0, 0], [0.1, 0, 0]]


@pytest.mark.parametrize(
    ("draw", "arguments", "error", "words"),
    [
        (of_object, (BLACK[:2],), ImageError, "images: found 2, expected .* for each camera: camera60"),
        (of_object, ([BLACK[0], BLACK[1][:100], None],), ImageError, "camera180: 270×100 px, but its"),
        (of_object, ([BLACK[0] / 255.0, None, None],), ImageError, "float64"),
        (of_dice, (BLACK[:2], MASKS, MASKS), ImageError, "images: found 2"),
        (of_dice, (BLACK, MASKS[:2], MASKS), TaskError, "goal masks: found 2, expected .* each of camera60"),
        (of_dice, (BLACK, MASKS, [*MASKS, MASKS[0]]), TaskError, "dice masks: found 4"),
        (of_dice, (BLACK, None, [MASKS[0], MASKS[1][:9], None]), TaskError, "camera180: found shape .9, 270"),
        (of_dice, (BLACK, MASKS, [MASKS[0] / 255, None, None]), TaskError, "found type float64"),
        (of_dice, (BLACK, MASKS, MASKS, [[0.0, 0.0]]), TaskError, "dice: found shape"),
        (partial(of_dice, rig="demo"), (BLACK, MASKS, MASKS), TaskError, "rig: found 'demo', expected"),
        (partial(of_dice, title=7), (BLACK, MASKS, MASKS), TrackerError, "title: found 7, expected str"),
        (partial(of_dice, assignment=[(0, 1)]), (BLACK, MASKS, MASKS), TaskError, "expected Assignment"),
        (goal_picture, ([[0, 0]],), TaskError, "goal: found shape"),
        (goal_picture, ([], [[0, 0]]), TaskError, "dice: found shape"),
        (goal_picture, (PLACE, PLACE, [(0, 1)]), TaskError, "place 0 and die 1, expected less than 1 and 1"),
        (goal_picture, (PLACE, PLACE, [(0, -1)]), TaskError, "pairs: found place 0 and die -1"),
        (goal_picture, (PLACE, PLACE, [(0, 0.5)]), TaskError, "pairs: found place 0 and die 0.5"),
        (goal_picture, (PLACE, None, [(0, 0)]), TaskError, "pairs: found place 0 and die 0"),
        (goal_picture, (PLACE, PLACE, dice.assign(PLACE, PLACE)), TaskError, "pairs: found Assignment"),
        (goal_picture, (PLACE, PLACE, [0]), TaskError, r"pairs: found a list of 1, expected pairs"),
        (partial(goal_picture, yaws=["a"]), ([], PLACE), TaskError, "yaws: found a list of 1, expected num"),
        (partial(goal_picture, yaws=[0.0]), ([], PAIR), TaskError, "yaws: found"),
        (partial(goal_picture, yaws=[0.0, np.nan]), ([], PAIR), TaskError, "yaws: found"),
        (plot_to, ("a.png", "poses.h5"), TrackerError, "poses: found 'poses.h5', expected Poses"),
        (plot_to, ("a.png", POSES, POSES), TrackerError, "title: found Poses.*, expected str"),
    ],
)
def test_what_does_not_belong_together_is_refused(draw, arguments, error, words):
    with pytest.raises(error, match=words):
        draw(*arguments)


def test_a_written_png_is_read_back_to_the_bit(tmp_path, rng):
    image = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    write_image(tmp_path / "a.PNG", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.PNG")), image)
    write_image(tmp_path / "a.jpg", image)
    assert cv2.imread(str(tmp_path / "a.jpg")).shape == image.shape


RATE = np.float32(10)


def image_to(path, image=BLACK[0]):
    write_image(path, image)


def film(count=12, shape=(60, 81)):
    for k in range(count):
        picture = np.full((*shape, 3), 40, np.uint8)
        picture[:, : 5 * k] = (30, 60, 200)
        yield picture


def film_to(path, pictures=None, rate=RATE):
    return write_film(path, film() if pictures is None else pictures, rate)


FLOATS = r"found float64 of shape .*, expected uint8 of shape \(H, W\)"
UNEQUAL = r"image 2: found uint8 of shape \(80, 81, 3\), expected images of one size"


@pytest.mark.parametrize(
    ("write", "name", "message"),
    [
        (image_to, "a.gif", "'.gif', expected .png or .jpg"),
        (image_to, "a", "no suffix"),
        (image_to, "nowhere/a.png", "cannot be written: there is no folder /.*nowhere"),
        (image_to, "taken.png", "cannot be written"),
        (image_to, "a\0.png", "found a null byte"),
        (partial(image_to, image=BLACK[0] / 255), "a.png", FLOATS),
        (partial(image_to, image=None), "a.png", "found None, expected uint8"),
        (partial(image_to, image=np.zeros(5, np.uint8)), "a.png", r"found uint8 of shape \(5,\)"),
        (partial(image_to, image=np.zeros((70000, 2), np.uint8)), "a.jpg", r"70000, 2\), expected at most"),
        (film_to, "film.gif", r"expected \.mp4"),
        *(
            (partial(film_to, rate=rate), "a.mp4", re.escape(f"rate: found {rate}, expected 0.001 to 1000"))
            for rate in (0, 2e4, 4e-4)
        ),
        (partial(film_to, pictures=film(1, (1, 9))), "f.mp4", "image 0: found .*, expected images"),
        (partial(film_to, pictures=[*film(2), *film(1, (80, 81))]), "f.mp4", UNEQUAL),
        (partial(film_to, pictures=[*film(2), None]), "f.mp4", "image 2: found None, expected images"),
        (partial(film_to, pictures=()), "f.mp4", r"f\.mp4: found no images for it, expected at least one"),
        (film_to, None, "film: found None, expected a path"),
        (image_to, None, "image: found None, expected a path"),
        (plot_to, None, "plot: found None, expected a path"),
        (plot_to, "plot.pdf", r"found suffix '\.pdf', expected \.png"),
    ],
)
def test_a_file_that_cannot_be_written_is_named(write, name, message, tmp_path):
    if name == "f.mp4":
        pytest.importorskip("av", reason="video: no module av")
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(ImageError, match=message):
        write(None if name is None else tmp_path / name)
    assert os.listdir(tmp_path) == ["taken.png"]


@pytest.mark.parametrize("write", [image_to, plot_to])
def test_a_write_that_breaks_off_leaves_the_old_file(write, tmp_path, monkeypatch):
    if write is plot_to:
        pytest.importorskip("matplotlib", reason="plot: no module matplotlib")
    target = tmp_path / "a.png"
    target.write_bytes(b"old")

    monkeypatch.setattr(os, "replace", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(ImageError, match=r"a\.png: cannot be written: No space left"):
        write(target)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.png"]


def test_residuals_point_their_way_however_long(monkeypatch):
    drawn, missed = [], np.array([[0.1, 0.2], [20.0, 5.0], [-300.0, 1.0]])
    monkeypatch.setattr(paint, "stroke", lambda _, lines, *how: drawn.extend(lines))
    photos = [(np.full((1, 2), 99.0), missed[:1], True), (np.full((2, 2), 99.0), missed[1:], False)]
    residual_picture("camera60", (270, 270), photos)
    *ways, _ = (line[1] - line[0] for line in drawn if len(line) == 2)
    angles = [np.arctan2(*way) for way in ways]
    assert angles == pytest.approx([np.arctan2(*way) for way in missed])


def test_film_holds_its_pictures_in_order(tmp_path):
    av = pytest.importorskip("av", reason="video: no module av")
    assert film_to(tmp_path / "film.mp4") == 12
    with av.open(str(tmp_path / "film.mp4")) as opened:
        assert float(opened.streams.video[0].average_rate) == pytest.approx(10)
        # Its pixels are BT.601's; of a large film without a matrix, players assume BT.709's.
        assert opened.streams.video[0].codec_context.colorspace == 6
        read = [frame.to_ndarray(format="bgr24") for frame in opened.decode(video=0)]
    assert len(read) == 12
    for k, (shown, expected) in enumerate(zip(read, film(), strict=True)):
        assert shown.shape == (60, 80, 3)
        assert np.abs(shown.astype(int) - expected[:, :80]).mean() < 6, k


@pytest.mark.parametrize(
    ("stamps", "rate"),
    [([1.0, 1.1, 1.1, 1.1, 1.2], 10.0), ([0.0, 0.0], 10.0), ([], 10.0), ([0.0, 1e-3], 60.0), ([0, 9], 0.5)],
)
def test_a_films_rate_is_that_of_its_stamps_but_for_repeated_ones(stamps, rate):
    assert film_rate(stamps) == pytest.approx(rate)


def test_a_broken_off_film_leaves_nothing(tmp_path):
    pytest.importorskip("av", reason="video: no module av")

    def breaks():
        yield from film(3)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError):
        write_film(tmp_path / "film.mp4", breaks(), 10)
    assert os.listdir(tmp_path) == []
