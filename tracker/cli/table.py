"""Aligned columns for people."""

from __future__ import annotations

from collections.abc import Sequence


def table(rows: Sequence[Sequence[str]], gap: int = 2) -> str:
    """Lines of cells in columns as wide as their widest cell: the first flush left, the others right."""
    count = max(len(row) for row in rows)
    full = [[*row, *[""] * (count - len(row))] for row in rows]
    widths = [max(len(cell) for cell in column) for column in zip(*full, strict=True)]
    lines = []
    for first, *others in full:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append((" " * gap).join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)


def listing(rows: Sequence[Sequence[str]]) -> str:
    """Lines of a label and a value, the values flush left below each other."""
    widest = max(len(label) for label, _ in rows)
    # A file's name may have several lines, which would be read as other labels.
    return "\n".join(f"{label:{widest}}  {' '.join(value.splitlines())}" for label, value in rows)
