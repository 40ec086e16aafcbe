from __future__ import annotations

import cv2
import numpy as np
import pytest

from tracker.segmentation import mosaic

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
def test_every_pattern_is_told_from_its_interpolation(raw, code):
    assert mosaic.find(cv2.cvtColor(raw, code)) == BAYER[code]


def test_cutting_off_a_row_or_column_changes_the_pattern(raw):
    image = cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR)
    assert mosaic.find(np.ascontiguousarray(image[1:])) == 2
    assert mosaic.find(np.ascontiguousarray(image[:, 1:])) == 1


@pytest.mark.parametrize("change", ["one value", "halved", "jpeg", "blurred", "brighter"])
def test_changed_images_are_none(raw, change):
    image = cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR)
    if change == "one value":
        image[12, 22, 1] ^= 64
    elif change == "halved":
        image = cv2.resize(image, (60, 45), interpolation=cv2.INTER_AREA)
    elif change == "jpeg":
        image = cv2.imdecode(cv2.imencode(".jpg", image)[1], cv2.IMREAD_COLOR)
    elif change == "blurred":
        image = cv2.medianBlur(image, 3)
    else:
        image = cv2.convertScaleAbs(image, alpha=1.3)
    assert mosaic.find(image) == mosaic.NONE


def test_flat_noisy_and_tiny_images_are_none():
    noise = np.random.default_rng(0).integers(0, 256, (90, 90, 3), dtype=np.uint8)
    for image in (np.zeros((90, 90, 3), np.uint8), np.full((90, 90, 3), 130, np.uint8), noise, noise[:4, :4]):
        assert mosaic.find(np.ascontiguousarray(image)) == mosaic.NONE
