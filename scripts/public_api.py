"""Write the names and signatures of the public API to tests/public_api.txt, with which a test compares it.

    python scripts/public_api.py

The public names are those that `tracker` exports, that the documentation's reference shows, and that the
packages in the documentation's pages export. Users notice a change there: it belongs in CHANGELOG.md.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SNAPSHOT = ROOT / "tests" / "public_api.txt"
PACKAGES = (
    *("tracker.tasks.move_object", "tracker.tasks.rearrange_dice"),
    *("tracker.live", "tracker.logs", "tracker.noise", "tracker.recordings", "tracker.viz"),
)
_SHOWN = re.compile(r"^::: ([\w.]+)$", re.MULTILINE)


def public_api() -> str:
    """Return the snapshot: a line for each public name, with signatures as in the sources."""
    return "".join(f"{line}\n" for line in _lines())


def _lines() -> Iterator[str]:
    named = {f"tracker.{name}" for name in _exported(_tree("tracker"))}
    named |= {f"{package}.{name}" for package in PACKAGES for name in _exported(_tree(package))}
    shown = _SHOWN.findall((ROOT / "docs" / "reference.md").read_text(encoding="utf-8"))
    homes = {name: _home(name) for name in named}
    named |= {name for name in shown if name not in homes.values() and not _is_module(name)}
    for module in sorted(name for name in shown if _is_module(name)):
        if not _exported(_tree(module)):
            named |= {f"{module}.{name}" for name in _defined(_tree(module))}
    for name in sorted(named):
        yield from _described(name, homes.get(name) or _home(name))


def _described(name: str, home: str) -> Iterator[str]:
    """Yield the lines for `home`, under the public name `name`."""
    module, _, last = home.rpartition(".")
    node = _defined(_tree(module))[last]
    if isinstance(node, ast.FunctionDef):
        yield _signature(name, node)
    elif isinstance(node, ast.ClassDef):
        bases = ", ".join(map(ast.unparse, node.bases))
        yield f"class {name}({bases})" if bases else f"class {name}"
        for one in node.body:
            if isinstance(one, ast.FunctionDef) and (one.name == "__init__" or not one.name.startswith("_")):
                marks = "".join(f"@{ast.unparse(mark)} " for mark in one.decorator_list)
                yield _signature(f"    {marks}{one.name}", one)
            elif isinstance(one, ast.AnnAssign | ast.Assign):
                field = ast.unparse(one)
                if not field.startswith("_"):
                    yield f"    {field}"
    else:
        yield f"{name} = {ast.unparse(node)}"


def _signature(name: str, node: ast.FunctionDef) -> str:
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"{name}({ast.unparse(node.args)}){returns}"


def _home(name: str) -> str:
    """Return where a name is defined, following imports."""
    module, _, last = name.rpartition(".")
    tree = _tree(module)
    if last in _defined(tree):
        return name
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                if (alias.asname or alias.name) == last:
                    inner = f"{node.module}.{alias.name}"
                    return inner if _is_module(inner) else _home(inner)
    raise LookupError(f"{name}: found in no source")


def _defined(tree: ast.Module) -> dict[str, ast.AST]:
    """Return what a module itself defines, except private names."""
    found: dict[str, ast.AST] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found[node.name] = node
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found[node.targets[0].id] = node.value
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
            found[node.target.id] = node.value
    return {name: node for name, node in found.items() if not name.startswith("_")}


def _exported(tree: ast.Module) -> list[str]:
    """Return a module's exports: the names of `__all__`, or those imported under their own name."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return [
        alias.name
        for node in imports
        for alias in node.names
        if alias.asname == alias.name and not _is_module(f"{node.module}.{alias.name}")
    ]


def _tree(module: str) -> ast.Module:
    """Return the syntax tree of a module's source."""
    place = ROOT.joinpath(*module.split("."))
    path = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    return ast.parse(path.read_text(encoding="utf-8"))


def _is_module(name: str) -> bool:
    place = ROOT.joinpath(*name.split("."))
    return place.is_dir() or place.with_suffix(".py").is_file()


def main() -> None:
    """Write the snapshot."""
    SNAPSHOT.write_text(public_api(), encoding="utf-8")


if __name__ == "__main__":
    main()
