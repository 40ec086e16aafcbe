import dataclasses

import numpy as np
import pytest

from tests.helpers.fits import made_fit, with_cameras
from tests.helpers.pushed_cube import DT, new
from tracker import CameraUse
from tracker.conventions import Image
from tracker.tracking.cameras import BLACK, EVERY, CameraMemory, after, looked_at, usable


class Watch:
    """A number of cameras, of which is remembered what there is to remember."""

    def __init__(self, cameras: int) -> None:
        self.memories = [CameraMemory()] * cameras

    def usable(self, images: list[Image | None]) -> list[Image | None]:
        self.memories, result, self.uses = usable(self.memories, images)
        return result


def noise(rng, low=0, high=256):
    return rng.integers(low, high, (90, 90, 3)).astype(np.uint8)


FLAT = [np.full((90, 90, 3), 100 + 10 * c, np.uint8) for c in range(3)]


def given(images):
    return [image is not None for image in images]


def test_watch_gives_the_images_it_was_given(rng):
    watch = Watch(3)
    for _ in range(5):
        images = [noise(rng), None, noise(rng)]
        for one, other in zip(watch.usable(images), images, strict=True):
            assert one is other


def test_watch_leaves_out_what_repeats_while_others_change(rng):
    watch, frozen = Watch(3), noise(rng)
    assert given(watch.usable([frozen, noise(rng), noise(rng)])) == [True] * 3
    for _ in range(3):
        assert given(watch.usable([frozen.copy(), noise(rng), noise(rng)])) == [False, True, True]
    assert given(watch.usable([noise(rng), noise(rng), noise(rng)])) == [True] * 3


def test_watch_sees_change_in_buffers_that_are_used_again(rng):
    watch, buffers, frozen = Watch(2), [noise(rng), noise(rng)], noise(rng)
    watch.usable([frozen, *buffers[1:]])
    for _ in range(3):
        buffers[1][:] = noise(rng)
        assert given(watch.usable([frozen, buffers[1]])) == [False, True]


def test_watch_remembers_a_camera_beyond_images_it_did_not_give(rng):
    watch, frozen = Watch(2), noise(rng)
    watch.usable([frozen, noise(rng)])
    watch.usable([None, noise(rng)])
    assert given(watch.usable([frozen, noise(rng)])) == [False, True]


def test_watch_keeps_all_where_all_repeat_themselves_with_noise_or_without(rng):
    for images in ([noise(rng) for _ in range(3)], FLAT):
        watch = Watch(3)
        for _ in range(3):
            assert given(watch.usable([image.copy() for image in images])) == [True] * 3


def test_watch_keeps_all_of_a_still_picture_beside_a_black_camera(rng):
    watch = Watch(3)
    for level in (3, 7, 3, 7):
        # Its noise changes, but tells nothing.
        assert given(watch.usable([*FLAT[:2], noise(rng, 0, level)])) == [True, True, False]


def test_watch_leaves_out_black_images(rng):
    dark, dim = noise(rng, 0, BLACK), noise(rng, 0, 3 * BLACK)
    assert given(Watch(3).usable([dark, dim, noise(rng)])) == [False, True, True]


@pytest.mark.parametrize("cameras", [1, 3, EVERY, 8])
def test_watch_looks_at_the_light_of_cameras_in_turn(rng, cameras):
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


def test_watch_looks_at_the_light_of_a_camera_when_it_gives_a_picture(rng):
    memories = (CameraMemory(),) * 2
    for _ in range(EVERY + 2):
        memories, fresh = looked_at(memories, [noise(rng), None])
        assert not fresh[1]
    assert looked_at(memories, [noise(rng)] * 2)[1][1]


def test_watch_keeps_still_pictures_without_noise_while_something_moves_in_one():
    watch = Watch(3)
    for k in range(4):
        moving = FLAT[0].copy()
        moving[10:50, 10 + 9 * k : 40 + 9 * k] = 200
        assert given(watch.usable([moving, *FLAT[1:]])) == [True] * 3


USED = [CameraUse.USED] * 3


def astray(c):
    """Camera c shows the object elsewhere."""
    return with_cameras(
        made_fit(), c, agree=0, missing=410, elsewhere=350, usable=0.0, inliers=0.0, squares=0.0
    )


def hidden(c):
    """Something hides the object from camera c."""
    return with_cameras(made_fit(), c, agree=0, missing=410, usable=0.0, inliers=0.0, squares=0.0)


def test_the_verdict_on_a_picture_goes_before_that_of_the_pose():
    uses = [CameraUse.BLACK, CameraUse.USED, CameraUse.FROZEN]
    assert after(uses, astray(0)) == tuple(uses)
    assert after(USED, astray(0)) == (CameraUse.CONTRADICTING, CameraUse.USED, CameraUse.USED)
    assert after(USED, hidden(2)) == tuple(USED)


def test_an_image_that_was_left_out_contradicts_unless_the_object_is_hidden_from_it():
    for shown, use in ((made_fit(), CameraUse.CONTRADICTING), (hidden(2), CameraUse.USED)):
        left_out = dataclasses.replace(shown, left_out=(2,))
        assert after(USED, left_out) == (*USED[:2], use)


def test_each_camera_of_an_observation_has_its_word(rig, film):
    black = np.zeros_like(film[0][0])
    mirrored = np.ascontiguousarray(film[0][2][:, ::-1])
    assert new(rig).detect(film[0]).cameras == tuple(USED)
    assert new(rig).detect([film[0][0], None, film[0][2]]).cameras[1] is CameraUse.NO_IMAGE
    assert new(rig).detect([black, *film[0][1:]]).cameras == (CameraUse.BLACK, *USED[1:])
    assert new(rig).detect([*film[0][:2], mirrored]).cameras == (*USED[:2], CameraUse.CONTRADICTING)
    nothing = new(rig).detect([black] * 3)
    assert nothing.object_pose is None
    assert nothing.cameras == (CameraUse.BLACK,) * 3


def test_a_black_picture_counts_as_none(rig, film):
    one = new(rig).detect([np.zeros_like(film[0][0]), *film[0][1:]]).object_pose
    other = new(rig).detect([None, *film[0][1:]]).object_pose
    assert np.array_equal(one.world_from_object, other.world_from_object)


def test_a_camera_that_is_mirrored_for_a_while_costs_nothing_and_is_used_again(rig, film):
    tracker, uses = new(rig), []
    for k, images in enumerate(film):
        if 2 <= k < 9:
            images = [images[0], np.ascontiguousarray(images[1][:, ::-1]), images[2]]
        answer = tracker.update(images, DT * k)
        assert answer.object_pose is not None
        uses.append(answer.cameras[1].value)
    # Then the mirrored object begins to cover the true one.
    assert uses[2:6] == ["contradicting"] * 4
    assert uses[:2] == ["used"] * 2
    assert uses[-1] == "used"
