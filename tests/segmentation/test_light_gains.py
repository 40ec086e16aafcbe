from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.segmentation.light import (
    BRIGHTNESS_RANK,
    TARGET_GREY,
    apply_gains,
    grey_world_gains,
    neutral_gains,
)

factor = st.floats(0.75, 1.3)


def grey_scene(seed: int = 0, size: int = 270) -> np.ndarray:
    """Mostly grey of different brightness, with saturated patches on a ninth of it; float64."""
    rng = np.random.default_rng(seed)
    image = np.linspace(70, 150, size)[:, None, None] * np.ones((size, size, 3))
    image *= rng.choice([0.8, 1.0, 1.15], (3, 3, 1)).repeat(size // 3, 0).repeat(size // 3, 1)
    for bgr in ((40, 40, 180), (150, 60, 25), (50, 190, 190)):
        row, column = rng.integers(0, size - size // 5, 2)
        image[row : row + size // 5, column : column + size // 5] = bgr
    return image + rng.normal(0, 2, image.shape)


def exposed(image: np.ndarray, gains=(1.0, 1.0, 1.0)) -> np.ndarray:
    return np.clip(np.rint(image * np.asarray(gains)), 0, 255).astype(np.uint8)


@given(gains=st.tuples(factor, factor, factor), seed=st.integers(0, 5))
def test_neutral_gains_invert_the_lights_gains(gains, seed):
    scene = grey_scene(seed)
    reference, _ = neutral_gains(exposed(scene))
    found, _ = neutral_gains(exposed(scene, gains))
    np.testing.assert_allclose(found * gains / reference, 1, atol=0.02)


@pytest.mark.parametrize("size", [60, 135, 270, 540])
def test_neutral_gains_do_not_depend_on_the_resolution(size):
    expected, _ = neutral_gains(exposed(grey_scene(1, 270)))
    found, share = neutral_gains(exposed(grey_scene(1, size)))
    np.testing.assert_allclose(found, expected, rtol=0.03)
    assert share > 0.5


@given(gains=st.tuples(factor, factor, factor))
def test_normalising_makes_the_scenes_grey_grey(gains):
    scene = grey_scene(2)
    image = exposed(scene, gains)
    normalised = apply_gains(image, neutral_gains(image)[0])
    greys = normalised[np.ptp(scene, axis=2) < 20]
    np.testing.assert_allclose(greys.mean(axis=0) / greys[:, 1].mean(), 1, atol=0.02)
    np.testing.assert_allclose(np.quantile(greys, BRIGHTNESS_RANK, axis=0), TARGET_GREY, atol=3)


@pytest.mark.parametrize("color", [(0, 0, 0), (3, 3, 3), (255, 255, 255), (0, 0, 255), (255, 255, 0)])
def test_without_any_grey_the_image_is_left_as_it_is(color):
    gains, share = neutral_gains(np.full((100, 100, 3), color, np.uint8))
    np.testing.assert_array_equal(gains, 1)
    assert share == 0


def test_clipped_greys_do_not_pull_the_colour_of_grey():
    scene = grey_scene(3)
    reference, _ = neutral_gains(exposed(scene))
    scene[:60] = 400  # a wall that is white whatever the gains
    found, _ = neutral_gains(exposed(scene, (1.2, 1.0, 0.9)))
    ratio = found * (1.2, 1.0, 0.9) / reference
    np.testing.assert_allclose(ratio / ratio[1], 1, atol=0.02)


@given(gains=st.tuples(factor, factor, factor))
def test_the_grey_world_inverts_the_lights_gains_too(gains):
    scene = np.clip(grey_scene(4), 0, 190)
    reference = grey_world_gains(exposed(scene))
    np.testing.assert_allclose(grey_world_gains(exposed(scene, gains)) * gains / reference, 1, atol=0.02)


def test_the_grey_world_of_a_black_image_is_finite():
    assert np.isfinite(grey_world_gains(np.zeros((50, 50, 3), np.uint8))).all()


@given(gains=st.tuples(factor, factor, factor))
def test_gains_are_applied_by_rounding_and_clipping(gains):
    image = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    np.testing.assert_array_equal(apply_gains(image, np.array(gains)), exposed(image.astype(float), gains))
