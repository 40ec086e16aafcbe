"""A table of finished text, for the report and for Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Headings and rows of cells; numbers are flush right."""

    heads: Sequence[str]
    """Headings of the columns."""
    rows: Sequence[Sequence[str]]
    """Cells, as many in each row as there are headings."""
    caption: str = ""
    """What it shows."""
    texts: frozenset[int] = frozenset({0})
    """Numbers of the columns that hold words, and are flush left."""

    def markdown(self) -> str:
        """The table as Markdown, its caption as a paragraph above it."""
        rules = ["---" if number in self.texts else "---:" for number in range(len(self.heads))]
        lines = [_line(self.heads), _line(rules), *map(_line, self.rows)]
        return "\n".join([f"{self.caption}\n"] * bool(self.caption) + lines)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
