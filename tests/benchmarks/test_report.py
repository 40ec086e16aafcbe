from __future__ import annotations

import html.parser
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

import tracker
from benchmarks.report import worst
from benchmarks.score.records import FrameRecord, ResultsError, records_of, write_results
from synthetic.camera.rigs import default_cameras
from tests.helpers.made_up_results import OBJECTS, made_up_results
from tests.helpers.needs import lack
from tracker.geometry import so3

pytest.importorskip("matplotlib", reason="bench: no module matplotlib")
pytest.importorskip("jinja2", reason="bench: no module jinja2")

from benchmarks.report import report, write_report
from benchmarks.report.accuracy_plots import running_median
from benchmarks.report.trust_plots import wilson

VOID = {"meta", "link", "img", "br", "hr", "input"}
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


class Page(html.parser.HTMLParser):
    """What is in a page, and whether every element that opens is closed in turn."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.loads: list[str] = []
        self.targets: list[str] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        self.handle_startendtag(tag, attrs)

    def handle_startendtag(self, tag, attrs):
        for key, value in attrs:
            if key == "id":
                self.ids.append(value)
            elif key in ("src", "srcset", "data", "poster", "action") or (key == "href" and tag == "link"):
                self.loads.append(value)
            elif key in ("href", "xlink:href"):
                self.targets.append(value)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def shown() -> worst.Shown:
    rng = np.random.default_rng(4)
    model = tracker.load_object("cube_v2")
    truth = np.array([0.02, -0.03, 0.0325]), so3.exp([0.0, 0.0, 0.4])
    estimate = truth[0] + [0.004, 0.0, 0.002], so3.exp([0.05, 0.0, 0.0]) @ truth[1]
    images = [rng.integers(60, 90, (270, 270, 3), dtype=np.uint8), None, np.zeros((270, 270, 3), np.uint8)]
    return worst.Shown(images, tracker.CameraRig(default_cameras()), model, estimate, truth)


@pytest.fixture(scope="module")
def folder(shown, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a run leaves it, with its report."""
    made = tmp_path_factory.mktemp("run")
    results = made_up_results()
    records = [r for r in records_of(results) if r.workload == "realistic"]
    results["worst"] = worst.worst_pictures(records, lambda _: shown, made)
    write_results(made / "results.json", results)
    assert write_report(made) == made / "report.html"
    return made


@pytest.fixture(scope="module")
def text(folder) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text) -> Page:
    return Page(text)


def test_every_element_is_closed_and_every_id_unique(page):
    assert page.open == []
    assert sorted(set(page.ids)) == sorted(page.ids)


def test_the_page_loads_nothing(text, page):
    assert page.loads
    assert all(load.startswith("data:") for load in page.loads)
    assert re.findall(r"@import|url\((?!#)", text) == []
    assert "<script" not in text


def test_every_link_leads_to_a_place_on_the_page(page):
    assert {"#method", "#targets", "#accuracy", "#trust", "#speed", "#worst"} <= set(page.targets)
    for target in page.targets:
        assert target[0] == "#", target
        assert target[1:] in page.ids, target


def test_the_same_results_give_the_same_page(folder, text):
    write_report(folder)
    assert (folder / "report.html").read_text(encoding="utf-8") == text


def test_the_page_states_commit_and_processor_as_they_are_spelt(page):
    words = " ".join(page.text)
    assert "Commit 0123abc" in words
    assert "A <fast> one & only" in words


def test_met_missed_and_unmeasured_targets_are_told_apart_in_words(text, page):
    for state, verdict in (("met", "✓ met"), ("missed", "✗ missed"), ("unknown", "not measured")):
        assert f'<tr class="{state}">' in text
        assert verdict in page.text


def test_a_run_without_some_part_makes_a_page_without_it():
    results = made_up_results(4)
    for key in ("speed", "targets", "summary"):
        del results[key]
    page = Page(report(results))
    assert "speed" not in page.ids
    assert "targets" not in page.ids
    assert "visible" in page.ids
    assert Page(report({"frames": []})).open == []


def test_a_run_that_finds_nothing_makes_a_page():
    results = made_up_results(3)
    results["frames"] = [
        {**frame, "found": False, "position_mm": np.nan, "rotation_deg": np.nan, "nees": np.nan}
        for frame in results["frames"]
    ]
    assert Page(report(results)).open == []


def test_a_folder_without_results_is_an_error(tmp_path):
    with pytest.raises(ResultsError, match=r"results\.json"):
        write_report(tmp_path)


def test_the_running_median_of_a_line_is_the_line():
    at = np.linspace(0, 1, 41)
    centers, medians = running_median(at[::-1], 2 * at[::-1])
    np.testing.assert_allclose(medians, 2 * centers)


def test_the_interval_of_a_share_holds_it_and_shrinks_with_the_count():
    for hits, count in ((0, 10), (5, 10), (10, 10), (500, 1000)):
        low, high = wilson(hits, count)
        assert 0 <= low <= hits / count <= high <= 1
    assert np.ptp(wilson(500, 1000)) < np.ptp(wilson(5, 10))
    assert wilson(0, 0) == (0, 1)


def record(index: int, **more: object) -> FrameRecord:
    return FrameRecord("realistic", OBJECTS[0], index, 3, 0.8, **{"present": True, "status": "", **more})


def test_false_finds_are_worse_than_wrong_poses_than_misses_than_right_poses():
    right = record(0, found=True, position_mm=4.9, rotation_deg=1.0, confidence=0.2)
    missed = record(1, found=False)
    wrong = record(2, found=True, position_mm=1.0, rotation_deg=5.1, confidence=0.9)
    more_wrong = record(3, found=True, position_mm=90.0, rotation_deg=5.1, confidence=0.9)
    false_find = record(4, present=False, found=True, confidence=0.1)
    good = record(5, present=False, found=False)
    ranked = worst.worst_records([right, missed, wrong, good, false_find, more_wrong], 5)
    assert [r.index for r in ranked] == [4, 3, 2, 1, 0]


def test_every_object_has_its_worst_frames(folder):
    pictures = sorted((folder / "worst").iterdir())
    assert len(pictures) == 2 * worst.EACH
    assert all(cv2.imread(str(path)).shape == (worst.PANEL, 912, 3) for path in pictures)


def test_pictures_of_an_earlier_run_go(shown, tmp_path):
    (tmp_path / "worst").mkdir()
    (tmp_path / "worst" / "09.jpg").write_bytes(b"old")
    rows = worst.worst_pictures([record(7, found=False)], lambda _: shown, tmp_path)
    assert [path.name for path in (tmp_path / "worst").iterdir()] == ["01.jpg"]
    assert rows == [{"file": "worst/01.jpg", "workload": "realistic", "object": OBJECTS[0], "index": 7}]


def test_outlines_lie_where_the_camera_sees_the_edges(shown):
    """White on black, the true outline is the one that OpenCV projects."""
    camera = shown.rig[2]
    black = [None, None, np.zeros((270, 270, 3), np.uint8)]
    bare = worst.Shown(black, shown.rig, shown.model, None, shown.truth)
    panel = worst.worst_picture(bare)[:, -worst.PANEL :]
    rows, columns = np.nonzero(panel[40:].min(axis=2) > 128)
    extent = np.array([columns.min(), columns.max(), rows.min() + 40, rows.max() + 40])

    position, rotation = shown.truth
    corners = tracker_corners(shown.model) @ rotation.T + position
    turn, _ = cv2.Rodrigues(camera.camera_from_world[:3, :3])
    projected, _ = cv2.projectPoints(
        corners, turn, camera.camera_from_world[:3, 3], camera.matrix, camera.distortion
    )
    low, high = projected[:, 0].min(axis=0), projected[:, 0].max(axis=0)
    side = max(worst.MIN_CROP, worst.MARGIN * (high - low).max())
    ends = (np.stack([low, high]) - (low + high) / 2) * worst.PANEL / side + worst.PANEL / 2 - 0.5
    np.testing.assert_allclose(extent, [*ends[:, 0], *ends[:, 1]], atol=2.0)


def tracker_corners(model: tracker.CuboidModel) -> np.ndarray:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * np.asarray(model.size) / 2


class Seen(NamedTuple):
    """What a browser made of a page."""

    console: list[str]
    picture: np.ndarray


def browse(path: Path, folder: Path, *options: str) -> Seen:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        lack("browser", f"found none of {', '.join(BROWSERS)}")
    shot = folder / "shot.png"
    arguments = [
        *("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr"),
        *(f"--user-data-dir={folder / 'profile'}", f"--screenshot={shot}", "--window-size=1200,2400"),
    ]
    done = subprocess.run(
        [browser, *arguments, *options, path.as_uri()],
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        env={**os.environ, "HOME": str(folder)},
        check=False,
        timeout=120,
    )
    assert shot.is_file(), done.stderr
    console = [line for line in done.stderr.splitlines() if ":CONSOLE" in line]
    return Seen(console, cv2.imread(str(shot)))


@pytest.mark.parametrize("scheme", [1, 0], ids=["light", "dark"])
def test_a_browser_shows_the_page_without_complaint(folder, tmp_path, scheme):
    seen = browse(folder / "report.html", tmp_path, f"--blink-settings=preferredColorScheme={scheme}")
    assert seen.console == []
    assert (np.median(seen.picture) > 128) == bool(scheme)
    # Every part of the page's upper half holds something.
    assert all(part.std() > 5 for part in np.array_split(seen.picture, 6))


def test_the_browser_test_would_see_a_complaint(tmp_path):
    path = tmp_path / "broken.html"
    path.write_text("<!DOCTYPE html><title>x</title><script>nothing()</script>", encoding="utf-8")
    seen = browse(path, tmp_path)
    assert len(seen.console) == 1
    assert seen.picture.std() == 0
