"""What is published: README's figures are those of the committed results; one command writes both."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from benchmarks import commands, program
from benchmarks.data.seeds import release
from benchmarks.judge.results import Results, ResultsError, read_results
from benchmarks.report import readme
from tests.helpers.made_up_results import made_up_results


def test_readmes_figures_are_those_of_the_committed_results():
    results = read_results(readme.PUBLISHED)
    assert readme.block(readme.README) == readme.brief(results) != ""
    assert readme.block(readme.PAGE) == readme.figures(results)


@pytest.fixture
def pages(tmp_path, monkeypatch):
    """README.md and the page of figures with empty blocks, in a folder of their own."""
    for key in ("README", "PAGE"):
        path = tmp_path / f"{key.lower()}.md"
        path.write_text(f"before\n{readme.BEGIN}\nold\n{readme.END}\nafter\n", encoding="utf-8")
        monkeypatch.setattr(readme, key, path)
    return readme.README, readme.PAGE


def test_only_the_blocks_are_written(pages):
    results = made_up_results(12)
    readme.write_figures(results)
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert text.startswith("before\n")
        assert text.endswith("\nafter\n")
    assert readme.block(readme.README) == readme.brief(results)
    assert readme.block(readme.PAGE) == readme.figures(results)
    row = next(row for row in results.rows if row["part"] == "accuracy" and row["group"] == "hard light")
    assert f"{row['median_mm']:.3f} mm" in readme.PAGE.read_text(encoding="utf-8")
    before = readme.README.read_text(encoding="utf-8")
    readme.PAGE.write_text("no marks", encoding="utf-8")
    with pytest.raises(ResultsError, match="no block"):
        readme.write_figures(made_up_results(3))
    assert readme.README.read_text(encoding="utf-8") == before


@pytest.fixture
def published(tmp_path, monkeypatch, pages):
    """Runs `all --publish` on made-up parts, into a folder of its own."""
    tree = {"commit": "f" * 40, "clean": True, "code": "c", "kernels": "k", "processor": "one"}
    monkeypatch.setattr(commands, "origin", lambda: dict(tree))
    monkeypatch.setattr(program, "origin", lambda: dict(tree))
    made = made_up_results(4)

    def rows(run):
        run.results.frames = made.frames
        assert not run.development
        return made.rows

    monkeypatch.setattr(commands, "PARTS", {"accuracy": rows})
    monkeypatch.setattr(program, "PARTS", {"accuracy": rows})
    monkeypatch.setattr(program, "PUBLISHED", tmp_path / "results.md")
    monkeypatch.setattr(readme, "PUBLISHED", tmp_path / "published.json")

    def run(*more):
        arguments = ["all", "--publish", "--scenes", "4", "-o", str(tmp_path / "out"), *more]
        return CliRunner().invoke(program.main, arguments)

    return run, tree, tmp_path


@pytest.mark.slow
def test_publishing_writes_document_rows_page_and_readme_of_release_scenes(published):
    run, tree, folder = published
    done = run()
    assert done.exit_code == 0, done.output
    found = read_results(folder / "published.json")
    assert (found.about["draw"], found.about["seed"]) == ("release", release(tree["commit"]))
    assert len(found.frames) == 0
    assert found.worst == []
    assert "release scenes" in (folder / "results.md").read_text(encoding="utf-8")
    assert readme.block(readme.README) == readme.brief(found)
    assert readme.block(readme.PAGE) == readme.figures(found)
    assert "The worst frames" not in (folder / "out" / "report.html").read_text(encoding="utf-8")


def test_nothing_is_published_of_a_tree_with_changes(published):
    run, tree, folder = published
    tree["clean"] = False
    done = run()
    assert isinstance(done.exception, ResultsError)
    assert not (folder / "published.json").exists()


def test_nothing_of_single_scenes_is_told_of_release_scenes():
    results = made_up_results(4)
    results.about["draw"] = "release"
    assert "release scenes" in readme.figures(results)
    assert not commands.Run(None, None, None, results=results).development  # type: ignore[arg-type]
    assert Results().worst == []
