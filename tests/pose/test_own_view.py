import dataclasses

import numpy as np
import pytest

import tracker
from tests.helpers.kept_stills import bare
from tracker.geometry import so3
from tracker.pose.agreement import size
from tracker.pose.judge import apparent, confidence
from tracker.pose.result import Status


@pytest.fixture(scope="module")
def stills(rig):
    """Scenes of a cube without fingers."""
    return [bare("cube_v2", rig.cameras, [61, k], kind="rest") for k in range(3)]


def moved(rig, c, shift, turn=(0.0, 0.0, 0.0)):
    """A rig with camera c off by a shift [m] and a turn [rad] in its own frame, which states errors."""
    cameras = []
    for k, camera in enumerate(rig):
        transform = camera.camera_from_world.copy()
        if k == c:
            transform[:3, 3] += shift
            transform[:3] = so3.exp(np.asarray(turn)) @ transform[:3]
        std = np.full((4, 4), 1e-3)
        std[:3, 3] = 5e-4
        cameras.append(dataclasses.replace(camera, camera_from_world=transform, camera_from_world_std=std))
    return dataclasses.replace(rig, cameras=tuple(cameras))


def fits(rig, stills):
    detector = tracker.ObjectTracker(tracker.load_object("cube_v2"), rig)
    return [detector.fit(still.images) for still in stills]


def across(rig, fit):
    """(C, 2) by which each camera sees the object moved across its line of sight, in its own axes [m].

    And (C, 2) the standard deviations of that.
    """
    moved, deviations = [], []
    for camera, one, information in zip(rig, fit.own.moved, fit.own.information, strict=True):
        rotation = camera.camera_from_world[:3, :3]
        moved.append((rotation @ one[:3])[:2])
        covariance = rotation @ np.linalg.pinv(information)[:3, :3] @ rotation.T
        deviations.append(np.sqrt(np.diag(covariance))[:2])
    return np.array(moved), np.array(deviations)


def test_each_camera_by_itself_sees_the_object_where_all_do(rig, stills):
    for fit in fits(rig, stills):
        # A single camera's deviations are 0.06 to 0.6 mm here: no one limit in millimetres suits them all.
        moved, deviations = across(rig, fit)
        assert np.median(np.abs(moved)) < 0.15e-3
        assert (np.abs(moved) < 2 * deviations).all()
        assert (fit.own.inliers > 15).all()
        assert size(fit.disagreement) < 0.5e-3


@pytest.mark.parametrize("c", range(3))
def test_a_camera_that_was_moved_sees_the_object_moved(rig, stills, c):
    shift = np.array([2e-3, -1.5e-3, 0.0])
    given = moved(rig, c, shift)
    before, after = fits(moved(rig, c, np.zeros(3)), stills), fits(given, stills)
    for old, new in zip(before, after, strict=True):
        # The pose moves, too: what the camera sees is where the true pose and the wrong camera have it.
        rotation = given[c].camera_from_world[:3, :3]
        seen = rotation @ (new.position + new.own.moved[c, :3] - old.position - old.own.moved[c, :3])
        np.testing.assert_allclose(seen[:2], -shift[:2], atol=0.3e-3)
        assert size(new.disagreement) > size(old.disagreement)


def test_cameras_of_another_platform_are_not_believed(rig, stills):
    rng = np.random.default_rng(4)
    given = rig
    for c in range(3):
        given = moved(given, c, rng.normal(0.0, 6e-3, 3), rng.normal(0.0, 0.015, 3))
    found = [fit for fit in fits(given, stills) if not isinstance(fit, Status)]
    assert found
    for fit in found:
        assert size(fit.disagreement) > 2e-3
        assert confidence(fit) < 0.7 * apparent(fit)
