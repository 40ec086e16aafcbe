"""The command that finds the table."""

from __future__ import annotations

import re

import numpy as np
import pytest

import tracker
from tests.helpers.command import assert_one_line_error
from tests.helpers.filmed import RIG, write_recording
from tests.helpers.resting_cube import rests
from tracker.calibration.table_plane import moved

CUBE = ("--object", "cube_v2")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = write_recording(tmp_path_factory.mktemp("rests") / "recording", list(rests()))
    high = np.eye(4)
    high[2, 3] = -0.004
    moved(RIG, high).save(folder)
    return folder


def test_the_calibration_found_is_written_and_told_of(recording, tmp_path, run_here):
    target = tmp_path / "mended"
    result = run_here("calibrate", "table", recording, "--stills", *CUBE, "-o", target)
    assert result.returncode == 0, result.stderr
    assert "in 6 places of 6" in result.stdout
    assert re.search(r"height \[mm\] +\+(3\.9|4\.0)", result.stdout)
    rig = tracker.CameraRig.load(target)
    assert rig.names == RIG.names
    assert rig.arena.table == 0.0
    assert rig.arena.table_std != RIG.arena.table_std
    for one, true in zip(rig, RIG, strict=True):
        np.testing.assert_allclose(one.position, true.position, atol=1e-3)


def test_pictures_may_be_named_moment_by_moment(recording, tmp_path, run_here):
    pictures = [file for frame in sorted(recording.glob("0*")) for file in sorted(frame.glob("*.png"))]
    ordered = [
        next(f for f in pictures[k : k + 3] if f.stem == name) for k in range(0, 18, 3) for name in RIG.names
    ]
    target = tmp_path / "mended"
    result = run_here("calibrate", "table", *ordered, *CUBE, "--calibration", recording, "-o", target, "-q")
    assert (result.returncode, result.stdout) == (0, ""), result.stderr
    assert (target / "arena.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{recording}", "-o", "{used}"], ["in use", "new or an empty folder"]),
        (["{recording}", "-o", "new"], ["found 0 of the 5 places"]),
        (["{recording}/000000", "-o", "new"], ["found 1 of the 5 places", "must rest"]),
        (["{recording}/000000/camera60.png", "-o", "new"], ["no calibration", "--calibration"]),
        (["nowhere", "-o", "new"], ["nowhere"]),
        (["{recording}"], ["-o"]),
    ],
)
def test_what_cannot_be_done_is_told_in_a_line(arguments, words, recording, tmp_path, run_here):
    used = tmp_path / "used"
    used.mkdir()
    (used / "camera60.yml").write_text("old")
    given = [part.format(recording=recording, used=used) for part in arguments]
    assert_one_line_error(run_here("calibrate", "table", *given, *CUBE, folder=tmp_path), *words)
    assert (used / "camera60.yml").read_text() == "old"
    assert not (tmp_path / "new").exists()


def test_pictures_without_their_companions_are_refused(recording, tmp_path, run_here):
    picture = recording / "000000" / "camera60.png"
    arguments = (picture, *CUBE, "--calibration", recording, "-o", tmp_path / "new")
    assert_one_line_error(run_here("calibrate", "table", *arguments), "multiple of 3", "camera180")
