import dataclasses

import cv2
import numpy as np
import pytest
from numpy.random import default_rng as rng
from scipy.ndimage import center_of_mass

from scripts.camera_measures import noise_curve
from synthetic.camera.sensor import CameraSettings, Sensor, demosaicked, linear, mosaicked

NEUTRAL = CameraSettings(np.ones(3), np.zeros(2))
INNER = np.s_[2:-2, 2:-2]  # OpenCV copies values to the border


def test_what_is_below_the_black_level_is_zero_and_bright_light_ends_at_the_ceiling():
    levels = {"black": (0.004, 0.004, 0.004), "ceiling": (255.0, 249.0, 255.0)}
    sensor = Sensor(psf_sigma=0.0, gamma=2.0, path="new", **levels)
    dark = sensor.expose(np.full((8, 8, 3), 0.003, np.float32), rng(0), NEUTRAL)
    bright = sensor.expose(np.full((8, 8, 3), 3.0, np.float32), rng(0), NEUTRAL)
    assert (dark == 0).all()
    assert (bright == [255, 249, 255]).all()


def test_noise_of_a_mosaic_is_greatest_in_the_dark_as_in_recorded_pictures():
    sensor = dataclasses.replace(Sensor.sample(rng(0), "new"), vignetting=0.0, black=(0.0, 0.0, 0.0))
    noise = {}
    for level in (40, 120):
        light = np.full((200, 200, 3), linear(np.array(level)), np.float32)
        raw = mosaicked(sensor.expose(light, rng(1), NEUTRAL))
        noise[level] = [raw[0::2, 0::2].std(), raw[0::2, 1::2].std(), raw[1::2, 1::2].std()]
    # Measured on recorded pictures: red, green and blue 5.6, 4.0, 7.0 at level 40 and 2.0, 2.2, 2.4 at 120.
    assert noise[40] == pytest.approx([5.6, 4.0, 7.0], rel=0.35)
    assert noise[120] == pytest.approx([2.2, 2.2, 2.6], rel=0.5)


@pytest.mark.parametrize("std", [2.5, 5.0])
def test_noise_is_measured_without_bias(std):
    image = np.round(rng(4).normal(100.0, std, (396, 396, 3))).astype(np.uint8)
    (_, found, _), *_ = noise_curve(image, 1)
    assert found == pytest.approx(np.sqrt(std**2 + 1 / 12), rel=0.006)  # with what rounding adds


@pytest.mark.parametrize(("path", "size", "own"), [("new", 60, True), ("old", 30, True), ("new", 30, False)])
def test_a_picture_is_the_interpolation_of_its_own_mosaic_unless_halved_by_the_new_path(path, size, own):
    sensor = Sensor.sample(rng(3), path)
    light = np.full((60, 60, 3), [0.02, 0.05, 0.5], np.float32)
    light[:, 31:] = [0.5, 0.3, 0.02]
    full, picture = (sensor.expose(light, rng(4), halved=halved) for halved in (False, size == 30))
    assert picture.shape == (size, size, 3)
    assert np.array_equal(demosaicked(mosaicked(picture))[INNER], picture[INNER]) == own
    if not own:  # halved after a median
        expected = cv2.resize(cv2.medianBlur(full, 3), (30, 30), interpolation=cv2.INTER_AREA)
        assert np.array_equal(picture, expected)


@pytest.mark.parametrize("path", ["plain", "new", "old"])
@pytest.mark.parametrize("halved", [False, True])
def test_no_path_moves_the_picture(path, halved):
    rows, columns = np.indices((120, 120))
    spot = np.exp(-((rows - 59.5) ** 2 + (columns - 59.5) ** 2) / (2 * 9.0**2))
    picture = Sensor(path=path).expose(np.repeat(spot[..., None], 3, axis=2), rng(0), NEUTRAL, halved=halved)
    center = (picture.shape[0] - 1) / 2
    for channel in range(3):
        assert center_of_mass(picture[..., channel]) == pytest.approx([center, center], abs=0.05)


def test_settings_of_a_camera_stay_while_noise_changes_and_samples_differ_and_repeat():
    sensor = Sensor.sample(rng(5), "new")
    settings = sensor.settings(rng(6))
    light = np.full((64, 64, 3), 0.2, np.float32)
    first, second = (sensor.expose(light, rng(seed), settings) for seed in (1, 2))
    assert not np.array_equal(first, second)
    assert first.mean(axis=(0, 1)) == pytest.approx(second.mean(axis=(0, 1)), abs=0.5)
    assert np.array_equal(first, sensor.expose(light, rng(1), settings))
    assert Sensor.sample(rng(1)) == Sensor.sample(rng(1))
    assert len({Sensor.sample(rng(seed)) for seed in range(20)}) == 20
    assert {Sensor.sample(rng(seed)).path for seed in range(20)} == {"new", "old"}
    with pytest.raises(ValueError, match="expected one of plain, new, old"):
        Sensor(path="newest")


@pytest.mark.parametrize("path", ["plain", "new"])
def test_clean_sensor_only_rounds_a_flat_field(path):
    for levels in ([51, 128, 204], [0, 1, 255], [2, 17, 254]):
        flat = np.full((20, 30, 3), linear(np.array(levels)), np.float32)
        assert (dataclasses.replace(Sensor.clean(), path=path).expose(flat, rng(0)) == levels).all()


def test_noise_follows_its_formula():
    sensor = Sensor(full_well=10_000, read_noise=2.0)
    for level in (0.2, 0.8):
        image = sensor.expose(np.full((300, 300, 3), level, np.float32), rng(0))
        expected = np.sqrt(2.0**2 + 255 * level * 255 / 10_000 + 1 / 12)
        assert image.std() == pytest.approx(expected, rel=0.02)
        assert image.mean() == pytest.approx(255 * level, abs=0.05)


def test_blur_keeps_light_and_place_and_settings_stay_in_their_ranges():
    spot = np.zeros((21, 21, 3), np.float32)
    spot[10, 8] = 4.0
    image = Sensor(psf_sigma=1.2).expose(spot, rng(0))[:, :, 0].astype(float)
    assert center_of_mass(image) == pytest.approx([10, 8], abs=1e-9)
    assert image.sum() == pytest.approx(4 * 255, rel=0.02)
    # Cameras differ in colour and brightness as allowed.
    sensor = Sensor(exposure=(0.6, 1.4), white_balance=0.2)
    flat = np.full((4, 4, 3), 0.4, np.float32)
    means = np.array([sensor.expose(flat, rng(seed)).mean(axis=(0, 1)) for seed in range(200)]) / (0.4 * 255)
    assert means.min() > 0.6 / 1.2 - 0.01
    assert means.max() < 1.4 * 1.2 + 0.01
    ratio = means[:, 0] / means[:, 2]
    assert ratio.min() < 0.8
    assert ratio.max() > 1.25
