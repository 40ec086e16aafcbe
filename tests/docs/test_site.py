import re
from types import SimpleNamespace

import pytest

from tests.docs.samples import PAGES
from tests.helpers import ROOT

pytest.importorskip("latex2mathml", reason="docs: no module latex2mathml")

from scripts import site_math
from scripts.site_links import on_page_content, on_page_markdown

PAGE = PAGES["docs/how-it-works"]
CODE = "```sh\nls $HOME $OLDPWD\n```\n"


def test_every_formula_of_a_page_becomes_mathml_and_code_beside_it_stays_as_it_is():
    shown = site_math.on_page_markdown(PAGE)
    assert shown.count('<div class="equation"') == PAGE.count("```math\n") > 20
    assert not re.search(r"\$|```|\\", shown)
    shown = site_math.on_page_markdown(f"{CODE}$x$\n```math\ny \\tag{{1}}\n```\n`$x$`\n{CODE}")
    assert shown.count(CODE) == 2
    assert "`$x$`" in shown
    assert shown.count("</math>") == 2
    assert "<span>(1)</span>" in shown
    # An exponent belongs to all that its fences hold.
    held = r"<msup><mrow><mo[^>]*>&#x00028;</mo>.*</mrow><mn>2</mn></msup>"
    assert re.search(held, site_math.mathml(r"\bigl(a + b\bigr)^2"))


def test_commands_that_browsers_do_not_know_and_equations_out_of_order_fail_the_build():
    with pytest.raises(ValueError, match=r"\\\\arg\b.* is not known"):
        site_math.mathml(r"\arg x")
    with pytest.raises(ValueError, match=r"numbered \[1, 3\]"):
        site_math.on_page_markdown("```math\nx \\tag{1}\n```\n```math\ny \\tag{3}\n```\n")


def test_links_of_the_site_that_lead_out_of_it_are_words_and_names_in_tables_may_break():
    cell = "<td><code>a_b.c</code> a_b</td><p><code>a_b</code></p>"
    assert on_page_content(cell) == "<td><code>a<wbr>_b<wbr>.c</code> a_b</td><p><code>a_b</code></p>"
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


def test_an_example_that_is_linked_alone_and_the_figures_of_the_readme_are_shown_on_the_site():
    shown = on_page_markdown("Look:\n\n[`examples/still.py`](../examples/still.py)\n\nThere.")
    assert f"```python\n{(ROOT / 'examples' / 'still.py').read_text(encoding='utf-8')}```\n" in shown
    with pytest.raises(FileNotFoundError):
        on_page_markdown("[`examples/no_such.py`](../examples/no_such.py)")
    shown = on_page_markdown("[Accuracy](../README.md#accuracy)")
    assert shown.startswith("| cube / cuboid |")
    assert shown in PAGES["README"]
