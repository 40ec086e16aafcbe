"""A hook of MkDocs: reports of measurements are pages, examples are shown, other code is no link."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
REPORTS = (Path("benchmarks/results.md"), Path("benchmarks/tools.md"), Path("CHANGELOG.md"))
"""Pages that stand elsewhere: beside what measures them, and where people look for them."""

OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)([^)]*)\)")

EXAMPLE = re.compile(r"^\[`(examples/\w+\.py)`\]\(\.\./\1\)$", re.MULTILINE)
"""A line that links to an example and to nothing else."""

BESIDE = re.compile(r"\]\((\w[\w-]*\.md)\)")


PAGES = re.compile(r"\]\(\.\./docs/")


SHORT = re.compile(r"^\[[^\]]+\]\(\.\./README\.md#accuracy\)$", re.MULTILINE)
"""A line that links to the README's figures and to nothing else."""

IN_TABLE = re.compile(r"(?<=<td>)(?:(?!</td>).)*<code>.*?(?=</td>)", re.DOTALL)
JOINT = re.compile(r"(?<=[\w)])(?=[_./](?=\w))")


def _link(found: re.Match[str]) -> str:
    """A link to a file of the repository that is no page: its words alone, the path when pointed at.

    Raises:
        FileNotFoundError: there is no such file, which fails the build.
    """
    if not (ROOT / found[2]).exists():
        raise FileNotFoundError(f"a page links to ../{found[2]}, which is not there")
    if Path(found[2]) in REPORTS:
        return f"[{found[1]}]({Path(found[2]).name}{found[3]})"
    words = re.sub(r"`([^`]+)`", r"<code>\1</code>", found[1])
    return f'<span title="{found[2]}">{words}</span>'


def _example(found: re.Match[str]) -> str:
    """The example's text below its name: a reader of the site has no repository."""
    return f"`{found[1]}`:\n\n```python\n{(ROOT / found[1]).read_text(encoding='utf-8')}```"


def on_config(config: Any, **_: Any) -> Any:
    """The settings, with the version below each page."""
    from tracker import __version__

    config["copyright"] = f"Version {__version__}"
    return config


def on_files(files: Any, *, config: Any, **_: Any) -> Any:
    """The pages, and the reports."""
    from mkdocs.structure.files import File

    root = Path(config["config_file_path"]).parent
    for report in REPORTS:
        files.append(File.generated(config, report.name, abs_src_path=str(root / report)))
    return files


def _figures() -> str:
    """The README's figures, for readers of the site."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    return readme.partition("-->\n")[2].partition("\n<!-- /figures")[0]


def on_page_content(html: str, **_: Any) -> str:
    """The page with joints at which names in tables may break."""
    return IN_TABLE.sub(lambda cell: re.sub(r"<code>[^<]*</code>", _jointed, cell[0]), html)


def _jointed(code: re.Match[str]) -> str:
    return JOINT.sub("<wbr>", code[0])


BOOST = {"troubleshooting.md": 3.0, "results.md": 0.3, "tools.md": 0.2, "CHANGELOG.md": 0.3}
"""Weights of pages in the search: a symptom leads to its remedy first."""


def on_page_markdown(markdown: str, *, page: Any = None, **_: Any) -> str:
    """The page's text with links that lead to a page of the site."""
    if page is not None and page.file.src_uri in BOOST:
        page.meta["search"] = {"boost": BOOST[page.file.src_uri]}
    for report in REPORTS:
        if page is not None and page.file.src_uri == report.name:
            # In the repository they are elsewhere than the other pages.
            markdown = PAGES.sub("](", BESIDE.sub(rf"](../{report.parent}/\1)", markdown))
    markdown = SHORT.sub(lambda _: _figures(), EXAMPLE.sub(_example, markdown))
    return OUTSIDE.sub(_link, markdown)
