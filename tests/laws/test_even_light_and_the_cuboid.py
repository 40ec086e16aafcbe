from __future__ import annotations

import numpy as np
import pytest

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from tests.helpers.colored_light import overlap, ramp
from tests.helpers.kept_stills import take
from tests.helpers.stills import bare_scene

NAME = "cuboid_2x2x8_v2"


@pytest.mark.parametrize("share", [0.1, 0.15, 0.2, 0.3])
@pytest.mark.parametrize("k", [1, 3, 4, 5, 7])
def test_a_slight_ramp_of_coloured_light_leaves_the_labels(share, k):
    model, colors = tracker.load_object(NAME), tracker.load_colors(NAME)
    rng = np.random.default_rng([70, k])
    truth = take(bare_scene(model, rng), default_cameras(), Sensor.realistic(), rng)
    pairs = list(zip(truth.images, truth.labels, strict=True))
    plain = np.mean([overlap(tracker.segment(image, colors), labels) for image, labels in pairs])
    for blue, red in ((share, -share), (-share, share)):
        lit = [overlap(tracker.segment(ramp(image, blue, red), colors), labels) for image, labels in pairs]
        assert np.mean(lit) > 0.9 * plain
