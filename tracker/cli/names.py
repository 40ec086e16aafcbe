"""The options that name an object and its colours: what there is stands in their help, and is completed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

_Command = TypeVar("_Command", bound=Callable[..., Any])
_ROOMS = Path(__file__).parents[1]
OBJECTS = tuple(sorted(path.stem for path in (_ROOMS / "objects" / "data").glob("*.toml")))
"""The objects that come with the package."""

COLORS = tuple(sorted(path.stem for path in (_ROOMS / "segmentation" / "data").glob("*.npz")))
"""The colour models that come with it."""


class _NameOrFile(click.ParamType):  # type: ignore[type-arg]  # which older ones do not take
    """One of some names, or a file."""

    name = "name"

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names that begin so, else files."""
        found = [CompletionItem(name) for name in self.names if name.startswith(incomplete)]
        return found or [CompletionItem(incomplete, type="file")]


def object_option(default: str = "") -> Callable[[_Command], _Command]:
    """`--object`, required unless `default` says which is taken without it."""
    said = f"{', '.join(OBJECTS)}, or a TOML file.{default and f'  [default: {default}]'}"
    return click.option(
        "--object", "object_name", required=not default, metavar="NAME", type=_NameOrFile(OBJECTS), help=said
    )


def colors_option(default: str = "the object's") -> Callable[[_Command], _Command]:
    """`--colors`; `default` says which are taken without it."""
    said = f"Colour model: {', '.join(COLORS)}, or a file (.npz).  [default: {default}]"
    return click.option("--colors", "colors_name", metavar="NAME", type=_NameOrFile(COLORS), help=said)
