import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tracker
from scripts.site_links import on_page_content, on_page_markdown
from synthetic.camera.shot import QUALITIES
from tests.docs.samples import PAGES, blocks
from tests.helpers import ROOT, contents
from tests.helpers.synthetic_needs import skip_without_platform

README = PAGES["README"]
EXAMPLES = ROOT / "examples"


def test_the_dice_example_tells_which_dice_to_move(tmp_path, run_script):
    result = run_script(EXAMPLES / "dice_task.py", folder=tmp_path)
    error, *moves = result.stdout.splitlines()
    assert 2500 < int(error.removeprefix("error [px]")) < 3500
    assert 5 <= len(moves) <= 10
    assert all(line.startswith("move [") for line in moves)


def test_the_example_of_errors_prints_them(tmp_path, run_script):
    result = run_script(EXAMPLES / "task_errors.py", folder=tmp_path)
    assert float(result.stdout.split()[0]) == pytest.approx((np.hypot(0.01, 0.02) / 0.39 + 0.075) / 2)
    assert float(result.stdout.split()[-1]) == -67000


def test_the_example_finds_the_cube(working, run_script):
    result = run_script(EXAMPLES / "detect_cube.py", folder=working)
    names = [line[:16].strip() for line in result.stdout.splitlines()]
    assert names == ["position [m]", "orientation xyzw", "confidence"]
    assert float(result.stdout.split()[-1]) > 0.5
    (shown,) = (block for block in blocks("text", "docs/first-steps") if block.startswith("position"))
    numbers = (re.findall(r"-?\d\.[\de-]+", text) for text in (shown, result.stdout))
    np.testing.assert_allclose(*(np.array(found, float) for found in numbers), atol=2e-3)


def test_the_pages_object_loads_with_its_colours(working):
    model = tracker.load_object(working / "my_object.toml")
    assert model.name == "my_object"
    assert model.colors == "my_object.npz" or Path(model.colors).parent == working


def test_the_pages_explain_every_status():
    explained = re.findall(r"^\| `([a-z_]+)` \|", PAGES["docs/answers"], flags=re.MULTILINE)
    assert explained == [status.value for status in tracker.Status]


@pytest.mark.parametrize(
    "symptom",
    [
        "no pose", "colours", "red blue swapped", "swapped cameras", "camera moved", "blurred images",
        "float table", "12-bit png", "lags", "first run slow", "images late", "black frozen", "pose jumps",
        "extra missing",
    ],
)  # fmt: skip
def test_a_section_on_troubleshooting_has_all_words_of_a_symptom(symptom):
    sections = re.split("^##+ ", PAGES["docs/troubleshooting"], flags=re.MULTILINE)
    assert any(all(word in section.lower() for word in symptom.split()) for section in sections)


def test_every_link_of_what_is_no_page_leads_somewhere():
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "benchmarks" / "tools.md"):
        for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert "://" in target or (page.parent / target).exists(), f"{page.name}: {target}"


def test_links_of_the_site_that_lead_out_of_it_are_words():
    assert on_page_markdown("[all](../benchmarks/results.md)") == "[all](results.md)"
    report = SimpleNamespace(file=SimpleNamespace(src_uri="results.md"), meta={})
    beside = on_page_markdown("[more](development.md)", page=report)
    assert beside == '<span title="benchmarks/development.md">more</span>'
    tools = SimpleNamespace(file=SimpleNamespace(src_uri="tools.md"), meta={})
    assert on_page_markdown("[dice](../benchmarks/tools.md#dice)") == "[dice](tools.md#dice)"
    assert on_page_markdown("[all](../docs/figures.md#targets)", page=tools) == "[all](figures.md#targets)"
    code = on_page_markdown("[`a`](../tracker/pipeline.py)")
    assert code == '<span title="tracker/pipeline.py"><code>a</code></span>'
    with pytest.raises(FileNotFoundError, match="no_such"):
        on_page_markdown("[a](../tracker/no_such.py)")


def test_an_example_that_is_linked_alone_is_shown_on_the_site():
    shown = on_page_markdown("Look:\n\n[`examples/still.py`](../examples/still.py)\n\nThere.")
    assert f"```python\n{(EXAMPLES / 'still.py').read_text(encoding='utf-8')}```\n" in shown
    with pytest.raises(FileNotFoundError):
        on_page_markdown("[`examples/no_such.py`](../examples/no_such.py)")


def test_the_home_page_shows_the_figures_of_the_readme():
    shown = on_page_markdown("[Accuracy](../README.md#accuracy)")
    assert shown.startswith("| cube / cuboid |")
    assert shown in README


def test_names_in_tables_may_break_at_their_joints():
    cell = "<td><code>a_b.c</code> a_b</td><p><code>a_b</code></p>"
    assert on_page_content(cell) == "<td><code>a<wbr>_b<wbr>.c</code> a_b</td><p><code>a_b</code></p>"


def words(text: str) -> int:
    """How many there are, rules of tables left out."""
    return sum(not re.fullmatch(r"[|:-]+", word) for word in text.split())


def test_readme_and_pages_are_short():
    assert words(README) <= 500
    assert sum(words(text) for name, text in PAGES.items() if name != "README") <= 16_000


def test_the_still_is_the_same_each_time_but_for_its_seed_and_its_error_small(tmp_path, run_script):
    skip_without_platform()
    for more in ((), ("--output", "again"), ("--output", "other", "--seed", 7)):
        result = run_script(EXAMPLES / "still.py", *more, folder=tmp_path)
        found = re.search(r"error +([\d.]+) mm, ([\d.]+) degrees", result.stdout)
        assert found is not None, result.stdout
        assert float(found[1]) < 1
        assert float(found[2]) < 1
    first, again, other = (contents(tmp_path / name) for name in ("demo", "again", "other"))
    assert first == again
    assert first["overlay.png"] != other["overlay.png"]


def test_the_demo_films_what_it_finds(tmp_path, run_script, monkeypatch):
    pytest.importorskip("av", reason="video: no module av")
    pytest.importorskip("matplotlib", reason="plot: no module matplotlib")
    skip_without_platform()
    monkeypatch.setitem(QUALITIES, "default", QUALITIES["fast"])
    result = run_script(EXAMPLES / "demo.py", "--frames", 3, "--output", "demo", folder=tmp_path)
    assert "within 5 mm, 5°  3" in result.stdout
    written = {path.name for path in (tmp_path / "demo").iterdir()}
    assert {"overlay.png", "overlay.mp4", "errors.png", "camera60.png", "camera60.yml"} <= written
