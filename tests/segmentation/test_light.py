import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tracker
from tests.helpers import BAYER, exposed, veiled
from tracker.segmentation.labels import look_up
from tracker.segmentation.light import (
    BRIGHTNESS_RANK,
    CLIPPED,
    MIN_TILT,
    TARGET_GREY,
    apply_gains,
    evened,
    find_light,
    unveiled,
)
from tracker.segmentation.sensor import LOUD, NO_MOSAIC, calmed, find_mosaic, noise_level
from tracker.tasks.rearrange_dice.segment import read_levels, segment_dice

SIZE = 135


def grey_scene(seed, size=270):
    """Mostly grey of different brightness, with saturated patches on a ninth of it; float64."""
    rng = np.random.default_rng(seed)
    image = np.linspace(70, 150, size)[:, None, None] * np.ones((size, size, 3))
    image *= rng.choice([0.8, 1.0, 1.15], (3, 3, 1)).repeat(size // 3, 0).repeat(size // 3, 1)
    for bgr in ((40, 40, 180), (150, 60, 25), (50, 190, 190)):
        row, column = rng.integers(0, size - size // 5, 2)
        image[row : row + size // 5, column : column + size // 5] = bgr
    return image + rng.normal(0, 2, image.shape)


def ramp(slope_x, slope_y):
    """Factor (H, W): exponential of a plane that is 0 in the middle."""
    along = 2.0 * np.arange(SIZE) / SIZE - 1.0
    return np.exp(slope_x * along + slope_y * along[:, None])


def colour_of_blocks(image):
    """Medians (2, 3, 3) of the log of blue and red over green, in thirds of the picture."""
    values = np.log(np.maximum(image.astype(float), 1.0))
    chroma = np.stack([values[..., 0] - values[..., 1], values[..., 2] - values[..., 1]])
    return np.median(chroma.reshape(2, 3, 45, 3, 45), axis=(2, 4))


@pytest.mark.parametrize("level", [12, 16, 60, 120])
def test_a_veil_is_taken_off_and_dark_images_and_those_that_are_bright_everywhere_have_none(level):
    for low, high in ((0, 255), (0, 90), (7, 120), (150, 255), (255, 255)):
        image = exposed(np.linspace(low, high, 90)[:, None, None] * np.ones((90, 90, 3)))
        assert unveiled(image) is image
    image = exposed(grey_scene(4))
    image[100:130, 40:60] = 0
    back = unveiled(veiled(image, level)).astype(float)
    assert np.abs(back - image).max() <= (1 if level > 12 else 5)
    colors = tracker.load_colors("cube_v2")
    for segment in (lambda one: tracker.segment(one, colors), segment_dice):
        labels = segment(image)
        assert np.mean(segment(veiled(image, level))[labels > 0] == labels[labels > 0]) > 0.97


@pytest.mark.parametrize("slopes", [(0.35, 0.0, 0.0, 0.0), (0.0, -0.3, 0.25, 0.1), (-0.2, 0.2, 0.3, -0.2)])
def test_a_slope_of_the_lights_colour_is_found_and_taken_out(slopes):
    values = grey_scene(1, SIZE)
    middle = find_light(exposed(values)).gains
    values[..., 0] *= ramp(slopes[0], slopes[1])
    values[..., 2] *= ramp(slopes[2], slopes[3])
    image = exposed(values)
    light = find_light(image)
    assert light.tilt == pytest.approx(np.reshape(slopes, (2, 2)), abs=0.02)
    assert light.gains == pytest.approx(middle, rel=0.03)
    assert np.abs(colour_of_blocks(evened(image, light))).max() < 0.03
    assert np.abs(colour_of_blocks(image)).max() > 0.1


def test_even_light_leaves_the_image_as_it_is_and_a_slight_slope_counts_as_even():
    slight = grey_scene(2, SIZE)
    slight[..., 0] *= ramp(0.6 * MIN_TILT, 0.0)
    for values in (slight, *(grey_scene(seed, SIZE) * np.array([0.8, 1.0, 1.3]) for seed in range(10))):
        image = exposed(values)
        light = find_light(image)
        assert not light.tilt.any()
        assert evened(image, light) is image
    # Clipped values stay clipped, and others below.
    values = grey_scene(4, SIZE)
    values[..., 0] *= ramp(0.4, 0.0)
    values[20:30, 20:30] = 255
    image = exposed(values)
    even = evened(image, find_light(image))
    assert (even[20:30, 20:30] == 255).all()
    assert (even[..., 0][image[..., 0] < CLIPPED] < CLIPPED).all()


@pytest.mark.parametrize("gains", [(1.0, 1.0, 1.0), (1.6, 0.9, 0.7), (0.6, 1.2, 1.5)])
def test_clipped_greys_are_background_under_any_gains_and_a_face_with_a_clipped_channel_is_not(gains):
    def labels_of(image, name, gains):
        colors, labels = tracker.load_colors(name), np.empty(image.shape[:2], np.uint8)
        look_up(image, colors.channel_tables(gains), colors.label_table, gains, labels)
        return labels

    # A bright grey as this camera shows it, of which some channels have reached their limit.
    image = np.array([[np.minimum(255, level / np.array(gains)) for level in range(200, 420, 10)]] * 4)
    clipped = (image >= CLIPPED).any(axis=2)
    assert clipped.any()
    assert (labels_of(exposed(image), "cube_v2", np.array(gains))[clipped] == 0).all()
    faces = np.array([[[108, 235, 255], [112, 245, 255], [0, 52, 255]]], dtype=np.uint8)
    assert labels_of(faces, "simulation", np.ones(3)).tolist() == [[6, 6, 1]]


factors = st.tuples(*[st.floats(0.75, 1.3)] * 3)


@settings(max_examples=25)
@given(gains=factors, size=st.sampled_from([60, 135, 270, 540]))
def test_gains_of_the_light_are_inverted_whatever_the_resolution_and_the_scenes_grey_becomes_grey(
    gains, size
):
    reference, found = find_light(exposed(grey_scene(1))), find_light(exposed(grey_scene(1, size), gains))
    assert found.share > 0.5
    np.testing.assert_allclose(found.gains * gains / reference.gains, 1, atol=0.02 if size == 270 else 0.035)
    scene = grey_scene(2)
    image = exposed(scene, gains)
    greys = apply_gains(image, find_light(image).gains)[np.ptp(scene, axis=2) < 20]
    np.testing.assert_allclose(greys.mean(axis=0) / greys[:, 1].mean(), 1, atol=0.02)
    np.testing.assert_allclose(np.quantile(greys, BRIGHTNESS_RANK, axis=0), TARGET_GREY, atol=3)
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    np.testing.assert_array_equal(apply_gains(levels, np.array(gains)), exposed(levels.astype(float), gains))


def test_clipped_greys_do_not_pull_the_colour_of_grey_and_without_any_the_image_is_left():
    for color in ((0, 0, 0), (3, 3, 3), (255, 255, 255), (0, 0, 255), (255, 255, 0)):
        light = find_light(np.full((100, 100, 3), color, np.uint8))
        np.testing.assert_array_equal(light.gains, 1)
        assert light.share == 0
    scene = grey_scene(3)
    reference = find_light(exposed(scene)).gains
    scene[:60] = 400  # a wall that is white whatever the gains
    found = find_light(exposed(scene, (1.2, 1.0, 0.9))).gains
    ratio = found * (1.2, 1.0, 0.9) / reference
    np.testing.assert_allclose(ratio / ratio[1], 1, atol=0.02)


ROWS, COLUMNS = np.mgrid[0:270, 0:270]
SMOOTH = np.stack([100 + 40 * np.sin(COLUMNS / 40 + k) * np.cos(ROWS / 50) for k in range(3)], axis=-1)


def noisy(rng, sigma, picture=SMOOTH):
    return exposed(picture + rng.normal(0, sigma, picture.shape))


EDGED = SMOOTH.copy()
EDGED[60:140, 80:160] = (30, 40, 190)
RAMP = 20 + np.repeat(0.7 * COLUMNS[..., None], 3, axis=-1)


@pytest.mark.parametrize(
    ("picture", "sigma"),
    [*[(SMOOTH, sigma) for sigma in (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)], (RAMP, 4.0), (EDGED, 4.0)],
)
def test_noise_of_a_picture_is_found_whatever_it_shows(rng, picture, sigma):
    # Rounding to bytes is noise as well.
    expected = np.hypot(sigma, np.sqrt(1 / 12))
    assert noise_level(noisy(rng, sigma, picture)) == pytest.approx(expected, rel=0.05)


def test_noise_goes_with_contrast_not_with_brightness_and_the_loudest_image_has_a_level(rng):
    image = SMOOTH + rng.normal(0, 4.0, SMOOTH.shape)
    level = noise_level(exposed(image))
    assert noise_level(exposed(image + 30)) == pytest.approx(level, rel=0.02)
    assert noise_level(exposed(0.5 * image)) == pytest.approx(0.5 * level, rel=0.03)
    assert noise_level(255 - exposed(image)) == level
    stripes = np.zeros((270, 270, 3), np.uint8)
    stripes[:, ::2] = 255
    assert noise_level(stripes) > 100
    assert noise_level(rng.integers(0, 256, (270, 270, 3), dtype=np.uint8)) > 50
    # Even images have no noise, nor those that are too small to tell.
    for shape in ((270, 1, 3), (1, 1, 3), (2, 2, 3), (1, 270, 3), (270, 270, 3)):
        assert noise_level(np.full(shape, 93, np.uint8)) == 0.0
    assert noise_level(exposed(SMOOTH)) < 0.5


@pytest.mark.parametrize("sigma", [1.1 * LOUD, 2 * LOUD])
def test_loud_images_become_quieter_and_keep_their_edges_and_quiet_ones_stay(rng, sigma):
    for quiet in (noisy(rng, quiet) for quiet in (0.0, 1.5, 0.9 * LOUD)):
        np.testing.assert_array_equal(calmed(quiet, np.ones(3)), quiet)
    picture, image = EDGED, noisy(rng, sigma, EDGED)
    dark = exposed(0.3 * image)
    np.testing.assert_array_equal(calmed(dark, np.ones(3)), dark)
    assert (calmed(dark, np.ones(3) / 0.3) != dark).any()
    before = image.copy()
    after = calmed(image, np.ones(3))
    np.testing.assert_array_equal(image, before)
    assert (after.shape, after.dtype) == (image.shape, image.dtype)
    assert np.std(after[150:] - picture[150:]) < 0.5 * sigma
    # The step stays between the same two columns: each is much nearer to its own side's colour.
    left, right = picture[70:130, 78].mean(axis=0), picture[70:130, 81].mean(axis=0)
    for column, own in ((79, left), (80, right)):
        seen = after[70:130, column].mean(axis=0)
        assert (np.abs(seen - own) < 0.25 * np.abs(left - right)).all()


BLOBS = cv2.GaussianBlur(np.random.default_rng(3).random((90, 120)), (0, 0), 2.0)
RAW = (2000 * (BLOBS - BLOBS.min())).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("red", range(4))
def test_every_pattern_is_distinguished_from_its_interpolation_and_changes_where_rows_are_cut_off(red):
    image = cv2.cvtColor(RAW, BAYER[red])
    assert find_mosaic(image) == red
    assert find_mosaic(np.ascontiguousarray(image[1:])) == red ^ 2
    assert find_mosaic(np.ascontiguousarray(image[:, 1:])) == red ^ 1


@pytest.mark.parametrize("red", range(4))
@pytest.mark.parametrize("shape", [(90, 120), (89, 119)])
def test_a_mosaic_is_the_same_without_its_veil(red, shape):
    raw = RAW[: shape[0], : shape[1]].copy()
    raw[:9, :9] = 0
    image = unveiled(cv2.cvtColor(exposed(90.0 + raw * (1 - 90 / 255)), BAYER[red]))
    assert find_mosaic(image) == red
    assert np.abs(image - cv2.cvtColor(raw, BAYER[red]).astype(float)).max() <= 2


def test_changed_flat_noisy_and_tiny_images_are_none():
    image, noise = (
        cv2.cvtColor(RAW, BAYER[0]),
        np.random.default_rng(0).integers(0, 256, (90, 90, 3), np.uint8),
    )
    one_value = image.copy()
    one_value[12, 22, 1] ^= 64
    changed = {
        "one value": one_value,
        "halved": cv2.resize(image, (60, 45), interpolation=cv2.INTER_AREA),
        "jpeg": cv2.imdecode(cv2.imencode(".jpg", image)[1], cv2.IMREAD_COLOR),
        "blurred": cv2.medianBlur(image, 3),
        "brighter": cv2.convertScaleAbs(image, alpha=1.3),
        **{f"all of {level}": np.full((90, 90, 3), level, np.uint8) for level in (0, 130)},
        "noise": noise,
        "tiny": np.ascontiguousarray(noise[:4, :4]),
    }
    assert {kind: find_mosaic(one) for kind, one in changed.items()} == dict.fromkeys(changed, NO_MOSAIC)


def test_images_in_any_memory_give_the_same_labels_and_nothing_is_compiled_again():
    image, colors = grey_scene(3).clip(0, 255).astype(np.uint8), tracker.load_colors("cube_v2")
    expected = tracker.segment(image, colors), segment_dice(image)
    known = len(look_up.signatures), len(read_levels.signatures)
    read_only, wider = image.copy(), np.pad(image, ((0, 0), (0, 9), (0, 0)))
    read_only.flags.writeable = False
    for same in (read_only, np.asfortranarray(image), wider[:, :270], image.view(np.recarray)):
        np.testing.assert_array_equal(tracker.segment(same, colors), expected[0])
        np.testing.assert_array_equal(segment_dice(same), expected[1])
    assert (len(look_up.signatures), len(read_levels.signatures)) == known
