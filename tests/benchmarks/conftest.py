from __future__ import annotations

import pytest

from synthetic.camera.shot import QUALITIES


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes are rendered with as little work as can be, for tests of what is made of them."""
    monkeypatch.setitem(QUALITIES, "default", QUALITIES["fast"])
