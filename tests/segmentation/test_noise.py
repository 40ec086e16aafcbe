"""Noise of a picture, and its mosaic."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tracker.segmentation import mosaic
from tracker.segmentation.noise import LOUD, calmed, noise_level

ROWS, COLUMNS = np.mgrid[0:270, 0:270]
SMOOTH = np.stack([100 + 40 * np.sin(COLUMNS / 40 + k) * np.cos(ROWS / 50) for k in range(3)], axis=-1)


def digitised(image: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def noisy(rng: np.random.Generator, sigma: float, picture: np.ndarray = SMOOTH) -> np.ndarray:
    return digitised(picture + rng.normal(0, sigma, picture.shape))


@pytest.mark.parametrize("sigma", [1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0])
def test_noise_of_a_smooth_picture_is_found(rng, sigma):
    # Rounding to bytes is noise as well.
    assert noise_level(noisy(rng, sigma)) == pytest.approx(np.hypot(sigma, np.sqrt(1 / 12)), rel=0.04)


def test_a_gradient_is_no_noise(rng):
    ramp = np.repeat(0.7 * COLUMNS[..., None], 3, axis=-1)
    assert noise_level(noisy(rng, 4.0, 20 + ramp)) == pytest.approx(4.0, rel=0.04)


def test_brightness_and_contrast_behave(rng):
    image = rng.normal(0, 4.0, SMOOTH.shape)
    level = noise_level(digitised(SMOOTH + image))
    assert noise_level(digitised(SMOOTH + image + 30)) == pytest.approx(level, rel=0.02)
    assert noise_level(digitised(0.5 * (SMOOTH + image))) == pytest.approx(0.5 * level, rel=0.03)
    assert noise_level(255 - digitised(SMOOTH + image)) == level


def test_objects_with_sharp_edges_are_hardly_noise(rng):
    picture = SMOOTH.copy()
    picture[60:140, 80:160] = (30, 40, 190)
    assert noise_level(noisy(rng, 4.0, picture)) == pytest.approx(4.0, rel=0.05)


def test_the_loudest_image_has_a_level(rng):
    stripes = np.zeros((270, 270, 3), np.uint8)
    stripes[:, ::2] = 255
    assert noise_level(stripes) > 100
    assert noise_level(rng.integers(0, 256, (270, 270, 3), dtype=np.uint8)) > 50


@pytest.mark.parametrize("shape", [(270, 1, 3), (1, 1, 3), (2, 2, 3), (1, 270, 3), (270, 270, 3)])
def test_even_images_and_those_too_small_to_tell_have_no_noise(shape):
    assert noise_level(np.full(shape, 93, np.uint8)) == 0.0
    assert noise_level(digitised(SMOOTH)) < 0.5


@pytest.mark.parametrize("sigma", [0.0, 1.5, 0.9 * LOUD])
def test_quiet_images_stay_as_they_are(rng, sigma):
    image = noisy(rng, sigma)
    np.testing.assert_array_equal(calmed(image), image)


@pytest.mark.parametrize("sigma", [1.1 * LOUD, 2 * LOUD])
def test_loud_images_become_quieter_and_keep_their_edges(rng, sigma):
    picture = SMOOTH.copy()
    picture[60:140, 80:160] = (30, 40, 190)
    image = noisy(rng, sigma, picture)
    before = image.copy()
    after = calmed(image)
    np.testing.assert_array_equal(image, before)
    assert (after.shape, after.dtype) == (image.shape, image.dtype)
    assert np.std(after[150:] - picture[150:]) < 0.5 * sigma
    # The step stays between the same two columns: each is much nearer to its own side's colour.
    left, right = picture[70:130, 78].mean(axis=0), picture[70:130, 81].mean(axis=0)
    for column, own in ((79, left), (80, right)):
        seen = after[70:130, column].mean(axis=0)
        assert (np.abs(seen - own) < 0.25 * np.abs(left - right)).all()


BAYER = {
    cv2.COLOR_BAYER_BG2BGR: 0,
    cv2.COLOR_BAYER_GB2BGR: 1,
    cv2.COLOR_BAYER_GR2BGR: 2,
    cv2.COLOR_BAYER_RG2BGR: 3,
}


@pytest.fixture
def raw() -> np.ndarray:
    smooth = cv2.GaussianBlur(np.random.default_rng(3).random((90, 120)), (0, 0), 2.0)
    return (2000 * (smooth - smooth.min())).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("code", BAYER)
def test_every_pattern_is_told_from_its_interpolation_and_changes_where_rows_are_cut_off(raw, code):
    image = cv2.cvtColor(raw, code)
    assert mosaic.find(image) == BAYER[code]
    assert mosaic.find(np.ascontiguousarray(image[1:])) == BAYER[code] ^ 2
    assert mosaic.find(np.ascontiguousarray(image[:, 1:])) == BAYER[code] ^ 1


def with_one_value_changed(image):
    image[12, 22, 1] ^= 64
    return image


@pytest.mark.parametrize(
    "change",
    [
        with_one_value_changed,
        lambda image: cv2.resize(image, (60, 45), interpolation=cv2.INTER_AREA),
        lambda image: cv2.imdecode(cv2.imencode(".jpg", image)[1], cv2.IMREAD_COLOR),
        lambda image: cv2.medianBlur(image, 3),
        lambda image: cv2.convertScaleAbs(image, alpha=1.3),
    ],
    ids=["one value", "halved", "jpeg", "blurred", "brighter"],
)
def test_changed_images_are_none(raw, change):
    assert mosaic.find(change(cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR))) == mosaic.NONE


def test_flat_noisy_and_tiny_images_are_none():
    noise = np.random.default_rng(0).integers(0, 256, (90, 90, 3), dtype=np.uint8)
    for image in (np.zeros((90, 90, 3), np.uint8), np.full((90, 90, 3), 130, np.uint8), noise, noise[:4, :4]):
        assert mosaic.find(np.ascontiguousarray(image)) == mosaic.NONE
