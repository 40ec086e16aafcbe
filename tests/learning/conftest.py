"""A short film that the tests of this folder share."""

from __future__ import annotations

import pytest

from synthetic.raycast.renderer import Rendering
from tests.helpers.filmed import shots


@pytest.fixture(scope="package")
def film() -> list[Rendering]:
    return shots("cube_v2", 8, seed=511)
