"""The dense tables of a colour model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import zoom

import tracker
from tracker.errors import ColorModelError
from tracker.segmentation.color_model import color_model_names, load_colors
from tracker.tasks.rearrange_dice.segment import segment_dice


@pytest.mark.parametrize("name", color_model_names())
def test_dense_tables_are_those_of_scipys_linear_interpolation(name):
    model = load_colors(name)
    dense = np.stack([zoom(nodes, 2, order=1) for nodes in model.log_posterior])
    cells = {"label": np.argmax(dense, axis=0), "margin": dense[1:].max(axis=0) - dense[0]}
    blue_fastest = {key: table.transpose(2, 1, 0).ravel() for key, table in cells.items()}
    np.testing.assert_array_equal(model.label_table, blue_fastest["label"])
    np.testing.assert_allclose(
        model.margin_table / 16, blue_fastest["margin"].clip(0, 255 / 16), atol=1 / 32 + 1e-9
    )


@pytest.mark.parametrize("use", [tracker.segment, segment_dice])
def test_a_name_in_place_of_a_colour_model_is_told(use):
    with pytest.raises(ColorModelError, match=r"str given; a ColorModel is needed: tracker\.load_colors"):
        use(np.zeros((270, 270, 3), np.uint8), "cube_v2")
