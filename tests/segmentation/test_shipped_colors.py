import numpy as np
import pytest

import tracker
from benchmarks.data.recorded import SEGMENTED, labelled_images
from scripts import fit_shipped_colors
from scripts.fit_shipped_colors import SIMULATION_RGB, object_model
from tests.helpers import exposed
from tracker.color_learning.fit import FitOptions
from tracker.color_learning.labelled import intersection_over_union
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation.color_model import CELLS, MORE_LIGHT

OPTIONS = FitOptions()


@pytest.fixture(scope="module")
def labelled(real):
    """All labelled images, by object."""
    return {name: labelled_images(real, name) for name in SEGMENTED}


@pytest.fixture(scope="module")
def histograms(labelled):
    return fit_shipped_colors.face_histograms(labelled, OPTIONS)


@pytest.fixture(scope="module")
def drawn_as_others(labelled):
    return fit_shipped_colors.face_histograms(labelled, OPTIONS.for_others())


def assert_shipped(model, tmp_path):
    """The model, written and read, is the shipped one but for the last bit of an exponential."""
    model.save(tmp_path / "fitted.npz")
    fitted = tracker.load_colors(tmp_path / "fitted.npz").log_posterior
    difference = np.abs(fitted - tracker.load_colors(model.name).log_posterior)
    assert difference.max() <= 1 / 16
    assert np.mean(difference > 0) < 1e-3


@pytest.mark.parametrize("name", SEGMENTED)
def test_the_objects_tables_are_what_the_script_fits(name, histograms, drawn_as_others, tmp_path):
    assert_shipped(object_model(name, histograms[name], drawn_as_others, OPTIONS), tmp_path)


@pytest.mark.parametrize("name", SEGMENTED)
def test_in_shade_faces_alone_change_their_colour_to_what_more_light_shows(name):
    model = tracker.load_colors(name)
    plain, shade = (
        table.reshape(3 * (CELLS,), order="F") for table in (model.label_table, model.shade_table)
    )
    changed = np.nonzero(plain != shade)
    lit = [np.rint(np.array(changed) * np.sqrt(light)).astype(int) for light in MORE_LIGHT]
    shown = [plain[tuple(np.minimum(cells, CELLS - 1))] for cells in lit]
    assert 0 < len(changed[0]) < 0.02 * np.count_nonzero(plain)
    assert plain[changed].min() > 0
    assert shade[changed].min() > 0
    assert np.any(np.array(shown) == shade[changed], axis=0).all()


def test_the_simulations_table_is_what_the_script_fits(tmp_path):
    assert_shipped(fit_shipped_colors.simulation_model(), tmp_path)


def test_the_dices_table_is_what_the_script_fits(real, histograms, tmp_path):
    assert_shipped(fit_shipped_colors.dice_model(real, histograms), tmp_path)


def test_faces_of_pictures_left_out_are_found_in_the_colours_of_the_others(
    labelled, histograms, drawn_as_others
):
    known, unknown = [], []
    for name in SEGMENTED:
        for k, image in enumerate(labelled[name]):
            rest = histograms[name][:k] + histograms[name][k + 1 :]
            found = tracker.segment(image.image, object_model(name, rest, drawn_as_others, OPTIONS))
            for label, overlap in intersection_over_union(found, image.labels).items():
                (known if any(label in own for own in rest) else unknown).append(overlap)
    assert np.mean(known + unknown) >= 0.86
    assert min(known) >= 0.6


def test_the_simulations_colours_keep_their_labels_in_other_light():
    # Greys of different brightness, and a patch of each of the colours.
    image = np.linspace(70, 150, 240)[:, None, None] * np.ones((240, 240, 3))
    truth = np.zeros((240, 240), np.uint8)
    for place, (name, rgb) in enumerate(SIMULATION_RGB.items()):
        patch = slice(100, 130), slice(10 + 38 * place, 40 + 38 * place)
        image[patch] = 0.6 * np.array(rgb[::-1])
        truth[patch] = COLOR_NAMES.index(name)
    rng, colors = np.random.default_rng(3), tracker.load_colors("simulation")
    for _ in range(20):
        found = tracker.segment(exposed(image, rng.uniform(0.6, 1.5, 3)), colors)
        assert np.mean(found[truth > 0] == truth[truth > 0]) > 0.97
        assert np.mean(found[truth == 0] > 0) < 0.01
