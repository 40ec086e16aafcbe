"""Fixtures and settings of all tests."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from tests.helpers import ROOT, make_camera, run_python
from tests.helpers.needs import (  # noqa: F401
    lack,
    pytest_configure,
    pytest_make_collect_report,
    pytest_runtest_makereport,
)
from tracker.geometry.camera import Camera

# Derandomised: a run never depends on chance or on earlier runs. Without a deadline, since the first
# call may compile.
settings.register_profile("repository", derandomize=True, deadline=None, database=None, max_examples=50)
settings.load_profile("repository")


@pytest.fixture(scope="session")
def real() -> Path:
    """Folder of recorded data of real platforms; tests that need it are skipped where it is absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "real"
    folder = Path(os.environ.get("TRACKER_REAL_DATA", default))
    if not folder.is_dir():
        lack("real", "no recorded data; set TRACKER_REAL_DATA to its folder")
    return folder


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that `examples/still.py` has filled: an image and a calibration of each camera, overlay.png."""
    working = tmp_path_factory.mktemp("working")
    run_python([ROOT / "examples" / "still.py"], working, check=True)
    return working / "demo"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)


@pytest.fixture
def camera() -> Camera:
    """A camera like the platform's camera60 at 270×270."""
    return make_camera()
