import itertools

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from tests.helpers import BAYER
from tracker.pose import edge_fit
from tracker.pose.edge_fit import OFFSET
from tracker.pose.edge_model import SCRATCH
from tracker.pose.solution import CAMERA
from tracker.pose.strips import PIXELS, STRIP, collect
from tracker.pose.views import PICTURE
from tracker.segmentation.sensor import NO_MOSAIC

COLORS = INNER, OUTER, BEYOND = np.array([[40.0, 50, 190], [60.0, 150, 70], [90.0, 95, 92]])
SIZE = 60
CENTRE = np.array([30.3, 29.8])
FAR = 1e3
PIECES = 21

# Red above green is label 1, the rest 2: enough of a colour table for two surfaces.
_LEVELS = np.arange(256) // 4
CHANNELS = np.stack([_LEVELS * 0, _LEVELS, _LEVELS * 64]).astype(np.int32)
TABLE = np.where(np.arange(64 * 64) // 64 > np.arange(64 * 64) % 64, 1, 2).astype(np.uint8)

DEGREES = [0, 17, 45, 90, 123, 200, 301]


def direction(degrees):
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


def distances(degrees=17):
    """How far each pixel (SIZE, SIZE) lies from a line through CENTRE, along the line's normal [px]."""
    j, i = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    return (i - CENTRE[0]) * direction(degrees)[0] + (j - CENTRE[1]) * direction(degrees)[1]


def stripes(away, blur=1.0, width=FAR, colors=COLORS):
    """An image of the first colour up to the distance 0, the second for `width` pixels, then the third."""
    step, last = ndtr(away / blur)[..., None], ndtr((away - width) / blur)[..., None]
    return colors[0] * (1 - step) + colors[1] * (step - last) + colors[2] * last


def digitised(image):
    """As bytes; errors of rounding are independent, also along edges that follow the pixels' grid."""
    dither = np.random.default_rng(7).random(image.shape)
    return np.clip(np.floor(image + dither), 0, 255).astype(np.uint8)


def drawn(degrees=17, edge=0.0, blur=1.0, width=FAR):
    """Bytes of an edge at some distance from CENTRE [px]."""
    return digitised(stripes(distances(degrees) - edge, blur, width))


def pieces(degrees=17, predicted=0.0, *, width_in=FAR, width_out=FAR, outside=2, inside=1, length=4.0):
    """Samples (PIECES,) of STRIP, of an edge that is expected at the distance `predicted`."""
    normal = direction(degrees)
    along = 1.3 * (np.arange(PIECES) - 0.5 * (PIECES - 1))
    samples = np.zeros(PIECES, STRIP)
    samples["pixel"] = CENTRE + predicted * normal + along[:, None] * [-normal[1], normal[0]]
    samples["normal"] = normal
    samples["inside"], samples["outside"] = inside, outside
    samples["reach_in"], samples["reach_out"], samples["length"] = width_in, width_out, length
    return samples


def reach_at(blur):
    """Half width of the strips as the refinement chooses it."""
    return max(2.5, 1.2 + 2.0 * blur)


def measure(image, samples, blur=1.0, *, red=NO_MOSAIC, every=1, collected=(1,)):
    """Measurements (PIECES,) of OFFSET in an image of bytes; what is not measured is nan.

    collected: of which pieces, one in so many, the pixels are collected, one after the other.
    """
    out = np.array([(*[np.nan] * 5, True)] * len(samples), OFFSET)
    strips, pixels = samples.copy(), (np.empty(PIXELS), np.empty((3, PIXELS)))
    camera, picture = np.zeros(1, CAMERA)[0], np.zeros(1, PICTURE)[0]
    camera["strips"], camera["parts"] = len(samples), 3 if red >= 0 else 1
    camera["reach"], picture["mosaic"] = reach_at(blur), red
    mask = np.zeros(image.shape[:2], bool)
    for n in collected:
        collect((image, mask), picture, camera, strips, n, pixels)
    edge_fit.measure(strips, camera, CHANNELS, TABLE, blur, every, pixels, np.zeros(1, SCRATCH), out)
    return out


def assert_equal(first, second):
    for name in OFFSET.names:
        np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("blur", [0.5, 0.7, 1.2, 1.8])
def test_offset_converges_to_the_true_edge(degrees, blur):
    for edge in (-0.8, -0.4, 0.0, 0.23, 0.5, 0.8):
        image, predicted = drawn(degrees, edge, blur), 0.0
        for _ in range(4):
            predicted += np.median(measure(image, pieces(degrees, predicted), blur)["offset"])
        assert abs(predicted - edge) < 0.01
    # Offsets stay within the strip.
    for edge in (-3.0, 3.0):
        shown = measure(drawn(degrees, edge), pieces(degrees))
        seen = shown[shown["usable"]]
        assert (np.abs(seen["offset"]) <= reach_at(1.0)).all()
        assert (seen["offset"] * edge > 0).all()


def interpolated(image, red=0):
    """What a camera with a mosaic makes of an image (H, W, 3)."""
    raw = image[..., 1].copy()
    raw[red >> 1 :: 2, red & 1 :: 2] = image[red >> 1 :: 2, red & 1 :: 2, 2]
    raw[1 - (red >> 1) :: 2, 1 - (red & 1) :: 2] = image[1 - (red >> 1) :: 2, 1 - (red & 1) :: 2, 0]
    return cv2.cvtColor(raw, BAYER[red])


@pytest.mark.parametrize("red", range(4))
@pytest.mark.parametrize("degrees", DEGREES)
def test_a_mosaic_that_is_known_does_not_move_the_edge(degrees, red):
    for edge in (-0.4, 0.0, 0.23, 0.5):
        image = interpolated(drawn(degrees, edge, 0.7), red)
        shown = measure(image, pieces(degrees, edge, length=8.0), 0.7, red=red)
        assert shown["usable"].all()
        assert abs(np.median(shown["offset"])) < 0.02


def test_of_a_mosaic_that_is_known_only_what_it_measured_counts_and_the_edge_is_less_spread_and_wide():
    image = interpolated(drawn(blur=0.7))
    naive, aware = (measure(image, pieces(length=8.0), 0.7, red=red) for red in (NO_MOSAIC, 0))
    assert np.std(aware["offset"]) < 0.5 * np.std(naive["offset"])
    assert abs(np.median(aware["wider"])) < 0.5 * np.median(naive["wider"])
    image[0::2, 0::2, :2] = 77
    image[1::2, 1::2, 1:] = 33
    image[0::2, 1::2, ::2] = image[1::2, 0::2, ::2] = 200
    assert_equal(measure(image, pieces(length=8.0), 0.7, red=0), aware)


@pytest.mark.parametrize("red", [NO_MOSAIC, 0])
def test_one_piece_in_so_many_is_measured_and_pixels_collected_later_are_those_collected_at_once(red):
    image = interpolated(drawn())
    whole = measure(image, pieces(), red=red)
    assert_equal(measure(image, pieces(), red=red, collected=(2, 1)), whole)
    for every, collected in ((3, (1,)), (2, (2,))):
        part = measure(image, pieces(), red=red, every=every, collected=collected)
        assert_equal(part[::every], whole[::every])
        assert np.count_nonzero(part["usable"]) == len(part[::every])


@pytest.mark.parametrize("degrees", [0, 17, 45])
@pytest.mark.parametrize("width", [2.0, 2.6, 3.3, 4.2])
def test_narrow_surfaces_do_not_bias_the_edge_and_say_nothing_of_the_blur(degrees, width):
    # Seen from the neighbour outside, the narrow face ends inwards.
    turned = digitised(stripes(-distances(degrees), 1.0, width, (OUTER, INNER, BEYOND)))
    image = drawn(degrees, width=width)
    for one, known, limit in ((image, {"width_out": width}, 0.06), (turned, {"width_in": width}, 0.12)):
        shown = measure(one, pieces(degrees, **known))
        assert shown["usable"].all()
        assert abs(np.median(shown["offset"])) < limit
        assert (shown["sharpness"] == 0).all()
    # Unlike where the neighbour's end is not known of.
    if width < 3:
        assert abs(np.median(measure(image, pieces(degrees))["offset"])) > 0.15


@pytest.mark.parametrize("outside", [0, 2])
@pytest.mark.parametrize("blur", [0.6, 0.8, 1.1, 1.5, 2.0])
def test_wider_says_by_how_much_an_edge_is_wider_than_the_blur_which_does_not_bias_it(blur, outside):
    for deviation in (-0.6, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3):
        shown = measure(drawn(blur=blur), pieces(outside=outside), blur - deviation)
        assert (shown["sharpness"] > 0).all()
        assert abs(np.median(shown["offset"])) < (0.01 if blur < 1.5 else 0.015)
        limit = 0.35 * abs(deviation) if deviation else 0.02 * blur
        assert abs(np.median(shown["wider"]) - deviation) < limit or abs(deviation) > 0.2


@pytest.mark.parametrize(("outside", "tolerance"), [(0, 0.3), (2, 0.2)])
@pytest.mark.parametrize(
    ("inner", "outer"),
    [([40, 50, 190], [60, 150, 70]), ([120, 120, 200], [120, 150, 140]), ([30, 20, 100], [120, 230, 225])],
)
def test_bloom_is_the_offset_that_a_response_feigns(inner, outer, outside, tolerance):
    # To first order, and less exactly where slopes of the surfaces take a part of it.
    def seen(exponent):
        light = (np.array([inner, outer, outer]) / 255) ** exponent
        found = []
        for degrees in range(5, 360, 15):
            mixed = stripes(distances(degrees), 0.8, colors=light)
            image = digitised(255 * mixed ** (1 / exponent))
            shown = measure(image, pieces(degrees, outside=outside), 0.8)
            found.append(np.median([shown["offset"], shown["bloom"]], axis=1))
        return np.mean(found, axis=0)

    shift, bloom = seen(1.0)
    assert abs(bloom) > 0.02
    for exponent in (1.25, 1.5):
        feigned = seen(exponent)[0] - shift
        assert feigned == pytest.approx((exponent - 1) * bloom, rel=tolerance, abs=0.001)


@pytest.mark.parametrize(
    ("sigma", "width", "outside"), [*itertools.product((1.5, 3, 6), (FAR, 3.0), (2,)), (3, FAR, 0)]
)
def test_variance_and_sharpness_are_those_of_repeated_noise(rng, sigma, width, outside):
    away, half, found = distances()[..., None], 0.5 * reach_at(1.0), []
    clean, step = stripes(away[..., 0], width=width), ndtr(away)
    for _ in range(300):
        # Towards the background both surfaces may have a gradient, of a standard deviation of SLOPE.
        inner, outer = rng.normal(0, 0 if outside else edge_fit.SLOPE, (2, 3))
        image = clean + inner * (1 - step) * (away + half) + outer * step * (away - half)
        samples = pieces(width_out=width, outside=outside)
        found.append(measure(digitised(image + rng.normal(0, sigma, clean.shape)), samples))
    shown = np.array(found)
    # Noise above the least is found out from the pixels themselves.
    assert 0.75 < shown["offset"].var(axis=0).mean() / shown["variance"].mean() < 1.25
    if outside and width == FAR:
        assert 0.7 < shown["wider"].var(axis=0).mean() * shown["sharpness"].mean() < 1.3


@pytest.mark.parametrize("outside", [0, 2])
@pytest.mark.parametrize("slope", [-3.0, -1.0, 1.0, 3.0])
def test_a_gradient_on_either_side_does_not_move_the_edge(outside, slope):
    away = distances()[..., None]
    image, step = stripes(away[..., 0]), ndtr(away)
    for gradient in (step * away, (1 - step) * away):
        shown = measure(digitised(image + slope * gradient), pieces(outside=outside))
        assert abs(np.median(shown["offset"])) < 0.02


@pytest.mark.parametrize(("inside", "outside"), [(2, 1), (2, 0), (1, 1), (3, 2), (1, 3)])
def test_other_surfaces_than_expected_those_that_look_alike_and_few_pixels_are_refused(inside, outside):
    # Across the border between two labels, with less contrast than counts.
    inner, outer = np.array([[80.0, 98, 104], [80.0, 103, 99]])
    assert np.linalg.norm(inner - outer) < edge_fit.MIN_CONTRAST
    alike = digitised(stripes(distances(), colors=(inner, outer, outer)))
    other = pieces(inside=inside, outside=outside)
    for image, samples in ((drawn(), other), (alike, pieces()), (drawn(), pieces(length=0.5))):
        shown = measure(image, samples)
        assert not shown["usable"].any()
        assert (shown["sharpness"] == 0).all()


@pytest.mark.parametrize("degrees", DEGREES)
def test_strips_are_read_up_to_the_border_and_refused_beyond(degrees):
    image, samples = drawn(degrees), pieces(degrees)
    half = np.abs(samples["normal"]) * reach_at(1.0) + np.abs(samples["normal"][:, ::-1]) * 2.0
    for axis in range(2):
        for place in (half[:, axis] - 0.01, SIZE - 1.0 - half[:, axis] + 0.01, -50.0, 1e4):
            moved = samples.copy()
            moved["pixel"][:, axis] = place
            assert not measure(image, moved)["usable"].any()
    assert measure(image, samples)["usable"].all()
    # An edge that runs along the left border, as near as the strip allows, is read.
    reach = reach_at(1.0)
    image, samples = drawn(0, reach - CENTRE[0]), pieces(0)
    samples["pixel"][:, 0] = reach
    shown = measure(image, samples)
    assert shown["usable"].all()
    assert abs(np.median(shown["offset"])) < 0.01
