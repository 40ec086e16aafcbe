"""A hook of MkDocs: the report of the measurements is a page, and names of code are no links."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
REPORT = Path("benchmarks/results.md")
OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)[^)]*\)")

BESIDE = re.compile(r"\]\((\w[\w-]*\.md)\)")


def _link(found: re.Match[str]) -> str:
    """A link to a file of the repository that is no page: its words alone, the path when pointed at.

    Raises:
        FileNotFoundError: there is no such file, which fails the build.
    """
    if not (ROOT / found[2]).exists():
        raise FileNotFoundError(f"a page links to ../{found[2]}, which is not there")
    if found[2] == REPORT.as_posix():
        return f"[{found[1]}]({REPORT.name})"
    words = re.sub(r"`([^`]+)`", r"<code>\1</code>", found[1])
    return f'<span title="{found[2]}">{words}</span>'


def on_files(files: Any, *, config: Any, **_: Any) -> Any:
    """The pages, and the report."""
    from mkdocs.structure.files import File

    root = Path(config["config_file_path"]).parent
    files.append(File.generated(config, REPORT.name, abs_src_path=str(root / REPORT)))
    return files


def on_page_markdown(markdown: str, *, page: Any = None, **_: Any) -> str:
    """The page's text with links that lead to a page of the site."""
    if page is not None and page.file.src_uri == REPORT.name:
        # In the repository it is elsewhere than the other pages.
        markdown = BESIDE.sub(rf"](../{REPORT.parent}/\1)", markdown)
    return OUTSIDE.sub(_link, markdown)
