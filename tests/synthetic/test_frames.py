import itertools

import cv2
import numpy as np
import pytest

from tests.helpers.synthetic_needs import missing, skip_without_platform

if missing():
    skip_without_platform()

from synthetic.camera.rigs import standard_rig
from synthetic.frames import DatasetError, FrameMaker, FrameOptions, frames
from tracker import CameraRig

RIG = CameraRig(standard_rig().cameras[:1])


def make(count=2, seed=5, name="cube_v2", **more):
    return list(frames(name, count, seed, rig=RIG, quality="fast", **more))


def pixels(frame):
    return np.concatenate([*frame.images, *frame.labels], axis=None)


def test_a_frame_depends_on_seed_and_number_alone():
    three, (again,), (other,) = make(3), make(1, first=2), make(1, seed=6, first=2)
    assert np.array_equal(pixels(three[2]), pixels(again))
    assert three[2].timestamp == again.timestamp
    assert not np.array_equal(pixels(other), pixels(again))


def test_a_motion_is_as_long_as_asked_for_can_be_entered_anywhere_and_emptied_of_its_object_alone():
    with FrameMaker(FrameOptions("cube_v2", 5, "fast", sequence=True, kind="push", length=3), RIG) as maker:
        motion, (last,) = list(maker.chunk(1)), maker.numbered([5])
        whole, empty = maker.chunk(1, {5}, {5})
    assert [frame.index for frame in motion] == [3, 4, 5]
    assert all(np.array_equal(pixels(motion[2]), pixels(frame)) for frame in (last, whole))
    assert all(a.timestamp < b.timestamp for a, b in itertools.pairwise(motion))
    assert (whole.index, empty.index) == (5, 5)
    assert whole.timestamp == empty.timestamp
    assert len(whole.objects) == 1
    assert empty.objects == ()
    assert not empty.visible_fraction.any()
    assert not any(layer.any() for layer in empty.labels)
    for one, other, layer in zip(whole.images, empty.images, whole.labels, strict=True):
        far = cv2.dilate((layer > 0).astype(np.uint8), np.ones((41, 41))) == 0
        assert np.abs(one.astype(int) - other)[far].mean() < 2
        assert np.abs(one.astype(int) - other)[layer > 0].mean() > 10


def test_no_object_has_no_label_and_dice_have_their_numbers_and_pips_are_no_holes_in_them():
    (frame,) = make(1, empty=1.0)
    assert frame.truth()["object"] is None
    assert not frame.visible_fraction.any()
    assert not any(labels.any() for labels in frame.labels)
    (frame,) = make(1, name="dice", empty=0.0)
    assert len(frame.truth()["object"]) == 25
    seen = set(np.unique(np.concatenate(frame.labels, axis=None)).tolist()) - {0}
    assert len(seen) > 15
    assert seen <= set(range(1, 26))
    for labels in frame.labels:
        for number in set(np.unique(labels).tolist()) - {0}:
            mask = (labels == number).astype(np.uint8)
            _, nesting = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)[-2:]
            assert (nesting[0, :, 3] < 0).all()


def test_default_quality_halves_and_540_does_not():
    options = {"rig": RIG, "shadows": False, "path": "new"}
    (small,), (large,) = (frames("cube_v2", 1, 5, size=size, **options) for size in (270, 540))
    assert small.images[0].shape == (270, 270, 3)
    assert large.images[0].shape == (540, 540, 3)
    # Same scene, cameras and light: the halved large picture is the small one.
    half = cv2.resize(cv2.medianBlur(large.images[0], 3), (270, 270), interpolation=cv2.INTER_AREA)
    assert np.abs(half.astype(int) - small.images[0]).mean() < 1.0


def test_quality_changes_neither_the_blur_nor_the_noise_of_a_camera():
    options = {"rig": RIG, "shadows": False, "path": "new", "size": 540}
    (one,), (other,) = (frames("cube_v2", 1, 5, quality=name, **options) for name in ("fast", "default"))
    # Same light and the same draws of noise; only edges are sampled more finely.
    assert np.mean(one.images[0] != other.images[0]) < 0.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"raw": True}, "raw: found size 270"),
        ({"raw": True, "path": "new"}, "raw"),
        ({"look_alike": "twin"}, "look_alike: found"),
        ({"object_name": "dice", "look_alike": "plain"}, "look_alike: found"),
        ({"length": 0}, "length: found 0"),
        ({"quality": "splendid"}, "quality: found 'splendid', expected one of fast, default, best"),
        ({"size": 300}, "size: found 300, expected one of 270, 540"),
        ({"seed": -1}, "seed: found -1"),
        ({"seed": 1.5}, "seed: found 1.5, expected a whole number from 0"),
        ({"rate": "fast"}, "rate: found 'fast', expected 0.1 to 1000 Hz"),
        ({"empty": 5}, "empty: found 5, expected 0 to 1"),
        ({"path": "straight"}, "path: found 'straight', expected one of None, plain, new, old"),
    ],
)
def test_an_impossible_option_is_named(change, message):
    with pytest.raises(DatasetError, match=message):
        FrameOptions(**{"object_name": "cube_v2", "seed": 1, "quality": "fast", **change})
