"""A hook of MkDocs: formulas become MathML when the site is built, so that its pages load no script."""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

BLOCK = re.compile(r"^```math\n(.*?)^```$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"(`[^`\n]*`)|\$([^$\n]+)\$")
NUMBER = re.compile(r"\\tag\{(\d+)\}")


def _block(found: re.Match[str]) -> str:
    formula, number = found[1].strip(), NUMBER.search(found[1])
    math = convert(NUMBER.sub("", formula), display="block")
    label = f"<span>({number[1]})</span>" if number else ""
    return f'<div class="equation" id="equation-{number[1] if number else ""}">{math}{label}</div>'


def _inline(found: re.Match[str]) -> str:
    # A bar would end the cell of a table.
    return found[1] or convert(found[2]).replace("|", "&#124;")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page's text with formulas as GitHub has them, `$…$` and fences of `math`, made MathML."""
    code = re.split(r"(^```(?!math\n).*?^```$)", markdown, flags=re.DOTALL | re.MULTILINE)
    for k in range(0, len(code), 2):
        code[k] = INLINE.sub(_inline, BLOCK.sub(_block, code[k]))
    return "".join(code)
