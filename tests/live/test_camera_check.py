import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.helpers import RIG
from tests.helpers.filmed import shots
from tests.live.test_live import Given
from tracker.calibration.rig import CameraRig
from tracker.live import ImageSet
from tracker.live.camera_check import CameraLooks, look_at


@pytest.fixture(scope="module")
def image():
    return shots("cube_v2", 1, seed=621)[0].images[0]


def noisy(image, rng):
    return np.clip(image.astype(int) + rng.integers(-2, 3, image.shape), 0, 255).astype(np.uint8)


def faults(image, change=lambda one, _: one, skew=0.0):
    """Of a camera whose pictures are changed; `change` takes a picture and its number, and gives another."""
    rng, looks = np.random.default_rng(4), CameraLooks("camera60", (270, 270))
    for number in range(20):
        looks.see(change(noisy(image, rng), number), "buffer torn", skew)
    return looks.faults()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda one, n: None if n % 5 == 0 else one, "4 of 20 images are missing; 4 ×: buffer torn"),
        (lambda one, n: None, "20 of 20 images are missing"),
        (lambda one, n: one // 8, "dark, median grey level"),
        (lambda one, n: one // 255 + np.uint8(n % 2), "dark, median grey level"),  # shows no edge
        (lambda one, n: np.minimum(one.astype(int) * 6, 255).astype(np.uint8), "over-exposed"),
        (lambda one, n: cv2.GaussianBlur(one, (0, 0), 4), "blurred by"),
        (lambda one, n: cv2.blur(one, (15, 1)), "blurred by"),
        (lambda one, n: one[:240], "20 images have 270x240 px, but the calibration is for 270x270"),
    ],
)
def test_what_is_wrong_is_named(change, words, image):
    (fault,) = faults(image, change)
    assert words in fault


def test_a_camera_that_hangs_or_is_late_is_named_and_a_good_one_is_not(image):
    assert faults(image) == faults(image, skew=0.01) == []
    assert faults(image, lambda *_: image) == ["19 of 20 images are the same as before: it hangs"]
    (fault,) = faults(image, skew=0.05)
    assert fault.startswith("its images are 50 ms older")


def test_sets_are_looked_at_until_the_source_ends(image):
    rng = np.random.default_rng(5)
    rig = CameraRig(tuple(RIG)[:2])
    given = [ImageSet((noisy(image, rng), None), (1.0 + n, 1.0 + n), age=0.2) for n in range(4)]
    looks = look_at(Given(*given), rig, 30.0)
    assert looks.sets == 4
    assert [camera.pictures for camera in looks.cameras] == [4, 0]
    assert looks.faults() == [
        f"{rig.names[1]}: 4 of 4 images are missing; 4 ×: no image",
        "images are 200 ms old when they arrive",
    ]


def test_a_source_that_gives_nothing_is_reported():
    looks = look_at(SimpleNamespace(next=time.sleep), RIG, 0.05)
    assert looks.faults() == ["no images came at all"]
