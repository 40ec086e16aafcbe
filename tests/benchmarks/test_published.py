"""What is published: every figure in the documents is of the committed run; one command writes them all."""

from __future__ import annotations

import re

import pytest
from click.testing import CliRunner

from benchmarks import program, run
from benchmarks.data.seeds import release
from benchmarks.judge.origin import origin
from benchmarks.judge.results import ResultsError, write_published
from benchmarks.judge.targets import judge
from benchmarks.report import readme
from benchmarks.report.markdown import document
from tests.benchmarks.made_up import ABOUT, results

FIGURE = re.compile(r"[\d.]+(?: |\u00a0)?(?:mm|ms|°|%|px|MB|×(?! ?\d))")
"""A number with the unit of a measurement."""

DEFINITIONS = {
    "README.md": {"5 mm", "5°", "0.09 mm", "1.4 ms", "65 mm"},
    "docs/figures.md": {"5 mm", "5°"},
}
"""Numbers that say what is meant, and what the demo prints, which its own test holds."""


def test_every_figure_in_the_documents_is_of_the_published_run():
    published = readme.read_published()
    assert readme.block(readme.README) == readme.brief(published)
    assert readme.block(readme.PAGE) == readme.figures(published)
    about, figures, targets = (published[key] for key in ("about", "figures", "targets"))
    assert readme.RESULTS.read_text(encoding="utf-8") == document(about, figures, targets)
    for path in (readme.README, readme.PAGE):
        text = path.read_text(encoding="utf-8").replace(readme.block(path), "")
        name = str(path.relative_to(readme.ROOT))
        assert set(FIGURE.findall(text)) <= DEFINITIONS[name], name


def test_the_published_run_is_of_unseen_scenes_and_enough_of_them():
    about = readme.read_published()["about"]
    assert about["draw"] == "release"
    assert about["seed"] == release(about["commit"])
    assert about["clean"]
    assert about["scenes"] >= 200
    assert not about.get("skipped")
    for made in about["parts"].values():
        assert made["commit"] == about["commit"]
        assert made["processor"]
        assert made["libraries"]
        assert made["renderer"]


@pytest.fixture
def pages(tmp_path, monkeypatch):
    """README.md and the page of figures with empty blocks, in a folder of their own."""
    for key in ("README", "PAGE"):
        path = tmp_path / f"{key.lower()}.md"
        path.write_text(f"before\n{readme.BEGIN}\nold\n{readme.END}\nafter\n", encoding="utf-8")
        monkeypatch.setattr(readme, key, path)
    monkeypatch.setattr(readme, "RESULTS", tmp_path / "results.md")
    monkeypatch.setattr(readme, "PUBLISHED", tmp_path / "published.json")
    return readme.README, readme.PAGE


def publish():
    made = results(8)
    write_published(readme.PUBLISHED, made, judge(made))
    published = readme.read_published()
    readme.write_documents(published)
    return published


def test_only_the_blocks_are_written(pages):
    published = publish()
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert text.startswith("before\n")
        assert text.endswith("\nafter\n")
    assert readme.block(readme.README) == readme.brief(published)
    assert readme.block(readme.PAGE) == readme.figures(published)
    row = next(row for row in published["figures"] if row["group"] == "hard light")
    assert f"{row['median_mm']:.3f} mm" in readme.PAGE.read_text(encoding="utf-8")
    before = readme.README.read_text(encoding="utf-8")
    readme.PAGE.write_text("no marks", encoding="utf-8")
    with pytest.raises(ResultsError, match="no block"):
        publish()
    assert readme.README.read_text(encoding="utf-8") == before


@pytest.fixture
def published(tmp_path, monkeypatch, pages):
    """Runs `all --publish` on made-up parts, into a folder of its own."""
    tree = {key: ABOUT[key] for key in origin()} | {"commit": "f" * 40}
    monkeypatch.setattr(run, "origin", lambda: dict(tree))
    monkeypatch.setattr(program, "origin", lambda: dict(tree))
    parts = {"accuracy": lambda run: results(4).frames}
    monkeypatch.setattr(run, "PARTS", parts)
    monkeypatch.setattr(program, "PARTS", parts)

    def runs(*more):
        arguments = ["all", "--publish", "--scenes", "4", "-o", str(tmp_path / "out"), *more]
        return CliRunner().invoke(program.main, arguments)

    return runs, tree, tmp_path


def test_publishing_writes_all_documents_of_release_scenes(published):
    runs, tree, folder = published
    done = runs()
    assert done.exit_code == 0, done.output
    found = readme.read_published()
    assert (found["about"]["draw"], found["about"]["seed"]) == ("release", release(tree["commit"]))
    assert "release scenes" in (folder / "results.md").read_text(encoding="utf-8")
    assert readme.block(readme.README) == readme.brief(found)
    # Single scenes are nobody's business.
    assert not (folder / "out" / "worst.jpg").exists()


def test_nothing_is_published_of_a_tree_with_changes(published):
    runs, tree, _ = published
    tree["clean"] = False
    assert isinstance(runs().exception, ResultsError)
    assert not readme.PUBLISHED.exists()
