import pytest

from benchmarks.score import metrics
from synthetic.camera.shot import QUALITIES
from tests.helpers.synthetic_needs import platforms_stay_open  # noqa: F401


@pytest.fixture(autouse=True)
def _few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals of tests need not be as fine as published ones."""
    monkeypatch.setattr(metrics, "RESAMPLES", 19)


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes are rendered with as little work as can be, for tests of what is made of them."""
    monkeypatch.setitem(QUALITIES, "default", QUALITIES["fast"])
