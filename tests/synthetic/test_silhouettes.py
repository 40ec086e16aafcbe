import cv2
import numpy as np
import pytest

from tests.helpers import RIG
from tests.helpers.synthetic_needs import missing, skip_without_platform
from tracker.errors import TrackerError

if missing():
    skip_without_platform()

from synthetic.camera.lens import Lens
from synthetic.look.appearance import random_lighting, random_look
from synthetic.render.renderer import render
from synthetic.silhouettes import FingerMasks
from synthetic.world.fingers import REST
from synthetic.world.platform import Platform

JOINTS = np.concatenate([REST, [0.2, 0.9, -1.7], [0.0, 0.7, -1.9]])


@pytest.fixture(scope="module")
def fingers():
    with FingerMasks(RIG) as masks:
        yield masks


def test_the_masks_are_where_pictures_change_with_the_robot(fingers, rng):
    with Platform("cube_v2") as platform:
        look, lighting = random_look(rng, platform.model), random_lighting(rng)
        scenes = [platform.scene((), joints, look, lighting, {}) for joints in (None, JOINTS)]
        for camera, mask in zip(RIG, fingers(JOINTS), strict=True):
            view = Lens(camera, 1)
            near = [render(scene, view.view, shadows=False).nearness for scene in scenes]
            shown = view.to_camera(near[0] != near[1], "label") > 0
            assert mask.shape == (270, 270)
            assert 0.05 < mask.mean() < 0.6
            assert np.count_nonzero(mask & shown) > 0.98 * np.count_nonzero(mask | shown)


def test_fingers_move_with_their_joints_unknown_joints_hide_nothing_and_a_margin_widens_masks(fingers):
    moved = JOINTS.copy()
    moved[3:6] += 0.1
    for before, after in zip(fingers(JOINTS), fingers(moved), strict=True):
        assert (before != after).any()
    np.testing.assert_array_equal(fingers(JOINTS), fingers(JOINTS.tolist()))
    assert fingers(np.full(9, np.nan)) == [None] * 3
    with FingerMasks(RIG, margin=3) as wider:
        for mask, wide in zip(fingers(JOINTS), wider(JOINTS), strict=True):
            assert wide[mask].all()
            away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[wide]
            assert away.max() <= 3.0 * np.sqrt(2)
            assert np.count_nonzero(away) > 100


def test_what_are_no_joint_angles_no_margin_or_no_rig_is_named(fingers):
    for joints in (np.zeros(8), np.zeros((1, 9)), "rest", None):
        with pytest.raises(TrackerError, match=r"joints: found .*, expected numbers of shape \(9,\)"):
            fingers(joints)
    for margin in (-1, 1.5, "3"):
        with pytest.raises(TrackerError, match="margin: found "):
            FingerMasks(RIG, margin=margin)
    with pytest.raises(TrackerError, match="rig: found 'folder', expected CameraRig"):
        FingerMasks("folder")
