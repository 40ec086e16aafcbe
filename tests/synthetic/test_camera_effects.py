import dataclasses

import cv2
import numpy as np
import pytest
from numpy.random import default_rng as rng

from synthetic.camera.lens import Lens
from synthetic.camera.optics import CORNER, Coma, Focus, Fringes
from synthetic.camera.response import LEVELS, NOISE, OLD_NOISE, Drift, FixedPattern, Response, Sharpening
from synthetic.camera.rigs import default_cameras, standard_rig
from synthetic.camera.sensor import CameraSettings, Sensor, linear, mosaicked
from synthetic.camera.units import units_of
from synthetic.effects import NAMES, EffectError, chosen_effects, stream
from tests.helpers import opencv_pixels

RAMP = np.tile(np.arange(8, dtype=np.float32), (8, 1))
PLACE = np.full((1, 1), 3.51, np.float32)
EXACT = abs(float(cv2.remap(RAMP, PLACE, PLACE, cv2.INTER_LINEAR)[0, 0]) - 3.51) < 1e-4
"""Whether OpenCV takes pictures between pixels exactly, or as older versions at the next 32nd of a pixel."""

NEUTRAL = CameraSettings(np.ones(3), np.zeros(2))
OWN = ("focus", "fringes", "skewed_psf", "sharpening", "fixed_pattern", "drift")


def edge(height):
    """Light of a vertical edge, the mean over each pixel."""
    profile = np.clip(np.arange(80, dtype=np.float32) - 39.8, 0, 1)
    return np.tile(profile[:, None], (height, 1, 3))


def spread(profile):
    """Variance of the derivative of an edge [px²]."""
    steps, x = np.diff(profile.astype(np.float64)), np.arange(len(profile) - 1)
    middle = (steps * x).sum() / steps.sum()
    return float((steps * (x - middle) ** 2).sum() / steps.sum())


IN_FOCUS = Focus(least=0.1, slope=0.5, focused=2.0, shifts=(0.0, 0.0, 0.0))


@pytest.mark.parametrize("focus", [IN_FOCUS, *(Focus.sample(rng(seed)) for seed in range(5))])
@pytest.mark.parametrize("height", [270, 540])
def test_each_part_of_a_picture_is_as_sharp_as_its_distance_to_the_focus_has_it(focus, height):
    parts = np.array([1.2, 2.0, 3.5], np.float32)
    light = focus.blurred(edge(height), np.tile(np.repeat(parts, height // 3)[:, None], 80))
    for nearness, row in zip(parts, height * np.array([1, 3, 5]) // 6, strict=True):
        for channel in range(3):
            away = nearness - focus.focused - focus.shifts[channel]
            expected = (focus.least**2 + (focus.slope * away) ** 2) * (height / 540) ** 2
            added = spread(light[row, :, channel]) - spread(edge(1)[0, :, channel])
            assert added == pytest.approx(expected, rel=1e-3)
    # Blur neither makes nor takes light.
    light = np.pad(rng(0).uniform(0, 1, (40, 40, 3)).astype(np.float32), ((10, 10), (10, 10), (0, 0)))
    blurred = Focus(0.3, 0.3, 1.0, (0.5, 0.0, 0.0)).blurred(light, np.full((60, 60), 2.0, np.float32))
    assert blurred.sum() == pytest.approx(light.sum(), rel=1e-5)


def test_fringes_are_none_in_the_middle_and_grow_with_the_distance_to_it():
    straight = dataclasses.replace(default_cameras(270)[0], distortion=np.zeros(5))
    lens = Lens(straight, 2)
    layer = np.tile(np.arange(lens.view.width, dtype=np.float32)[:, None], (lens.view.height, 1, 3))
    fringes = Fringes(blue=-0.2, red=0.5)
    seen = lens.to_camera(layer, "mean", fringes.stretch)
    # A larger picture shows at a pixel what is nearer to the middle.
    away = np.arange(5, 265) - straight.matrix[0, 2]
    for channel, shift in ((0, fringes.blue), (2, fringes.red)):
        moved = 0.5 * (seen[:, 5:265, 1] - seen[:, 5:265, channel]) - shift * away / CORNER
        np.testing.assert_allclose(moved, 0, atol=2e-3 if EXACT else 1 / 96)
    assert np.array_equal(seen[..., 1], lens.to_camera(layer, "mean")[..., 1])


@pytest.mark.parametrize(("supersampling", "stretch"), [(1, None), (2, None), (3, None), (1, 1.01)])
def test_pictures_are_those_of_opencvs_lens_and_stretched_channels_of_a_longer_one(supersampling, stretch):
    camera = default_cameras(270)[1]
    lens = Lens(camera, supersampling)
    view, channels = lens.view, None if stretch is None else np.array([stretch, stretch, 1.0])
    even = np.full((view.height, view.width, 3), 0.3, np.float32)
    np.testing.assert_allclose(lens.to_camera(even, "mean", channels), 0.3, rtol=1e-6)
    # A layer that holds its own rays: coordinates come back as OpenCV distorts them.
    columns, rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
    x, y = (columns - view.cx) / view.fx, (rows - view.cy) / view.fy
    seen = lens.to_camera(np.dstack([x, y, np.ones(x.shape)]), "mean", channels).astype(np.float64)
    longer = camera.matrix.copy()
    longer[(0, 1), (0, 1)] *= stretch or 1.0
    pixels = opencv_pixels(dataclasses.replace(camera, matrix=longer), seen.reshape(-1, 3), np.eye(4))
    expected = np.stack(np.meshgrid(np.arange(270), np.arange(270)), axis=-1)
    np.testing.assert_allclose(pixels.reshape(expected.shape), expected, atol=0.01 if EXACT else 1 / 32)


@pytest.mark.parametrize("seed", range(5))
def test_the_response_is_that_of_its_inverse_and_keeps_the_brightness_of_a_picture(seed):
    response = Response.sample(rng(seed))
    sensor = dataclasses.replace(response.of(Sensor(psf_sigma=0.0)), noise=None, vignetting=0.0)
    levels = np.arange(1.0, 256.0)
    black = np.array(sensor.black)
    light = (linear(levels, response.exponent)[:, None] * (1 - black) + black) / sensor.gain
    picture = sensor.expose(light[None].astype(np.float32), rng(0), NEUTRAL)
    assert np.array_equal(picture[0], np.repeat(levels.astype(np.uint8)[:, None], 3, axis=1))
    before = Sensor(psf_sigma=0.0, vignetting=0.2, gamma=2.0)
    light = np.full((100, 100, 3), 0.2, np.float32)
    after = dataclasses.replace(response, black=0.0).of(before)
    means = [own.expose(light, rng(0), NEUTRAL).mean() for own in (before, after)]
    assert means[1] == pytest.approx(means[0], rel=0.04)


@pytest.mark.parametrize("exponent", [1.5, 2.0])
@pytest.mark.parametrize(("path", "share"), [("new", (1.0, 1.0)), ("old", OLD_NOISE)])
def test_the_noise_of_a_response_is_the_measured_one(path, share, exponent):
    sensor = Response(exponent, 1e-6, 0.5, 1.0).of(Sensor(psf_sigma=0.0, path=path))
    sensor = dataclasses.replace(sensor, vignetting=0.0)
    for k, level in enumerate(LEVELS):
        light = np.full((300, 300, 3), linear(np.array(level), exponent) / sensor.gain, np.float32)
        raw = mosaicked(sensor.expose(light, rng(1), NEUTRAL))
        found = [raw[1::2, 1::2].std(), raw[0::2, 1::2].std(), raw[0::2, 0::2].std()]
        assert found == pytest.approx([share[k] * noise[k] for noise in NOISE], rel=0.1)


def test_sharpening_leaves_what_is_even_and_steepens_edges():
    mask = Sharpening(amount=0.5, sigma=1.0)
    even = np.full((540, 30, 3), 77, np.uint8)
    assert np.array_equal(mask.applied(even), even)
    step = np.rint(60 + 100 * edge(540)).astype(np.uint8)
    sharp = mask.applied(step)
    assert sharp.max() > step.max() + 2
    assert sharp.min() < step.min() - 2
    assert np.array_equal(Sharpening(0.0, 1.0).applied(step), step)


def test_a_skewed_spread_keeps_light_and_place_and_is_skewed_the_way_of_its_tail():
    cells = np.arange(-4.0, 5.0)
    for seed in range(5):
        coma = Coma.sample(rng(seed))
        kernel, tail = coma.kernel(540), (np.cos(coma.direction), np.sin(coma.direction))
        assert kernel.sum() == pytest.approx(1, abs=1e-9)
        assert (kernel.sum(axis=0) @ cells, kernel.sum(axis=1) @ cells) == pytest.approx((0, 0), abs=1e-9)
        along = cells[None, :] * tail[0] + cells[:, None] * tail[1]
        assert (kernel * along**2).sum() < coma.length**2
    kernel = Coma(3.0, 0.0).kernel(540)
    assert (kernel.sum(axis=0) * cells**3).sum() > 0.1
    light = np.zeros((540, 11, 3), np.float32)
    light[270, 5] = 1
    np.testing.assert_allclose(Coma(3.0, 0.0).applied(light)[266:275, 1:10, 1], kernel, atol=1e-6)


def test_a_fixed_pattern_is_as_strong_as_drawn_and_stays_and_exposure_drifts_slowly_and_as_drawn():
    own, light = FixedPattern.sample(rng(1)), np.full((540, 540, 3), 0.5, np.float32)
    once, again = own.applied(light), own.applied(light)
    assert np.array_equal(once, again)
    spread = np.hypot(0.5 * own.gain, own.offset)
    assert once[..., 1].std() == pytest.approx(spread, rel=0.02)
    assert once[..., 1].mean(axis=0).std() == pytest.approx(np.sqrt(0.2) * spread, rel=0.15)
    assert own.applied(light, binned=True)[..., 1].std() == pytest.approx(spread / 2, rel=0.02)
    assert not np.array_equal(once, FixedPattern.sample(rng(2)).applied(light))
    own = Drift.sample(rng(3))
    factors = np.log([own.at(time) for time in np.arange(0.0, 3 * own.period, 0.1)])
    assert np.abs(factors).max() == pytest.approx(own.amplitude, rel=0.01)
    assert np.abs(np.diff(factors)).max() < 0.03
    unit = dataclasses.replace(units_of(standard_rig(), Sensor(), rng(0), (), 1, 1)[0], drift=own)
    np.testing.assert_allclose(unit.at(2.0).settings.gains / unit.settings.gains, own.at(2.0))


def test_effects_of_cameras_leave_each_others_draws_alone_and_differ_by_camera_and_scene():
    rig, sensor = standard_rig(), Sensor.sample(rng(1), "new")
    every, other = (units_of(rig, sensor, rng(2), NAMES, 5, number) for number in (6, 7))
    for own in OWN[:2]:
        assert len({getattr(unit, own) for unit in (*every, *other)}) == 6
    usual = rng(2)
    none = units_of(rig, sensor, usual, (), 5, 6)
    after = usual.random()
    for name in NAMES:
        generator = rng(2)
        only = units_of(rig, sensor, generator, [name], 5, 6)
        for unit, full, bare in zip(only, every, none, strict=True):
            assert np.array_equal(unit.settings.gains, bare.settings.gains)
            for own in OWN:
                assert getattr(unit, own) == (getattr(full, own) if own == name else None)
            if name == "response":
                assert dataclasses.replace(unit.sensor, psf_sigma=0.0) == full.sensor
            elif name != "focus":
                assert unit.sensor == bare.sensor
        # What is drawn afterwards stays as well.
        assert generator.random() == after


def test_a_text_names_what_is_on_in_one_order_and_an_unknown_effect_is_refused_by_its_name():
    assert chosen_effects("none") == chosen_effects("") == chosen_effects(()) == ()
    assert chosen_effects("world") == chosen_effects(reversed(NAMES)) == NAMES
    for text in ("focus, chamfers", ["focus", "chamfers"]):
        assert chosen_effects(text) == ("chamfers", "focus")
    for found in ("fog", "chamfers,fog", ["fog"]):
        with pytest.raises(EffectError, match="effect: found 'fog', expected one of chamfers"):
            chosen_effects(found)


def test_streams_of_effects_differ_by_name_seed_and_number():
    keys = [("chamfers", 1, 2), ("table", 1, 2), ("chamfers", 2, 2), ("chamfers", 1, 3)]
    draws = {stream(*key).random() for key in keys}
    assert len(draws) == len(keys)
    assert stream(*keys[0]).random() == stream(*keys[0]).random()
    assert not draws & {np.random.default_rng([1, k, 2]).random() for k in range(3)}
