from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

import tracker
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from tests.helpers.kept_stills import take
from tests.helpers.stills import bare_scene
from tracker.geometry import so3
from tracker.pose.judge import log_odds

NAMES = ("cube_v2", "cuboid_2x2x8_v2")
AXES = ((0, 1, 0), (-1, 0, 0))
CAMERAS = default_cameras()


@functools.cache
def seen(name, k):
    """A scene without fingers, its images by the usual cameras, and the fit to them."""
    rng, model = np.random.default_rng([70, k]), tracker.load_object(name)
    scene = bare_scene(model, rng)
    images = take(scene, CAMERAS, Sensor.realistic(), rng).images
    return scene, images, tracker.ObjectTracker(model, tracker.CameraRig(CAMERAS)).fit(images)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("degrees", [55, 60, 65, 75])
def test_cameras_that_look_far_aside_neither_help_nor_harm(name, degrees):
    model = tracker.load_object(name)
    for k in range(2):
        scene, images, reference = seen(name, k)
        more = []
        for n, axis in enumerate(AXES):
            turn = np.eye(4)
            turn[:3, :3] = so3.exp(np.radians(degrees) * np.asarray(axis, dtype=float))
            for camera in CAMERAS:
                moved = turn @ camera.camera_from_world
                more.append(dataclasses.replace(camera, name=f"{camera.name}_{n}", camera_from_world=moved))
        others = take(scene, more, Sensor.realistic(), np.random.default_rng(1), points=1)
        blind = [c for c, labels in enumerate(others.labels) if not labels.any()]
        assert blind
        rig = tracker.CameraRig((*CAMERAS, *(more[c] for c in blind)))
        fit = tracker.ObjectTracker(model, rig).fit([*images, *(others.images[c] for c in blind)])
        assert fit.cameras["expected"][3:].sum() == 0
        assert fit.cameras["predicted"][3:].sum() == 0
        assert abs(log_odds(fit) - log_odds(reference)) < 0.5
