from __future__ import annotations

import numpy as np
import pytest

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.raycast import render
from synthetic.raycast.scene import random_scene

NAME = "cuboid_2x2x8_v2"


def ramp(image, blue, red):
    """The image in light that has so much more blue at its right border than in the middle, and red below."""
    height, width = image.shape[:2]
    x, y = np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height)
    factors = np.ones((height, width, 3))
    factors[..., 0] += blue * x
    factors[..., 2] += red * y[:, None]
    return np.clip(np.rint(image * factors), 0, 255).astype(np.uint8)


def overlap(found, true):
    """Intersection over union of the pixels that show the right face."""
    return np.count_nonzero((found == true) & (true > 0)) / np.count_nonzero((found > 0) | (true > 0))


@pytest.mark.parametrize("share", [0.1, 0.15, 0.2, 0.3])
@pytest.mark.parametrize("k", [1, 3, 4, 5, 7])
def test_a_slight_ramp_of_coloured_light_leaves_the_labels(share, k):
    model, colors = tracker.load_object(NAME), tracker.load_colors(NAME)
    rng = np.random.default_rng([70, k])
    truth = render(random_scene(model, rng, occlusion=0.0), default_cameras(), model, Sensor.realistic(), rng)
    pairs = list(zip(truth.images, truth.labels, strict=True))
    plain = np.mean([overlap(tracker.segment(image, colors), labels) for image, labels in pairs])
    for blue, red in ((share, -share), (-share, share)):
        lit = [overlap(tracker.segment(ramp(image, blue, red), colors), labels) for image, labels in pairs]
        assert np.mean(lit) > 0.9 * plain
