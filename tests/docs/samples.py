"""Samples of the README and the pages: fenced blocks, and the commands in them."""

import re
from typing import NamedTuple

from tests.helpers import ROOT

PAGES = {
    path.relative_to(ROOT).with_suffix("").as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
"""Their texts by name: `README`, `docs/poses`, …"""

_SHELL = re.compile(r"^```sh\n(.*?)^```$(?:\n\n```(text|json)\n(.*?)^```$)?", flags=re.DOTALL | re.MULTILINE)

_INLINE = re.compile(r"`(tracker [a-z]+ [^`]* (?:--object|-o) [^`]+)`")

_FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def languages() -> dict[str, set[str]]:
    """Of each page the languages of its blocks."""
    return {name: {language for language, _ in _FENCED.findall(text)} for name, text in PAGES.items()}


def blocks(language: str, *pages: str) -> list[str]:
    """Blocks of some pages, or of all: each once, in the pages' order."""
    texts = [PAGES[name] for name in pages or PAGES]
    found = [block for text in texts for kind, block in _FENCED.findall(text) if kind == language]
    return list(dict.fromkeys(found))


class Sample(NamedTuple):
    """A block of shell commands, and what the page shows below it."""

    page: str
    commands: tuple[str, ...]
    """Without remarks."""
    language: str
    """`text` or `json`; empty: nothing is shown."""
    shown: str


def samples() -> list[Sample]:
    """All blocks of shell commands, in the pages' order."""
    return [
        Sample(page, tuple(_lines(block)), language, shown)
        for page, text in PAGES.items()
        for block, language, shown in _SHELL.findall(text)
    ]


def inline_commands() -> list[str]:
    """Whole commands within sentences."""
    return list(dict.fromkeys(one for text in PAGES.values() for one in _INLINE.findall(text)))


def _lines(block: str) -> list[str]:
    lines = block.replace("\\\n", " ").splitlines()
    found = (re.sub(r"\s+", " ", line.partition(" # ")[0]).strip() for line in lines)
    return [line for line in found if line]


def commands() -> list[str]:
    """The shell commands of all pages, without remarks."""
    return list(dict.fromkeys(line for sample in samples() for line in sample.commands))
