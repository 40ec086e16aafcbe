"""Find phrases that docs/style/phrases.txt replaces: `python scripts/check_phrases.py FILE ...`.

codespell knows single words only. The exit code is 1 if any is found.
"""

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

PHRASES = Path(__file__).resolve().parents[1] / "docs" / "style" / "phrases.txt"
SUFFIXES = {".md", ".py"}
SKIPPED = {"test_style.py"}
"""Files that contain the phrases on purpose."""


def read_phrases(text: str) -> list[tuple[re.Pattern[str], str]]:
    """Parse lines `pattern -> plainer words` into pairs; comments begin with #."""
    lines = (line.strip() for line in text.splitlines())
    pairs = (line.split(" -> ") for line in lines if line and not line.startswith("#"))
    return [
        (re.compile(rf"\b{pattern}\b".replace(" ", r"\s+"), re.IGNORECASE), better)
        for pattern, better in pairs
    ]


def found(text: str, phrases: Iterable[tuple[re.Pattern[str], str]]) -> Iterator[tuple[int, str, str]]:
    """Yield line, phrase and plainer words of each phrase in a text."""
    for pattern, better in phrases:
        for match in pattern.finditer(text):
            yield text.count("\n", 0, match.start()) + 1, " ".join(match[0].split()), better


def main(paths: Iterable[str]) -> int:
    """Print the phrases in files and folders; return the exit code."""
    phrases = read_phrases(PHRASES.read_text(encoding="utf-8"))
    files = [
        file
        for path in map(Path, paths)
        for file in (sorted(path.rglob("*")) if path.is_dir() else [path])
        if file.suffix in SUFFIXES and file.name not in SKIPPED
    ]
    lines = [
        f"{file}:{line}: {phrase} ==> {better}"
        for file in files
        for line, phrase, better in found(file.read_text(encoding="utf-8"), phrases)
    ]
    print("\n".join(lines), end="\n" if lines else "")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
