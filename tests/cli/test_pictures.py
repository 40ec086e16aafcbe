"""One set of pictures: files in any order, a frame of a folder, and what is said where names disagree."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers import ROOT
from tests.helpers.command import assert_one_line_error

DEMO = ROOT / "tracker" / "demo"
NAMES = ("camera60", "camera180", "camera300")


def files(folder: Path, *names: str) -> list[Path]:
    return [folder / f"{name}.jpg" for name in names]


@pytest.fixture
def detect(run_here, tmp_path):
    """Answers of `tracker detect --json` on the recording that comes with the package."""

    def found(*arguments: object):
        result = run_here("detect", "--object", "cube_v2", "--json", *arguments, folder=tmp_path)
        return result, json.loads(result.stdout) if result.returncode == 0 else None

    return found


@pytest.mark.parametrize(
    "given",
    [
        [DEMO, "--frame", "3"],
        ["--calibration", DEMO, *files(DEMO / "000003", *sorted(NAMES))],
        ["--calibration", DEMO, "a.jpg", "b.jpg", "c.jpg"],
        [*(f"--calibration={DEMO}/{name}.yml" for name in NAMES[::-1]), "c.jpg", "b.jpg", "a.jpg"],
    ],
    ids=[
        "a folder's frame",
        "named after cameras in another order",
        "without names",
        "in the order of calibrations",
    ],
)
def test_pictures_are_those_of_their_cameras_however_they_are_given(given, detect, tmp_path):
    for name, letter in zip(NAMES, "abc", strict=True):
        shutil.copy(DEMO / "000003" / f"{name}.jpg", tmp_path / f"{letter}.jpg")
    _, expected = detect("--calibration", DEMO, *files(DEMO / "000003", *NAMES))
    result, found = detect(*given)
    np.testing.assert_allclose(found["pose"]["position"], expected["pose"]["position"], atol=1e-3)
    assert result.stderr == ""
    assert detect(DEMO)[1]["pose"] != found["pose"]


def test_a_name_that_disagrees_is_told(detect):
    one = DEMO / "000003" / "camera60.jpg"
    result, _ = detect("--calibration", DEMO, one, one, DEMO / "000003" / "camera300.jpg")
    assert result.returncode == 0
    assert result.stderr.splitlines() == [
        f"tracker: {one}: taken for the picture of camera180, not of camera60"
    ]


def test_swapped_pictures_are_told_and_taken_as_they_are(detect, tmp_path, run_here):
    for number in range(4):
        (tmp_path / "log" / f"{number:06d}").mkdir(parents=True)
        for name, other in zip(NAMES, ("camera180", "camera60", "camera300"), strict=True):
            shutil.copy(
                DEMO / f"{number:06d}" / f"{other}.jpg", tmp_path / "log" / f"{number:06d}" / f"{name}.jpg"
            )
    result, found = detect("--calibration", DEMO, tmp_path / "log")
    said = "the images of camera60 and camera180 look swapped"
    assert result.stderr.splitlines() == [f"tracker: warning: {said}"]
    assert found["pose"] is None or found["pose"]["confidence"] < 0.5
    tracked = run_here(
        *("track", tmp_path / "log", "--object", "cube_v2", "--calibration", DEMO, "--quiet"),
        *("-o", tmp_path / "poses.h5"),
        folder=tmp_path,
    )
    assert tracked.stderr.splitlines() == [f"tracker: warning: {tmp_path / 'log'}: {said}"]


def test_a_calibration_of_another_size_is_scaled_where_that_is_asked_for(detect, tmp_path):
    for name in NAMES:
        whole = cv2.imread(str(DEMO / "000003" / f"{name}.jpg"))
        large = cv2.resize(whole, (540, 540), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(tmp_path / f"{name}.png"), large)
    _, small = detect("--calibration", DEMO, *files(DEMO / "000003", *NAMES))
    given = ["--calibration", DEMO, *(f"{name}.png" for name in NAMES)]
    assert_one_line_error(detect(*given)[0], "540×540 px", "calibrated for 270×270", "--resize-calibration")
    _, large = detect("--resize-calibration", *given)
    # A principal point that is off by the quarter pixel is off by 0.4 mm.
    np.testing.assert_allclose(large["pose"]["position"], small["pose"]["position"], atol=2e-4)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (files(DEMO / "000003", *NAMES), ["--calibration"]),
        ([DEMO, "--frame", "20"], ["no frame 20", "from 0 to 19"]),
        (["--calibration", DEMO, "--frame", "1", *files(DEMO / "000003", *NAMES)], ["--frame"]),
    ],
)
def test_what_is_missing_is_said(given, words, detect):
    assert_one_line_error(detect(*given)[0], *words)
