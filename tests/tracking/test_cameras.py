import dataclasses

import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers.fits import HOME, made_fit, with_cameras
from tests.helpers.kept_stills import take
from tests.helpers.pushed_cube import DT, new
from tests.helpers.stills import bare_scene
from tests.pose.test_agreement import moved
from tracker import CameraUse, Status
from tracker.checks import BLACK
from tracker.pose.agreement import SCALES, size, spread
from tracker.pose.judge import confidence
from tracker.tracking.cameras import EVERY, LOOKS, Agreement, CameraMemory, after, looked_at, unfrozen, usable
from tracker.tracking.motion import MotionState


class Watch:
    """A number of cameras, of which is remembered what there is to remember."""

    def __init__(self, cameras):
        self.memories = [CameraMemory()] * cameras

    def given(self, images):
        self.memories, result, _ = unfrozen(self.memories, *usable(images))
        return [image is not None for image in result]


def noise(rng, low=0, high=256):
    return rng.integers(low, high, (90, 90, 3)).astype(np.uint8)


FLAT = [np.full((90, 90, 3), 100 + 10 * c, np.uint8) for c in range(3)]


def test_watch_sees_change_in_buffers_that_are_used_again_and_remembers_cameras_that_gave_no_image(rng):
    watch, buffer, frozen = Watch(2), noise(rng), noise(rng)
    watch.given([frozen, buffer])
    for image in (frozen, frozen, frozen, None, frozen):
        buffer[:] = noise(rng)
        assert watch.given([image, buffer]) == [False, True]


def test_an_image_that_repeats_blocks_of_the_last_is_not_frozen(rng):
    first = rng.integers(0, 256, (270, 40, 3)).astype(np.uint8)
    for row in range(0, 262, 7):
        image, watch = first.copy(), Watch(2)
        image[row : row + 8, 30:38] = 255 - image[row : row + 8, 30:38]
        watch.given([first, noise(rng)])
        assert watch.given([image, noise(rng)]) == [True, True]


def test_watch_keeps_all_where_all_repeat_themselves_with_noise_or_without(rng):
    for images in ([noise(rng) for _ in range(3)], FLAT):
        watch = Watch(3)
        for _ in range(3):
            assert watch.given([image.copy() for image in images]) == [True] * 3


def test_watch_leaves_out_black_images_and_keeps_all_of_a_still_picture_beside_them(rng):
    dark, dim, watch = noise(rng, 0, BLACK), noise(rng, 0, 3 * BLACK), Watch(3)
    assert Watch(3).given([dark, dim, noise(rng)]) == [False, True, True]
    for level in (3, 7, 3, 7):
        # Its noise changes, but tells nothing.
        assert watch.given([*FLAT[:2], noise(rng, 0, level)]) == [True, True, False]


@pytest.mark.parametrize("cameras", [1, 3, EVERY, 8])
def test_watch_looks_at_the_light_of_cameras_in_turn_and_when_they_give_a_picture(rng, cameras):
    images, rounds = [noise(rng)] * cameras, []
    memories = (CameraMemory(),) * cameras
    for _ in range(4 * EVERY + 1):
        memories, fresh = looked_at(memories, images)
        rounds.append(np.flatnonzero(fresh).tolist())
    # All at once at first, since nothing is known; then as evenly as can be, each once in EVERY pictures.
    assert rounds[0] == list(range(cameras))
    assert max(map(len, rounds[1:])) == -(-cameras // EVERY)
    for c in range(cameras):
        times = [k for k, round_ in enumerate(rounds) if c in round_][1:]
        assert times[0] <= EVERY
        assert set(np.diff(times)) == {EVERY}
    memories = (CameraMemory(),) * (cameras + 1)
    for _ in range(EVERY + 2):
        memories, fresh = looked_at(memories, [*images, None])
        assert not fresh[-1]
    assert looked_at(memories, [*images, noise(rng)])[1][-1]


USED = [CameraUse.USED] * 3


def hidden(c, elsewhere=0):
    """Camera c does not show the object, or shows it elsewhere."""
    nothing = {"agree": 0, "missing": 410, "usable": 0.0, "inliers": 0.0, "squares": 0.0}
    return with_cameras(made_fit(), c, elsewhere=elsewhere, **nothing)


def test_the_verdict_on_a_picture_goes_before_that_of_the_pose_also_on_one_that_was_left_out():
    uses = [CameraUse.BLACK, CameraUse.USED, CameraUse.FROZEN]
    assert after(uses, hidden(0, elsewhere=350)) == tuple(uses)
    assert after(USED, hidden(0, elsewhere=350)) == (CameraUse.CONTRADICTING, CameraUse.USED, CameraUse.USED)
    assert after(USED, hidden(2)) == tuple(USED)
    # An image that was left out contradicts unless the object is hidden from it.
    for shown, use in ((made_fit(), CameraUse.CONTRADICTING), (hidden(2), CameraUse.USED)):
        left_out = dataclasses.replace(shown, left_out=(2,))
        assert after(USED, left_out) == (*USED[:2], use)


def test_each_camera_of_an_observation_has_its_word_and_a_black_picture_counts_as_none(rig, film):
    (first, *others), detect = film[0], new(rig).detect
    black, mirrored = np.zeros_like(first), np.ascontiguousarray(others[1][:, ::-1])
    assert detect(film[0]).cameras == tuple(USED)
    assert detect([first, others[0], mirrored]).cameras == (*USED[:2], CameraUse.CONTRADICTING)
    missing, dark, nothing = detect([None, *others]), detect([black, *others]), detect([black] * 3)
    assert missing.cameras == (CameraUse.NO_IMAGE, *USED[1:])
    assert dark.cameras == (CameraUse.BLACK, *USED[1:])
    assert np.array_equal(dark.object_pose.world_from_object, missing.object_pose.world_from_object)
    assert nothing.object_pose is None
    assert nothing.cameras == (CameraUse.BLACK,) * 3


def test_a_camera_that_is_mirrored_for_a_while_costs_nothing_and_is_used_again(rig, film):
    one, uses = new(rig), []
    for k, images in enumerate(film):
        if 2 <= k < 9:
            images = [images[0], np.ascontiguousarray(images[1][:, ::-1]), images[2]]
        answer = one.update(images, DT * k)
        assert answer.object_pose is not None
        uses.append(answer.cameras[1].value)
    # Then the mirrored object begins to cover the true one.
    assert uses[2:6] == ["contradicting"] * 4
    assert uses[:2] == ["used"] * 2
    assert uses[-1] == "used"


def state(speed=0.0):
    return MotionState(HOME, np.eye(3), np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0]), np.eye(12), 0.5)


def judged(scale):
    """A fit whose cameras disagree by one of SCALES."""
    return dataclasses.replace(made_fit(), disagreement=np.where(scale == SCALES, 0.0, -20.0))


def learned(fits, agreement=Agreement(), speed=0.0):  # noqa: B008
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
    known = learned([judged(SCALES[1])])
    assert learned([judged(SCALES[-1])] * 20, known, speed=0.1).fitting == known.fitting


def test_only_a_lasting_contradiction_is_one():
    assert not learned([judged(SCALES[8])] * (LOOKS - 1)).contradicts
    assert learned([judged(SCALES[8])] * LOOKS).contradicts
    assert not learned([judged(SCALES[3])] * 50).contradicts
    assert not learned([judged(SCALES[3])] * 10 + [judged(SCALES[8])]).contradicts


def test_what_is_remembered_gives_way_to_what_is_seen_and_one_check_that_is_mistaken_to_those_that_follow():
    wrong = learned([judged(SCALES[8])] * 20)
    assert wrong.fitting < 0.1
    mended = learned([judged(SCALES[1])] * 20, wrong)
    assert mended.fitting > 0.99
    assert not mended.contradicts

    def astray(certainty):
        return dataclasses.replace(made_fit(), disagreement=np.where(SCALES < 6e-3, -certainty, 0.0))

    sure = learned([judged(SCALES[1])] * 4, learned([astray(1000.0)]))
    assert sure.fitting > 0.9
    assert learned([astray(1000.0)] * 4, learned([judged(SCALES[1])])).fitting < 0.1
    one, other = (learned([astray(certainty)]).disagreement for certainty in (1000.0, 50.0))
    np.testing.assert_array_equal(one, other)


@pytest.fixture(scope="module")
def resting(rig):
    """Four times images of a cube that rests."""
    rng = np.random.default_rng(8)
    scene = bare_scene(tracker.load_object("cube_v2"), rng, kind="rest")
    return [take(scene, rig.cameras, Sensor.realistic(), rng).images for _ in range(4)]


def test_over_time_a_wrong_calibration_is_named_and_a_right_one_is_not(rig, resting):
    wrong = moved(moved(rig, 0, (8e-3, 0.0, 0.0)), 1, (0.0, 9e-3, 0.0), (0.0, 0.0, 0.02))
    for given, lasting in ((rig, Status.TRACKING), (wrong, Status.INCONSISTENT_VIEWS)):
        one = new(given)
        for k in range((LOOKS + 1) * EVERY):
            answer = one.update(resting[k % 4], 0.1 * k)
        assert answer.status is lasting
        sure = lasting is Status.TRACKING
        assert (answer.object_pose.confidence > 0.9) is sure
        assert (answer.filtered_object_pose.confidence > 0.9) is sure
        assert {one.detect(images).reason for images in resting} == {None if sure else lasting}


def test_poses_are_those_of_fits_and_covariances_contain_stated_errors_that_cameras_show(rig, resting):
    images, stated = resting[0], moved(rig, 0, (1e-3, 0.0, 0.0))
    exact = tuple(dataclasses.replace(one, camera_from_world_std=None) for one in stated)
    for given, counts in ((stated, True), (tracker.CameraRig(exact), False)):
        one = new(given)
        fit, known = one.fit(images), np.zeros((6, 6))
        wide = spread(size(fit.disagreement), 3)
        known[:3, :3] = np.eye(3) * (wide if counts else 0.0)
        assert wide > (2e-4) ** 2
        pose = one.detect(images).object_pose
        np.testing.assert_array_equal(pose.position, fit.position)
        np.testing.assert_allclose(pose.rotation, fit.rotation, atol=1e-12)
        assert pose.confidence == confidence(fit)
        np.testing.assert_allclose(pose.covariance, fit.covariance + known)
        answer = one.update(images, 0.0)
        np.testing.assert_allclose(answer.object_pose.covariance, fit.covariance + known)
        filtered = one._memory.belief.motion.state.covariance[:6, :6]
        np.testing.assert_allclose(answer.filtered_object_pose.covariance, filtered + known)
