"""A hook of MkDocs: it adds reports as pages, shows examples, and turns links to other code into text."""

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
REPORTS = (Path("benchmarks/results.md"), Path("benchmarks/tools.md"), Path("CHANGELOG.md"))
"""Pages from outside docs/: beside what measures them, or where people look for them."""

OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)([^)]*)\)")

EXAMPLE = re.compile(r"^\[`(examples/\w+\.py)`\]\(\.\./\1\)$", re.MULTILINE)
"""A line with a link to an example and nothing else."""

BESIDE = re.compile(r"\]\((\w[\w-]*\.md)\)")


PAGES = re.compile(r"\]\(\.\./docs/")


SHORT = re.compile(r"^\[[^\]]+\]\(\.\./README\.md#accuracy\)$", re.MULTILINE)
"""A line with a link to the README's figures and nothing else."""

IN_TABLE = re.compile(r"(?<=<td>)(?:(?!</td>).)*<code>.*?(?=</td>)", re.DOTALL)
JOINT = re.compile(r"(?<=[\w)])(?=[_./](?=\w))")


def _link(found: re.Match[str]) -> str:
    """Replace a link to a file that is not a page by its words, with the path as a tooltip.

    Raises:
        FileNotFoundError: the file does not exist, which fails the build.
    """
    if not (ROOT / found[2]).exists():
        raise FileNotFoundError(f"a page links to ../{found[2]}, which is not there")
    if Path(found[2]) in REPORTS:
        return f"[{found[1]}]({Path(found[2]).name}{found[3]})"
    words = re.sub(r"`([^`]+)`", r"<code>\1</code>", found[1])
    return f'<span title="{found[2]}">{words}</span>'


def _example(found: re.Match[str]) -> str:
    """Add the example's text below its name, since a reader of the site has no repository."""
    return f"`{found[1]}`:\n\n```python\n{(ROOT / found[1]).read_text(encoding='utf-8')}```"


def on_config(config: Any, **_: Any) -> Any:
    """Return the settings, with the version below each page."""
    from tracker import __version__

    config["copyright"] = f"Version {__version__}"
    return config


def on_files(files: Any, *, config: Any, **_: Any) -> Any:
    """Return the pages, with the reports added."""
    from mkdocs.structure.files import File

    root = Path(config["config_file_path"]).parent
    for report in REPORTS:
        files.append(File.generated(config, report.name, abs_src_path=str(root / report)))
    return files


def _figures() -> str:
    """Return the README's figures, for readers of the site."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    return readme.partition("-->\n")[2].partition("\n<!-- /figures")[0]


def on_page_content(html: str, **_: Any) -> str:
    """Return the page with points at which names in tables may break."""
    return IN_TABLE.sub(lambda cell: re.sub(r"<code>[^<]*</code>", _jointed, cell[0]), html)


def _jointed(code: re.Match[str]) -> str:
    return JOINT.sub("<wbr>", code[0])


BOOST = {"troubleshooting.md": 3.0, "results.md": 0.3, "tools.md": 0.2, "CHANGELOG.md": 0.3}
"""Weights of pages in the search, which put a symptom's remedy first."""


def on_page_markdown(markdown: str, *, page: Any = None, **_: Any) -> str:
    """Return the page's text with links to pages of the site."""
    if page is not None and page.file.src_uri in BOOST:
        page.meta["search"] = {"boost": BOOST[page.file.src_uri]}
    for report in REPORTS:
        if page is not None and page.file.src_uri == report.name:
            # The repository has the report in another folder than the other pages.
            markdown = PAGES.sub("](", BESIDE.sub(rf"](../{report.parent}/\1)", markdown))
    markdown = SHORT.sub(lambda _: _figures(), EXAMPLE.sub(_example, markdown))
    return OUTSIDE.sub(_link, markdown)
