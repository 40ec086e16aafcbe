"""How far the colours end within the nominal edges: several cameras see it, one alone must be given it."""

import dataclasses

import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from synthetic.scene import drawn
from tests.helpers.kept_stills import take
from tests.helpers.stills import bare_scene

SUPPOSED = 6e-4
"""Rim that the object's file states, where pictures show none [m]."""


def pictures(name, rig, k):
    rng = np.random.default_rng([83, k])
    return take(bare_scene(drawn(name), rng, kind="rest"), rig.cameras, Sensor.realistic(), rng)


def supposing(name, rig):
    """A tracker that supposes a rim where there is none, and knows nothing of a table."""
    model = dataclasses.replace(drawn(name), rim=SUPPOSED, rim_std=4e-4)
    return tracker.ObjectTracker(model, rig, table_prior=False)


@pytest.mark.parametrize("name", ["cube_v2", "cuboid_2x2x8_v2"])
def test_several_cameras_find_the_rim(rig, name):
    for k in range(3):
        found = supposing(name, rig).fit(pictures(name, rig, k).images).end
        assert abs(found.rim) < 3 * found.rim_std < SUPPOSED


def test_one_camera_uses_the_rim_that_several_have_shown(rig):
    off = []
    for k in range(3):
        truth = pictures("cube_v2", rig, k)
        alone = [truth.images[0], None, None]
        taught, untaught = supposing("cube_v2", rig), supposing("cube_v2", rig)
        for number in range(3):
            taught.update(truth.images, number / 10)
            untaught.update(alone, number / 10)
        poses = [one.update(alone, 0.3).object_pose for one in (taught, untaught)]
        off.append([np.linalg.norm(pose.position - truth.position) for pose in poses])
    taught, untaught = np.median(off, axis=0)
    assert taught < 0.5 * untaught
