from __future__ import annotations

import math

import numpy as np
import pytest

from tracker.pose import profile
from tracker.pose.edges import COLUMNS, INSIDE, NU, NV, OUTSIDE, REACH_IN, REACH_OUT, U, V

INNER, OUTER, BEYOND = np.array([40.0, 50, 190]), np.array([60.0, 150, 70]), np.array([90.0, 95, 92])


def phi(x: np.ndarray) -> np.ndarray:
    return np.array([0.5 * (1 + math.erf(v / math.sqrt(2))) for v in np.ravel(x)]).reshape(np.shape(x))


def stripes(edge: float, blur: float, width: float = 1e3, slope: float = 0.0) -> np.ndarray:
    """An image with INNER left of column `edge`, OUTER for `width` columns, then BEYOND."""
    j, i = np.mgrid[0:60, 0:60].astype(float)
    at = i - edge - slope * (j - 30)
    step, last = phi(at / blur)[..., None], phi((at - width) / blur)[..., None]
    return INNER * (1 - step) + OUTER * (step - last) + BEYOND * last


def offsets(
    image: np.ndarray,
    predicted: float,
    blur: float,
    *,
    reach: int = 4,
    width: float = 1e3,
    gains: float = 1.0,
) -> np.ndarray:
    """Measured (n, 4) of samples on the column `predicted`; every colour counts as its own surface."""
    samples = np.zeros((20, COLUMNS))
    samples[:, U], samples[:, V], samples[:, NU] = predicted, 15 + np.arange(20), 1.0
    samples[:, NV] = 0.0
    samples[:, INSIDE], samples[:, OUTSIDE] = 1, 2
    samples[:, REACH_IN], samples[:, REACH_OUT] = 1e3, width
    # Red above green is label 1, the rest 2: enough of a colour table for two surfaces.
    levels = np.arange(256) // 4
    channels = np.stack([levels * 0, levels, levels * 64]).astype(np.int32)
    red, green = np.divmod(np.arange(64 * 64), 64)
    table = np.where(red > green, 1, 2).astype(np.uint8)
    readings = np.clip(np.rint(image * gains), 0, 255).astype(np.uint8)
    profiles, readable = np.empty((20, 2 * reach + 1, 3)), np.empty(20, np.bool_)
    out = np.empty((20, 4))
    profile.read_profiles(readings, samples, 20, reach, profiles, readable)
    profile.measure(channels, table, samples, 20, reach, blur, 3.0, profiles, readable, out)
    return out


@pytest.mark.parametrize("edge", [29.6, 30.0, 30.23, 30.4])
@pytest.mark.parametrize("blur", [0.7, 1.2])
def test_offset_converges_to_the_true_edge(edge, blur):
    image, predicted = stripes(edge, blur), 30.0
    for _ in range(4):
        predicted += np.median(offsets(image, predicted, blur)[:, profile.OFFSET])
    assert abs(predicted - edge) < 0.03


def test_wrong_blur_does_not_bias_an_isolated_edge():
    for assumed in (0.7, 1.0, 1.6):
        measured = offsets(stripes(30.0, 1.0), 30.0, assumed)
        assert abs(np.median(measured[:, profile.OFFSET])) < 0.01


def test_gains_do_not_move_the_edge():
    reference = offsets(stripes(30.3, 1.0), 30.0, 1.0)[:, profile.OFFSET]
    for gains in (0.6, 1.3):
        changed = offsets(stripes(30.3, 1.0), 30.0, 1.0, gains=gains)[:, profile.OFFSET]
        np.testing.assert_allclose(changed, reference, atol=0.02)


@pytest.mark.parametrize("width", [2.0, 2.6, 3.3, 4.2])
def test_narrow_face_does_not_bias_its_edge(width):
    measured = offsets(stripes(30.0, 1.0, width), 30.0, 1.0, reach=3, width=width)
    assert (measured[:, profile.VALID] == 1).all()
    assert abs(np.median(measured[:, profile.OFFSET])) < 0.06


def test_blur_is_measured():
    for blur in (0.8, 1.1, 1.5):
        shown = offsets(stripes(30.1, blur), 30.0, blur, reach=6)[:, profile.BLUR]
        assert abs(np.median(shown) - blur) < 0.15 * blur


def test_variance_is_that_of_repeated_noise(rng):
    clean = stripes(30.0, 1.0)
    spread = [
        offsets(clean + rng.normal(0, 3.0, clean.shape), 30.0, 1.0)[10, profile.OFFSET] for _ in range(400)
    ]
    stated = offsets(clean, 30.0, 1.0)[10, profile.VARIANCE]
    assert 0.6 < np.var(spread) / stated < 1.5


def test_another_surface_inside_is_refused():
    swapped = stripes(30.0, 1.0)[:, ::-1]
    assert (offsets(swapped, 29.0, 1.0)[:, profile.VALID] == 0).all()


def test_profiles_beyond_the_border_are_refused():
    assert (offsets(stripes(30.0, 1.0), 2.0, 1.0)[:, profile.VALID] == 0).all()
