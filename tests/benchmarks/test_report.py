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
from benchmarks.judge.results import Results, ResultsError, read_results, write_results
from benchmarks.report import worst
from benchmarks.score.records import FrameRecord, frame_of
from benchmarks.score.summary import accuracy_rows
from synthetic.camera.rigs import default_cameras
from tests.helpers.made_up_results import OBJECTS, made_up_results
from tests.helpers.needs import lack
from tracker.geometry import so3

pytest.importorskip("matplotlib", reason="bench: no module matplotlib")
pytest.importorskip("jinja2", reason="bench: no module jinja2")

from benchmarks.report.accuracy_plots import running_median
from benchmarks.report.document import markdown, write_report
from benchmarks.report.document import page as page_of
from benchmarks.report.table import cell, specification, tables_of

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
    frames = results.frames[results.frames.workload == "realistic"]
    results.worst = worst.worst_pictures(frames, lambda _: shown, made)
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
    assert {"#method", "#targets", "#accuracy", "#recorded", "#speed", "#worst"} <= set(page.targets)
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
    results.rows = [row for row in results.rows if row["part"] == "accuracy" and row["group"] == "clean"]
    page = Page(page_of(results))
    assert "speed" not in page.ids
    assert "visible" in page.ids
    assert Page(page_of(Results())).open == []
    assert markdown(Results()).startswith("# Results\n")


def test_a_run_that_finds_nothing_makes_a_page():
    results = made_up_results(3)
    results.frames = results.frames.assign(
        found=False, position_mm=np.nan, rotation_deg=np.nan, nees=np.nan, confidence=np.nan
    )
    results.rows = accuracy_rows(results.frames)
    assert Page(page_of(results)).open == []


def test_page_and_markdown_hold_the_same_tables(folder, text):
    results, page = read_results(folder), text
    document = markdown(results)
    # Every row of a table has as many cells as its head.
    tables = [block for block in document.split("\n\n") if block.startswith("|")]
    for block in tables:
        assert len({line.replace("\\|", "").count("|") for line in block.splitlines()}) == 1
    assert len(tables) == page.count("<table") > 10
    row = next(row for row in results.rows if row["part"] == "accuracy" and row["group"] == "clean")
    for shown in (f"{row['median_mm']:.3f} mm", "## Speed", "✗ missed"):
        assert shown in document
        assert shown.removeprefix("## ") in page
    assert "nan" not in document
    # Pictures are letters, too.
    words = re.sub(r"<svg.*?</svg>|<style.*?</style>|base64,[\w+/=]+", "", page, flags=re.DOTALL)
    assert "nan" not in words


def test_every_table_that_is_specified_is_of_a_part_and_has_cells_for_its_heads():
    spec = specification()
    keys = [section["key"] for section in spec["section"]]
    assert len(set(keys)) == len(keys)
    row = {"part": "x", "group": "g", "bin": "b", "object": "o", "n": 4}
    for section in spec["section"]:
        for table in section["table"]:
            figures = re.findall(r"\{(\w+)", " ".join(text for _, text in table.get("columns", ())))
            made = {**row, "part": table["part"], "group": table.get("groups", ["g"])[0], "any": 1.0}
            made |= {figure: 1.0 for figure in figures if figure != "n"}
            (found,) = tables_of(table, Results(rows=[made]))
            assert all(len(cells) == len(found.heads) for cells in found.rows)


def test_a_cell_shows_what_was_measured_and_its_interval():
    row = {"a": 97.0, "n": 400, "b": float("nan"), "name": "x"}
    assert cell("{a:.1f} % ({a:±})", row) == "97.0 % (94.8-98.3)"
    assert cell("{b:.2f} mm", row) == cell("{c} px", row) == "–"
    assert cell("{a:.0f} of {b}", row) == "97 of –"
    assert cell("{name}", row) == "x"


@pytest.mark.slow
def test_a_page_without_pictures_of_single_scenes_for_those_that_may_not_be_looked_at(folder, text):
    assert "The worst frames" in text
    results = read_results(folder)
    results.worst = []
    assert "The worst frames" not in page_of(results, folder)


def test_a_folder_without_results_is_an_error(tmp_path):
    with pytest.raises(ResultsError, match=r"results\.json"):
        write_report(tmp_path)


def test_the_running_median_of_a_line_is_the_line():
    at = np.linspace(0, 1, 41)
    centers, medians = running_median(at[::-1], 2 * at[::-1])
    np.testing.assert_allclose(medians, 2 * centers)


def record(index: int, **more: object) -> FrameRecord:
    return FrameRecord("realistic", OBJECTS[0], index, 3, 0.8, **{"present": True, "status": "", **more})


def test_false_finds_are_worse_than_wrong_poses_than_misses_than_right_poses():
    right = record(0, found=True, position_mm=4.9, rotation_deg=1.0, confidence=0.2)
    missed = record(1, found=False)
    wrong = record(2, found=True, position_mm=1.0, rotation_deg=5.1, confidence=0.9)
    more_wrong = record(3, found=True, position_mm=90.0, rotation_deg=5.1, confidence=0.9)
    false_find = record(4, present=False, found=True, confidence=0.1)
    good = record(5, present=False, found=False)
    frames = frame_of([right, missed, wrong, good, false_find, more_wrong])
    assert worst.worst_records(frames, 5)["index"].tolist() == [4, 3, 2, 1, 0]


def test_every_object_has_its_worst_frames(folder):
    pictures = sorted((folder / "worst").iterdir())
    assert len(pictures) == 2 * worst.EACH
    assert all(cv2.imread(str(path)).shape == (worst.PANEL, 912, 3) for path in pictures)


def test_pictures_of_an_earlier_run_go(shown, tmp_path):
    (tmp_path / "worst").mkdir()
    (tmp_path / "worst" / "09.jpg").write_bytes(b"old")
    rows = worst.worst_pictures(frame_of([record(7, found=False)]), lambda _: shown, tmp_path)
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
