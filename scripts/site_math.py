"""A hook of MkDocs: it turns formulas into MathML during the build, so that pages load no script."""

import re
from itertools import zip_longest
from typing import Any

from latex2mathml.converter import convert

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"(`[^`\n]*`)|\$([^$\n]+)\$")
FENCED = re.compile(r"\\[bB]ig([lr])(?![a-z])")
NAMED = re.compile(r"(<mi>[a-z]{2,}</mi>)(?!<mo)")
NEXT = re.compile(r"(?<=,)\s*\\q?quad\s")
NUMBER = re.compile(r"\\tag\{(\d+)\}")


def mathml(formula: str, display: str = "inline") -> str:
    """Return the formula as MathML.

    Delimiters of fixed size become growing ones, so that an exponent belongs to all that they enclose rather
    than to the last term. A small space follows a function's name.

    Raises:
        ValueError: the converter does not know a command.
    """
    grown = FENCED.sub(lambda found: {"l": r"\left", "r": r"\right"}[found[1]], formula)
    found = convert(grown, display=display)
    if unknown := re.findall(r"\\\w+", found):
        raise ValueError(f"the formula {formula!r}: {', '.join(unknown)} is not known to latex2mathml")
    return NAMED.sub(r'\1<mspace width="0.17em"/>', found)


def _block(language: str, text: str) -> str:
    if language != "math":
        return f"```{language}\n{text}```"
    formula, number = text.strip(), NUMBER.search(text)
    # On a narrow screen, formulas that stand side by side move below each other.
    math = "".join(mathml(part, "block") for part in NEXT.split(NUMBER.sub("", formula)))
    label = f"<span>({number[1]})</span>" if number else ""
    return f'<div class="equation" id="equation-{number[1] if number else ""}"><div>{math}</div>{label}</div>'


def _inline(found: re.Match[str]) -> str:
    # A bar would end the cell of a table, and a paragraph that begins with <math> would become a block.
    return found[1] or f"<span>{mathml(found[2]).replace('|', '&#124;')}</span>"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return the page's text with formulas in GitHub's syntax, `$…$` and fences of `math`, as MathML.

    Raises:
        ValueError: its equations are not numbered in order, which fails the build.
    """
    numbers = [int(number) for number in NUMBER.findall(markdown)]
    if numbers != list(range(1, len(numbers) + 1)):
        raise ValueError(f"equations are numbered {numbers}, expected 1, 2, 3 …")
    # Text, then language and content of each fence, alternate.
    parts = FENCE.split(markdown)
    words = (INLINE.sub(_inline, part) for part in parts[::3])
    blocks = (_block(*fence) for fence in zip(parts[1::3], parts[2::3], strict=True))
    return "".join(part for pair in zip_longest(words, blocks, fillvalue="") for part in pair)
