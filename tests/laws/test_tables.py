"""Tables that are not grey, as all else in the generator's and the platform's images is."""

import cv2
import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.kept_stills import bare
from tracker.pose.fit import Fit

TABLES = {"white": (235, 235, 235), "black": (12, 12, 12)}
FINDERS = {name: tracker.ObjectTracker(name, RIG) for name in ("cube_v2", "cuboid_2x2x8_v2")}


def on_table(name, color, seed):
    """A still, and its images with all around the object in one colour, but for noise."""
    still, rng, images = bare(name, RIG.cameras, [31, seed]), np.random.default_rng(seed), []
    for image, labels in zip(still.images, still.labels, strict=True):
        around = cv2.dilate((labels > 0).astype(np.uint8), np.ones((3, 3))) == 0
        painted = image.copy()
        painted[around] = np.clip(rng.normal(color, 3.0, (np.count_nonzero(around), 3)), 0, 255)
        images.append(painted)
    return still, images


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("name", FINDERS)
def test_an_object_is_found_on_a_table_of_any_brightness(name, table):
    right = []
    for seed in range(6):
        still, images = on_table(name, TABLES[table], seed)
        fit = FINDERS[name].fit(images)
        assert not isinstance(fit, Fit) or np.linalg.norm(fit.position - still.position) < 4e-3
        right.append(isinstance(fit, Fit))
    assert sum(right) >= 5


def test_the_light_in_which_an_object_was_found_is_kept_until_another_shows_it():
    finder, found = tracker.ObjectTracker("cube_v2", RIG), []
    still, black = on_table("cube_v2", TABLES["black"], 0)
    shown = [(0.1 * k, black) for k in range(4)] + [(5.0 + 0.1 * k, list(still.images)) for k in range(3)]
    for stamp, images in shown:
        answer = finder.update(images, stamp)
        assert np.linalg.norm(answer.object_pose.position - still.position) < 1e-3
        found.append((str(answer.status), finder._memory.as_they_are))
    assert found[:4] == [("found", True)] + [("tracking", True)] * 3
    assert found[4:] == [("refound", False)] + [("tracking", False)] * 2
