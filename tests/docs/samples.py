"""Samples of the README and the pages: fenced blocks, and the commands in them."""

import re

from tests.helpers import ROOT

PAGES = {
    path.relative_to(ROOT).with_suffix("").as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
"""Their texts by name: `README`, `docs/poses`, …"""

_SHOWN = re.compile(r"^```sh\n((?:(?!```).)*?)^```\n\n```text\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)

_FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def languages() -> dict[str, set[str]]:
    """Of each page the languages of its blocks."""
    return {name: {language for language, _ in _FENCED.findall(text)} for name, text in PAGES.items()}


def blocks(language: str, *pages: str) -> list[str]:
    """Blocks of some pages, or of all: each once, in the pages' order."""
    texts = [PAGES[name] for name in pages or PAGES]
    found = [block for text in texts for kind, block in _FENCED.findall(text) if kind == language]
    return list(dict.fromkeys(found))


def outputs() -> dict[str, str]:
    """What pages show below commands: of the last command of a block, where a block of text follows it."""
    pairs = (pair for text in PAGES.values() for pair in _SHOWN.findall(text))
    return {_lines(block)[-1]: shown for block, shown in pairs}


def _lines(block: str) -> list[str]:
    lines = block.replace("\\\n", " ").splitlines()
    found = (re.sub(r"\s+", " ", line.partition(" # ")[0]).strip() for line in lines)
    return [line for line in found if line]


def commands() -> list[str]:
    """The shell commands of all pages, without remarks."""
    return list(dict.fromkeys(line for block in blocks("sh") for line in _lines(block)))
