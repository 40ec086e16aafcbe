"""An object that rests off the table is named, and one that rests on it or is lifted is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tracker
from tests.helpers import ROOT
from tracker.geometry import so3
from tracker.objects.model import load_object
from tracker.pose.result import PoseEstimate
from tracker.summaries.remarks import off_table

MODEL = load_object("cube_v2")
ARENA = tracker.Arena(table=0.01)


def resting(height: float, std: float = 2e-4, tilt: float = 0.0, confidence: float = 0.95) -> PoseEstimate:
    """A cube on a face, its centre `height` [m] too high, turned by `tilt` [rad]."""
    rotation = so3.exp([tilt, 0.0, 0.0]) @ so3.exp([0.0, 0.0, 0.7]) @ so3.exp([np.pi / 2, 0.0, 0.0])
    position = np.array([0.05, -0.02, 0.01 + MODEL.size[2] / 2 + height])
    return PoseEstimate(position, so3.quaternion_from_matrix(rotation), np.eye(6) * std**2, confidence)


@pytest.mark.parametrize(
    ("height", "std", "words"),
    [
        (4.2e-3, 2e-4, "cube_v2 floats 4.2 mm above the table (± 0.2 mm)"),
        (-3.1e-3, 1e-3, "cube_v2 sinks 3.1 mm into the table (± 1.0 mm)"),
        (4.2e-3, 2.2e-3, None),
        (-2.8e-3, 1e-4, None),
        (0.0, 1e-4, None),
        (0.03, 1e-3, None),
    ],
)
def test_an_object_off_the_table_by_two_deviations_is_named_with_the_remedy(height, std, words):
    found = off_table(resting(height, std), MODEL, ARENA)
    assert (found is None) == (words is None)
    if words is not None:
        assert found.startswith(words)
        assert "`tracker calibrate table RECORDING -o DIR`" in found


def test_nothing_is_named_unless_it_seems_to_rest():
    high = resting(5e-3)
    assert off_table(high, MODEL, ARENA)
    assert off_table(resting(5e-3, tilt=0.1), MODEL, ARENA) is None
    assert off_table(resting(5e-3, confidence=0.4), MODEL, ARENA) is None
    assert off_table(None, MODEL, ARENA) is None
    assert off_table(high, MODEL, dataclasses.replace(ARENA, table=None)) is None
    assert off_table(high, MODEL, dataclasses.replace(ARENA, table_std=(1e-3, 0.0))) is None


def test_a_table_that_is_not_at_the_height_of_the_world_is_named_by_detect(run_here, tmp_path):
    arena = tmp_path / "calibration"
    rig = tracker.CameraRig.load(ROOT / "tracker" / "demo")
    dataclasses.replace(rig, arena=tracker.Arena(table=-0.004)).save(arena)
    given = ["detect", "--object", "cube_v2", ROOT / "tracker" / "demo"]
    assert run_here(*given).stderr == ""
    (line,) = run_here(*given, "--calibration", arena).stderr.splitlines()
    assert line.startswith("tracker: warning: cube_v2 floats 3.9 mm above the table")
