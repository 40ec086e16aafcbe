"""A short film that the tests of this folder share."""

import pytest

from tests.helpers.filmed import shots
from tests.helpers.stills import Still


@pytest.fixture(scope="package")
def film() -> list[Still]:
    return shots("cube_v2", 8, seed=511)
