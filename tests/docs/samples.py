"""Samples of the README and the pages: fenced blocks, and the commands in them."""

import re
from typing import NamedTuple

from tests.helpers import ROOT

PAGES = {
    path.relative_to(ROOT).with_suffix("").as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
"""Their texts by name: `README`, `docs/poses`, …"""

FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
"""A block: its language, and what it shows."""

_SHELL = re.compile(r"^```sh\n(.*?)^```$(?:\n\n```(text|json)\n(.*?)^```$)?", flags=re.DOTALL | re.MULTILINE)

_INLINE = re.compile(r"`(tracker [a-z]+ [^`]* (?:--object|-o) [^`]+)`")


def blocks(language: str, *pages: str) -> list[str]:
    """Blocks of some pages, or of all: each once, in the pages' order."""
    texts = [PAGES[name] for name in pages or PAGES]
    found = [block for text in texts for kind, block in FENCED.findall(text) if kind == language]
    return list(dict.fromkeys(found))


class Sample(NamedTuple):
    """A block of shell commands, and what the page shows below it."""

    page: str
    commands: tuple[str, ...]
    """Without remarks."""
    language: str
    """`text` or `json`; empty: nothing is shown."""
    shown: str


def _lines(block: str) -> tuple[str, ...]:
    lines = block.replace("\\\n", " ").splitlines()
    found = (re.sub(r"\s+", " ", line.partition(" # ")[0]).strip() for line in lines)
    return tuple(line for line in found if line)


SAMPLES = [
    Sample(page, _lines(block), language, shown)
    for page, text in PAGES.items()
    for block, language, shown in _SHELL.findall(text)
]
"""All blocks of shell commands, in the pages' order."""

COMMANDS = list(dict.fromkeys(line for sample in SAMPLES for line in sample.commands))
"""The shell commands of all pages, without remarks."""

INLINE_COMMANDS = list(dict.fromkeys(one for text in PAGES.values() for one in _INLINE.findall(text)))
"""Whole commands within sentences."""
