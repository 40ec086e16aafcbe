import itertools

import numpy as np
import pytest
from scipy.ndimage import zoom

import tracker
from tests.helpers import exposed
from tracker.color_learning.hues import (
    LIGHT,
    NAMED_HUES,
    better_set,
    bgr_of_hue,
    distance,
    distance_to_light,
    distances,
    hue_distance,
    hue_of,
    hues_of_model,
    misnamed,
    paints,
)
from tracker.color_learning.labelled import LabelledImage, confusion
from tracker.errors import ColorModelError
from tracker.segmentation.color_model import color_model_names, load_colors
from tracker.tasks.rearrange_dice.segment import segment_dice

CUBOIDS = ("cube_v1", "cube_v2", "cube_v3", "cuboid_2x2x8_v2", "simulation")


def test_pure_colors_have_their_hues_of_any_brightness_and_grey_has_none():
    for k, bgr in enumerate([(0, 0, 9), (0, 9, 9), (0, 9, 0), (9, 9, 0), (9, 0, 0), (9, 0, 9)]):
        assert hue_distance(hue_of(np.array([bgr, bgr])), 60 * k) == pytest.approx(0, abs=1e-9)
    pixels = np.random.default_rng(1).uniform(20, 120, (50, 3)) * [0.3, 1.0, 0.5]
    assert hue_of(pixels) == pytest.approx(hue_of(2 * pixels))
    assert np.isnan(hue_of(np.full((4, 3), 80)))
    cyan, brown = np.array([0.9, 1.0, 0.6]), np.array([0.4, 0.7, 1.0])
    mixed = [*np.full((30, 1), 80) * cyan, *np.full((40, 1), 200) * cyan, *np.full((20, 1), 120) * brown]
    assert hue_of(mixed) == pytest.approx(hue_of([cyan]))
    assert misnamed({3: float("nan")}) == {3: 0}


def test_names_hues_and_those_of_shipped_models_are_in_order():
    named = {label: NAMED_HUES[label] for label in range(1, 7)}
    for hues in (named, *(hues_of_model(tracker.load_colors(name)) for name in CUBOIDS)):
        assert misnamed(hues) == {}


@pytest.mark.parametrize("name", CUBOIDS)
def test_every_exchange_of_two_or_three_faces_is_noticed(name):
    hues = hues_of_model(tracker.load_colors(name))
    for a, b in itertools.combinations(hues, 2):
        assert set(misnamed(hues | {a: hues[b], b: hues[a]})) >= {a, b}
    for a, b, c in itertools.permutations(hues, 3):
        assert set(misnamed(hues | {a: hues[b], b: hues[c], c: hues[a]})) >= {a, b, c}


def test_a_hue_that_no_name_has_is_never_said_to_be_that_of_its_own():
    for hue in range(360):
        for label in range(1, 7):
            wrong = misnamed({label: float(hue)})
            assert (label in wrong) == (hue_distance(hue, NAMED_HUES[label]) > 45.0)
            assert wrong.get(label) != label


@pytest.mark.parametrize("name", color_model_names())
def test_dense_tables_are_those_of_scipys_linear_interpolation(name):
    model = load_colors(name)
    assert model.normalise
    blue_fastest = [zoom(nodes, 2, order=1).transpose(2, 1, 0).ravel() for nodes in model.log_posterior]
    np.testing.assert_array_equal(model.label_table, np.argmax(blue_fastest, axis=0))
    margin = np.max(blue_fastest[1:], axis=0) - blue_fastest[0]
    np.testing.assert_allclose(model.margin_table / 16, margin.clip(0, 255 / 16), atol=1 / 32 + 1e-9)


@pytest.mark.parametrize("use", [tracker.segment, segment_dice])
def test_a_name_in_place_of_a_colour_model_is_reported(use):
    with pytest.raises(ColorModelError, match=r"^colors: found .*, expected ColorModel, as tracker"):
        use(np.zeros((270, 270, 3), np.uint8), "cube_v2")


RED, GREEN, BLUE = (np.array(levels, dtype=float) for levels in ([20, 30, 160], [40, 150, 50], [150, 60, 20]))


def test_distance_is_symmetric_small_for_shade_and_smaller_for_paler_colors():
    assert distance(RED, GREEN) == pytest.approx(distance(GREEN, RED))
    assert distance(RED, RED) == 0
    assert distance(RED, 0.7 * RED) < 1.5 < distance(RED, GREEN)
    grey = np.full(3, 80.0)
    pale = [0.5 * color + 0.5 * grey for color in (RED, GREEN)]
    assert distance_to_light(pale[0]) < distance_to_light(RED)
    assert distance(*pale) < distance(RED, GREEN)
    assert distance_to_light(grey) == pytest.approx(0, abs=0.2)


def test_a_better_set_is_no_worse_and_keeps_the_names():
    means = {1: RED, 2: GREEN, 3: np.array([60.0, 50.0, 40.0]), 4: np.array([70.0, 65.0, 40.0])}
    better = better_set(means)
    assert min(distances(better).values()) > min(distances(means).values())
    for label, color in better.items():
        if (color != means[label]).any():
            assert hue_distance(hue_of(color[None]), NAMED_HUES[label]) < 25


def test_a_colour_moves_to_the_paint_that_is_farthest_from_the_others():
    """Of one colour beside the light: to the farthest of all that its name allows."""
    for label in range(1, 7):
        grid = np.meshgrid(NAMED_HUES[label] + np.arange(-20.0, 21.0, 10.0), (0.6, 0.9), (70.0, 110.0, 210.0))
        farthest = distance_to_light(bgr_of_hue(*(axis.ravel() for axis in grid))).max()
        better = better_set({label: np.array([60.0, 65.0, 62.0])})
        assert distance_to_light(better[label]) >= farthest


def test_paints_are_those_of_neutral_light():
    rng = np.random.default_rng(4)
    labels = np.zeros((120, 120), np.uint8)
    labels[10:40, 10:40], labels[60:90, 10:40] = 1, 3
    scene = np.full((120, 120, 3), 110.0)
    scene[labels == 1], scene[labels == 3] = RED, BLUE
    scene[100:110] = 0  # without black, the faces' darkest channel would be taken for a veil
    scene += rng.normal(0, 1.5, scene.shape)
    tinted = np.clip(scene * [0.8, 1.0, 1.2], 0, 249)
    shown = [paints([LabelledImage("one", exposed(one), labels)]) for one in (scene, tinted)]
    means, others = (
        {label: np.median(some, axis=0) for label, some in pixels.items()} for pixels, _ in shown
    )
    for label in (1, 3):
        assert np.allclose(means[label], others[label], atol=6)
    assert np.allclose(shown[1][1], [0.8 / 1.2, 1 / 1.2, 1], atol=0.03)
    # The light of most images, however bright each is.
    several = [LabelledImage("one", exposed(one), labels) for one in (0.4 * scene, scene, tinted)]
    assert np.allclose(paints(several)[1], 1, atol=0.03)
    assert (LIGHT, 3) in distances(means)


def test_confusion_counts_every_labelled_pixel_once_and_leaves_the_rim_out():
    truth = np.zeros((100, 100), np.uint8)
    truth[20:40, 20:40], truth[60:80, 60:80] = 2, 5
    found = truth.copy()
    found[20:30, 20:40] = 6
    found[41, 20:40] = 2  # beside the mask: not known
    found[0, :10] = 1
    counts = confusion([(found, truth), (truth, truth)])
    assert counts[2, 6] == 200
    assert counts[2].sum() == counts[5].sum() == 800
    assert counts[0, 1] == 10
    assert counts[0, 2] == 0
