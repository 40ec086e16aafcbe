from __future__ import annotations

import json

from tests.upkeep.test_health import film  # noqa: F401
from tracker.cli.track import CONTRADICTED, _calibration_rows
from tracker.pose.result import Status


def test_track_writes_the_page_and_says_what_is_not_well(film, rig, tmp_path, run_here):  # noqa: F811
    rig.save(tmp_path / "calibration")
    base = ("track", film, "--object", "cube_v2", "--calibration", tmp_path / "calibration")
    page = tmp_path / "health.html"
    result = run_here(*base, "-o", tmp_path / "poses.h5", "--health", page, "--json")
    assert result.returncode == 0, result.stderr
    assert "camera300: brightness" in " ".join(json.loads(result.stdout)["health"])
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    wrong = run_here(*base, "-o", tmp_path / "poses.h5", "--health", tmp_path / "health.txt")
    assert wrong.returncode == 2
    assert "expected .html" in wrong.stderr


def test_a_calibration_is_named_where_cameras_contradict_each_other_for_long():
    def statuses(share, with_pose):
        return {Status.INCONSISTENT_VIEWS.value: {"share": share, "with_pose": with_pose}}

    (first, *_) = _calibration_rows(statuses(0.5, 1.0))
    assert first[0] == "calibration"
    assert "50.0%" in first[1]
    # Without poses the status says that there is no object.
    assert not _calibration_rows(statuses(1.0, 0.0))
    assert not _calibration_rows(statuses(CONTRADICTED / 2, 1.0))
    assert not _calibration_rows({})
