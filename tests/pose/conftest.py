import pytest

from tests.helpers.label_maps import drawn
from tests.helpers.pushed_cube import MODEL


@pytest.fixture(scope="session")
def scene():
    """Perfect label maps of a cube, with their cameras, and the truth."""
    return drawn(MODEL, 5)
