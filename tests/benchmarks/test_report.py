import re

import cv2
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import tracker
from benchmarks import program, run
from benchmarks.data.plan import release
from benchmarks.judge.results import ResultsError, origin, write_published
from benchmarks.judge.targets import judge
from benchmarks.report import documents, worst
from benchmarks.report.documents import document
from benchmarks.report.plots import write_plots
from benchmarks.score.tables import BY_NAME, TABLES
from tests.benchmarks.made_up import ABOUT, OBJECTS, answer, film, results
from tests.helpers import RIG, opencv_pixels
from tracker.geometry import so3
from tracker.geometry.cuboid import corners


def test_a_document_shows_what_was_measured_and_nothing_else():
    made = results(8)
    text, again = (document(made.about, made.figures, judge(made)) for _ in range(2))
    assert text == again
    assert "Commit 0123abc, one & only" in text
    assert "why" in text
    shown = {table.title for table in TABLES if f"## {table.title}\n" in text}
    assert shown == {BY_NAME[row["table"]].title for row in made.figures}
    assert len(shown) >= 9
    for block in text.split("\n\n"):
        if block.startswith("|"):
            assert all(line.endswith("|") for line in block.splitlines())
            assert len({line.count(" | ") for line in block.splitlines()}) == 1
    assert "## Accuracy" not in document(made.about, [], [])


@pytest.mark.parametrize("found", [True, False])
def test_plots_are_drawn_of_good_and_of_lost_films(tmp_path, found):
    frames = results(20).frames
    if not found:
        nothing = dict.fromkeys(("mm", "deg", "measured_mm", "measured_deg"), np.nan)
        frames["films"] = film(status=["lost"] * 10, found=False, **nothing)
        frames["accuracy"] = pd.DataFrame([answer(found=False, index=k) for k in range(5)])
    files = write_plots(frames, tmp_path)
    names = {"errors", "visible", "trust", "times", "films"}
    assert {file.name for file in files} == {f"{name}.png" for name in names}
    assert all(np.ptp(cv2.imread(str(file))) > 100 for file in files)


def test_false_finds_are_worse_than_wrong_poses_than_misses_than_right_poses():
    rows = [
        {"mm": 4.9, "confidence": 0.2},
        {"found": False},
        {"mm": 1.0, "deg": 5.1},
        {"mm": 90.0, "deg": 5.1},
        {"present": False, "mm": np.nan, "confidence": 0.1},
        {"present": False, "found": False},
    ]
    frame = pd.DataFrame([answer(**row, index=k) for k, row in enumerate(rows)])
    assert worst.worst_records(frame, 5)["index"].tolist() == [4, 3, 2, 1, 0]


@pytest.fixture
def shown(rng) -> worst.Shown:
    images = [rng.integers(0, 255, (270, 270, 3), dtype=np.uint8), None, np.zeros((270, 270, 3), np.uint8)]
    turn = so3.quaternion_from_matrix(so3.exp([0.1, 0.2, 0.3]))
    truth = tracker.PoseEstimate(np.array([0.02, 0.01, 0.04]), turn, np.eye(6), 1.0)
    return worst.Shown(images, RIG, tracker.load_object("cube_v2"), None, truth)


def test_one_page_holds_the_worst_answers_of_each_object(shown, tmp_path):
    frames = pd.DataFrame([answer(index=k, object=name, mm=k + 0.1) for name in OBJECTS for k in range(9)])
    page = cv2.imread(str(worst.write_worst(frames, lambda _: shown, tmp_path)))
    height = len(OBJECTS) * worst.EACH * (worst.PANEL + worst.CAPTION + worst.GAP)
    assert page.shape == (height, 3 * worst.PANEL + 2 * worst.GAP, 3)


def test_a_caption_says_what_was_answered():
    for values, words in (
        ({}, ["0.10 mm", "confidence 0.980", "visible 0.80"]),
        ({"found": False, "status": "ambiguous"}, ["no pose, ambiguous"]),
        ({"present": False}, ["found", "no object"]),
    ):
        line = worst.caption(pd.Series(answer(**values)))
        assert all(word in line for word in words)


def test_outlines_lie_where_the_camera_sees_the_edges(shown):
    """White on black, the true outline is the one that OpenCV projects."""
    camera = shown.rig[2]
    panel = worst.worst_picture(shown)[:, -worst.PANEL :]
    rows, columns = np.nonzero(panel[40:].min(axis=2) > 128)
    extent = [columns.min(), columns.max(), rows.min() + 40, rows.max() + 40]
    ends = corners(shown.model.size) @ shown.truth.rotation.T + shown.truth.position
    projected = opencv_pixels(camera, ends)
    low, high = projected.min(axis=0), projected.max(axis=0)
    side = max(worst.MIN_CROP, worst.MARGIN * (high - low).max())
    ends = (np.stack([low, high]) - (low + high) / 2) * worst.PANEL / side + worst.PANEL / 2 - 0.5
    np.testing.assert_allclose(extent, [*ends[:, 0], *ends[:, 1]], atol=2.0)


FIGURE = re.compile(r"[\d.]+(?: |\u00a0)?(?:mm|ms|°|%|px|MB|×(?! ?\d))")
"""A number with the unit of a measurement."""

DEFINITIONS = {"README.md": {"5 mm", "5°", "0.09 mm", "1.4 ms", "65 mm"}, "docs/figures.md": {"5 mm", "5°"}}
"""Numbers that say what is meant, and what the demo prints, which its own test holds."""


def test_every_figure_in_the_documents_is_of_the_published_run():
    published = documents.read_published()
    assert documents.block(documents.README) == documents.brief(published)
    assert documents.block(documents.PAGE) == documents.figures(published)
    about, figures, targets = (published[key] for key in ("about", "figures", "targets"))
    assert documents.RESULTS.read_text(encoding="utf-8") == document(about, figures, targets)
    for path in (documents.README, documents.PAGE):
        text = path.read_text(encoding="utf-8").replace(documents.block(path), "")
        name = str(path.relative_to(documents.ROOT))
        assert set(FIGURE.findall(text)) <= DEFINITIONS[name], name


def test_the_published_run_is_of_unseen_scenes_and_enough_of_them():
    about = documents.read_published()["about"]
    assert about["draw"] == "release"
    assert about["seed"] == release(about["commit"])
    assert about["clean"]
    assert about["scenes"] >= 200
    for made in about["parts"].values():
        assert not made.get("skipped")
        assert made["commit"] == about["commit"]
        assert all(made[key] for key in ("processor", "libraries", "renderer"))


def test_figures_of_no_pose_at_all_are_a_dash():
    made = results(4)
    frame = made.frames["accuracy"]
    frame.loc[(frame.group == "world") & (frame.object == OBJECTS[1]), ["mm", "deg"]] = np.nan
    first = documents.brief({"about": made.about, "figures": made.figures}).splitlines()[2]
    assert re.search(r"median error \| [\d.]+ mm, [\d.]+° / – mm, –° \| [\d.]+ mm", first)


@pytest.fixture
def pages(tmp_path, monkeypatch):
    """README.md and the page of figures with empty blocks, in a folder of their own."""
    for key in ("README", "PAGE"):
        path = tmp_path / f"{key.lower()}.md"
        path.write_text(f"before\n{documents.BEGIN}\nold\n{documents.END}\nafter\n", encoding="utf-8")
        monkeypatch.setattr(documents, key, path)
    monkeypatch.setattr(documents, "RESULTS", tmp_path / "results.md")
    monkeypatch.setattr(documents, "PUBLISHED", tmp_path / "published.json")
    return documents.README, documents.PAGE


def publish():
    made = results(8)
    write_published(documents.PUBLISHED, made, judge(made))
    published = documents.read_published()
    documents.write_documents(published)
    return published


def test_only_the_blocks_are_written(pages):
    published = publish()
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert text.startswith("before\n")
        assert text.endswith("\nafter\n")
    assert documents.block(documents.README) == documents.brief(published)
    assert documents.block(documents.PAGE) == documents.figures(published)
    row = next(row for row in published["figures"] if row["group"] == "hard light")
    assert f"{row['median_mm']:.3f} mm" in documents.PAGE.read_text(encoding="utf-8")
    before = documents.README.read_text(encoding="utf-8")
    documents.PAGE.write_text("no marks", encoding="utf-8")
    with pytest.raises(ResultsError, match="no block"):
        publish()
    assert documents.README.read_text(encoding="utf-8") == before


@pytest.mark.usefixtures("pages")
def test_publishing_writes_all_documents_of_release_scenes(tmp_path, monkeypatch):
    tree = {key: ABOUT[key] for key in origin()} | {"commit": "f" * 40}
    parts = {"accuracy": lambda run: results(4).frames}
    for user in (run, program):
        monkeypatch.setattr(user, "origin", lambda: dict(tree))
        monkeypatch.setattr(user, "PARTS", parts)

    def runs(*more):
        arguments = ["all", "--publish", "--scenes", "4", "-o", str(tmp_path / "out"), *more]
        return CliRunner().invoke(program.main, arguments)

    done = runs()
    assert done.exit_code == 0, done.output
    found = documents.read_published()
    assert (found["about"]["draw"], found["about"]["seed"]) == ("release", release(tree["commit"]))
    assert "release scenes" in (tmp_path / "results.md").read_text(encoding="utf-8")
    assert documents.block(documents.README) == documents.brief(found)
    # Single scenes are nobody's business.
    assert not (tmp_path / "out" / "worst.jpg").exists()
    # Nothing is published of a tree with changes or of other scenes.
    documents.PUBLISHED.unlink()
    assert "release scenes are drawn from the commit" in str(runs("--seed", "5").exception)
    tree["clean"] = False
    assert isinstance(runs().exception, ResultsError)
    assert not documents.PUBLISHED.exists()
