import dataclasses

import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from synthetic.scene import drawn
from tests.helpers import apart, within
from tests.helpers.kept_stills import bare, take
from tests.helpers.stills import bare_scene, posed_scene
from tracker.geometry import so3

OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")
SCENES = 4
KNOWN = tracker.Arena(table_std=(1e-4, 1e-3))


def pictures(name, rig, k, lift=0.0, tilt=0.0):
    """Pictures of an object on the table, lifted and tilted by so much, and its pose."""
    model = drawn(name)
    rng = np.random.default_rng([71, k])
    (state,) = bare_scene(model, rng, kind="rest").objects
    rotation = so3.exp(np.array([tilt, 0.0, 0.0])) @ state.rotation
    height = np.abs(rotation[2]) @ np.asarray(model.size) / 2 + lift
    position = np.array([*state.position[:2], height])
    return take(posed_scene(model, (position, rotation), rng), rig.cameras, Sensor.realistic(), rng)


def trackers(name, rig, arena=KNOWN):
    """One that knows of the table, and one that does not."""
    model, known = drawn(name), dataclasses.replace(rig, arena=arena)
    return tracker.ObjectTracker(model, known), tracker.ObjectTracker(model, known, table_prior=False)


@pytest.mark.parametrize("name", OBJECTS)
def test_one_camera_finds_an_object_at_rest_as_exactly_as_the_table_is_known(rig, name):
    found = []
    for k in range(SCENES):
        truth = pictures(name, rig, k)
        poses = [one.detect([truth.images[0], None, None]).object_pose for one in trackers(name, rig)]
        found.append([(1.0, 1.0) if pose is None else apart(pose, truth) for pose in poses])
    with_table, without = np.median(found, axis=0)
    assert with_table[0] < 3e-4
    assert with_table[1] < np.radians(0.25)
    assert with_table[0] < 0.5 * without[0]


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize(("lift", "tilt"), [(0.004, 0.0), (0.0, 0.06), (0.03, 0.0), (0.0, 0.7), (0.05, 0.5)])
def test_what_does_not_rest_stays_where_three_cameras_see_it(rig, name, lift, tilt):
    for k in (0, 2):
        truth = pictures(name, rig, k, lift, tilt)
        known, unknown = (one.detect(truth.images).object_pose for one in trackers(name, rig))
        assert within(known, unknown, 3e-4, 0.5)


@pytest.mark.parametrize(("table", "seed"), [(None, 0), (0.006, 1)])
def test_no_table_and_one_elsewhere_by_as_much_as_is_stated_force_nothing_on_three_cameras(rig, table, seed):
    truth, arena = pictures("cube_v2", rig, seed), tracker.Arena(table=table)
    one = trackers("cube_v2", rig, arena)[0].detect(truth.images).object_pose
    other = trackers("cube_v2", rig, arena if table else tracker.Arena())[1].detect(truth.images).object_pose
    assert np.linalg.norm(one.position - other.position) < 2e-5
    if table is None:
        np.testing.assert_allclose(np.diag(one.covariance), np.diag(other.covariance), rtol=0.2)
        alone, nowhere = [truth.images[0], None, None], dataclasses.replace(KNOWN, table=None)
        known, free = (trackers("cube_v2", rig, it)[0].detect(alone).object_pose for it in (KNOWN, nowhere))
        assert known.covariance[2, 2] < 0.25 * free.covariance[2, 2]


SUPPOSED = 6e-4
"""Rim that the object's file states, where pictures show none [m]."""


def at_rest(name, rig, k):
    return bare(drawn(name), rig.cameras, [83, k], kind="rest")


def supposing(name, rig):
    """A tracker that supposes a rim where there is none, and knows nothing of a table."""
    model = dataclasses.replace(drawn(name), rim=SUPPOSED, rim_std=4e-4)
    return tracker.ObjectTracker(model, rig, table_prior=False)


@pytest.mark.parametrize("name", OBJECTS)
def test_several_cameras_find_the_rim_and_pictures_make_none_less_certain(rig, name):
    for k in range(3):
        found = supposing(name, rig).fit(at_rest(name, rig, k).images).end
        assert abs(found.rim) < 3 * found.rim_std < SUPPOSED
    for std in (1e-6, 3e-5, 4e-4):
        model = dataclasses.replace(drawn(name), rim=0.0, rim_std=std)
        assert tracker.ObjectTracker(model, rig).fit(at_rest(name, rig, 0).images).end.rim_std <= std


def test_one_camera_uses_the_rim_that_several_have_shown(rig):
    off = []
    for k in range(3):
        truth = at_rest("cube_v2", rig, k)
        alone = [truth.images[0], None, None]
        taught, untaught = supposing("cube_v2", rig), supposing("cube_v2", rig)
        for number in range(3):
            taught.update(truth.images, number / 10)
            untaught.update(alone, number / 10)
        poses = [one.update(alone, 0.3).object_pose for one in (taught, untaught)]
        off.append([np.linalg.norm(pose.position - truth.position) for pose in poses])
    taught, untaught = np.median(off, axis=0)
    assert taught < 0.5 * untaught
