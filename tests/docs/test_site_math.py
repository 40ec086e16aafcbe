import re

import pytest

from tests.docs.samples import PAGES

pytest.importorskip("latex2mathml", reason="docs: no module latex2mathml")

from scripts.site_math import mathml, on_page_markdown

PAGE = PAGES["docs/how-it-works"]
CODE = "```sh\nls $HOME $OLDPWD\n```\n"


def test_every_formula_of_a_page_becomes_mathml():
    shown = on_page_markdown(PAGE)
    assert shown.count('<div class="equation"') == PAGE.count("```math\n") > 20
    assert not re.search(r"\$|```|\\", shown)


def test_code_beside_formulas_stays_as_it_is():
    shown = on_page_markdown(f"{CODE}$x$\n```math\ny \\tag{{1}}\n```\n`$x$`\n{CODE}")
    assert shown.count(CODE) == 2
    assert "`$x$`" in shown
    assert shown.count("</math>") == 2
    assert "<span>(1)</span>" in shown


def test_an_exponent_belongs_to_all_that_its_fences_hold():
    held = r"<msup><mrow><mo[^>]*>&#x00028;</mo>.*</mrow><mn>2</mn></msup>"
    assert re.search(held, mathml(r"\bigl(a + b\bigr)^2"))


def test_a_command_that_browsers_would_be_shown_as_it_is_fails_the_build():
    with pytest.raises(ValueError, match=r"\\\\arg\b.* is not known"):
        mathml(r"\arg x")


def test_equations_that_are_not_in_their_order_fail_the_build():
    with pytest.raises(ValueError, match=r"numbered \[1, 3\]"):
        on_page_markdown("```math\nx \\tag{1}\n```\n```math\ny \\tag{3}\n```\n")
