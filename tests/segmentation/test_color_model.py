"""The dense tables of a colour model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import zoom

from tracker.segmentation.color_model import color_model_names, load_colors


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
