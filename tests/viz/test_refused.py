"""What cannot be drawn, and what the error names."""

import numpy as np
import pytest

from tests.helpers import make_camera
from tests.helpers.pose_logs import random_poses
from tracker.calibration.rig import CameraRig
from tracker.errors import ImageError, TaskError
from tracker.objects.model import load_object
from tracker.pose.result import Observation, Status
from tracker.viz import dice_overlay, goal_picture, overlay, write_film, write_trajectory_plot

RIG = CameraRig(tuple(make_camera(azimuth) for azimuth in (60, 180, 300)))
BLACK = [np.zeros((270, 270, 3), np.uint8)] * 3
MASKS = [np.zeros((270, 270), np.uint8)] * 3


def overlaid(images):
    overlay(images, RIG, load_object("cube_v2"), Observation(None, None, Status.LOST))


@pytest.mark.parametrize(
    ("images", "words"),
    [
        (BLACK[:2], "found 2 images, expected one of each of camera60"),
        ([BLACK[0], BLACK[1][:100], None], r"camera180: found an image uint8 \(100, 270, 3\)"),
        ([BLACK[0] / 255.0, None, None], "float64"),
    ],
)
def test_images_that_do_not_fit_the_rig_are_refused(images, words):
    with pytest.raises(ImageError, match=words):
        overlaid(images)


@pytest.mark.parametrize(
    ("error", "images", "goals", "seen", "positions", "words"),
    [
        (ImageError, BLACK[:2], MASKS, MASKS, None, "found 2 images"),
        (TaskError, BLACK, MASKS[:2], MASKS, None, "2 goal masks, expected one for each of camera60"),
        (TaskError, BLACK, MASKS, [*MASKS, MASKS[0]], None, "found 4 dice masks"),
        (
            TaskError,
            BLACK,
            None,
            [MASKS[0], MASKS[1][:9], None],
            None,
            r"found a dice mask \(9, 270\)",
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
