import dataclasses

import numpy as np

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers.fits import HOME, made_fit
from tests.helpers.kept_stills import take
from tests.helpers.stills import bare_scene
from tests.pose.test_agreement import moved
from tracker.pipeline import Status
from tracker.pose.agreement import SCALES, spread
from tracker.tracking.cameras import EVERY, LOOKS, Agreement
from tracker.tracking.motion import MotionState


def state(speed=0.0):
    return MotionState(HOME, np.eye(3), np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0]), np.eye(12), 0.5)


def judged(scale):
    """A fit whose cameras disagree by one of SCALES."""
    return dataclasses.replace(made_fit(), disagreement=np.where(scale == SCALES, 0.0, -20.0))


def after(fits, agreement=Agreement(), speed=0.0):  # noqa: B008
    for fit in fits:
        agreement = agreement.after(fit, state(speed))
    return agreement


def test_cameras_are_asked_at_once_and_then_now_and_then():
    agreement, asked = Agreement(), []
    for k in range(3 * EVERY):
        due = agreement.due(state())
        if due:
            asked.append(k)
        agreement = agreement.after(judged(SCALES[2]) if due else made_fit(), state())
    assert asked == [0, EVERY, 2 * EVERY]


def test_of_an_object_that_moves_nothing_is_learned():
    assert not Agreement().due(state(0.1))
    known = after([judged(SCALES[1])])
    assert after([judged(SCALES[-1])] * 20, known, speed=0.1).fitting == known.fitting


def test_only_a_lasting_contradiction_is_one():
    assert not after([judged(SCALES[8])] * (LOOKS - 1)).contradicts
    assert after([judged(SCALES[8])] * LOOKS).contradicts
    assert not after([judged(SCALES[3])] * 50).contradicts
    assert not after([judged(SCALES[3])] * 10 + [judged(SCALES[8])]).contradicts


def test_what_is_remembered_gives_way_to_what_is_seen():
    astray = after([judged(SCALES[8])] * 20)
    assert astray.fitting < 0.1
    mended = after([judged(SCALES[1])] * 20, astray)
    assert mended.fitting > 0.99
    assert not mended.contradicts


def test_over_time_a_wrong_calibration_is_named_and_a_right_one_is_not(rig):
    model = tracker.load_object("cube_v2")
    rng = np.random.default_rng(8)
    scene = bare_scene(model, rng, kind="rest")
    film = [take(scene, rig.cameras, Sensor.realistic(), rng).images for _ in range(4)]
    wrong = moved(moved(rig, 0, (8e-3, 0.0, 0.0)), 1, (0.0, 9e-3, 0.0), (0.0, 0.0, 0.02))
    for given, lasting in ((rig, Status.TRACKING), (wrong, Status.INCONSISTENT_VIEWS)):
        one = tracker.ObjectTracker(model, given)
        answers = [one.update(film[k % 4], 0.1 * k) for k in range((LOOKS + 1) * EVERY)]
        assert answers[-1].status is lasting
        assert answers[-1].object_pose is not None
        sure = lasting is Status.TRACKING
        assert (answers[-1].object_pose.confidence > 0.9) is sure
        doubt = None if sure else Status.INCONSISTENT_VIEWS
        assert {one.detect(images).reason for images in film} == {doubt}
        assert (answers[-1].filtered_object_pose.confidence > 0.9) is sure


def test_covariances_contain_what_cameras_disagree_about_if_their_files_state_errors(rig):
    scene = bare_scene(tracker.load_object("cube_v2"), np.random.default_rng(8), kind="rest")
    images = take(scene, rig.cameras, Sensor.realistic(), np.random.default_rng(9)).images
    stated = moved(rig, 0, (1e-3, 0.0, 0.0))
    exact = dataclasses.replace(
        stated, cameras=tuple(dataclasses.replace(one, camera_from_world_std=None) for one in stated)
    )
    for given, counts in ((stated, True), (exact, False)):
        one = tracker.ObjectTracker("cube_v2", given)
        fit, known = one.fit(images), np.zeros((6, 6))
        known[:3, :3] = np.eye(3) * (spread(fit.disagreement) if counts else 0.0)
        assert spread(fit.disagreement) > (2e-4) ** 2
        np.testing.assert_allclose(one.detect(images).object_pose.covariance, fit.covariance + known)
        answer = one.update(images, 0.0)
        np.testing.assert_allclose(answer.object_pose.covariance, fit.covariance + known)
        filtered = one._memory.belief.motion.state.covariance[:6, :6]
        np.testing.assert_allclose(answer.filtered_object_pose.covariance, filtered + known)
