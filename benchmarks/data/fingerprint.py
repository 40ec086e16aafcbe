"""A fingerprint of what determines rendered pixels: modules of a renderer, their data files, and libraries.

Changes to exporters, docstrings or comments do not affect it, so nothing is rendered again after them.
"""

import ast
import functools
import hashlib
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

PROJECT = ("tracker", "synthetic", "benchmarks")
"""Folders whose files determine the figures."""

KEEPERS = ("benchmarks.data.store", "benchmarks.data.fingerprint", "benchmarks.data.plan")
"""Modules that choose and store images; they do not affect pixels."""

LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "pybullet", "trimesh", "av")


@functools.cache
def fingerprint(*modules: str) -> str:
    """Return a fingerprint, of twelve hex digits, of all that determines the pixels made by these modules."""
    digest = hashlib.sha256()
    for file in sources(modules):
        content = file.read_bytes()
        digest.update(str(file.relative_to(ROOT)).encode())
        digest.update(code(content) if file.suffix == ".py" else content)
    for library in LIBRARIES:
        digest.update(f"{library} {version_of(library)}".encode())
    return digest.hexdigest()[:12]


def sources(modules: Sequence[str]) -> list[Path]:
    """Return the files of these modules, of all project modules that they import, and of data beside them."""
    found: set[Path] = set()
    todo = list(modules)
    kept = {_file(keeper) for keeper in KEEPERS}
    while todo:
        file = _file(todo.pop())
        if file is None or file in found | kept:
            continue
        found.add(file)
        todo += _imports(ast.parse(file.read_bytes()))
    data = {extra for file in found for extra in _data_beside(file.parent)}
    return sorted(found | data)


def code(source: bytes) -> bytes:
    """Return a module's code without docstrings, comments and formatting."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                item
                for item in body
                if not (isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant))
            ]
    return ast.dump(tree).encode()


def _imports(tree: ast.AST) -> Iterator[str]:
    """Yield names that may be modules.

    A package's own file counts only if something is imported from it.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            parts = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from parts
            if any(_file(part) is None for part in parts):
                yield node.module


def _file(module: str) -> Path | None:
    if module.split(".")[0] not in PROJECT:
        return None
    path = ROOT / module.replace(".", "/")
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in candidates if file.is_file()), None)


def _data_beside(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        if path.is_dir() and path.name != "__pycache__" and not any(path.glob("*.py")):
            yield from (file for file in path.rglob("*") if file.is_file())


def version_of(library: str) -> str:
    """Return the version of an installed package; `none` if it is missing."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "none"
