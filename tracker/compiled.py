"""Compiled functions: one decorator for all, and machine code on disk that is as new as its sources.

Numba notices a change in the file of a function, not in the files of what that calls. Machine code is
therefore kept in folders named after the content of all files that a package's compiled functions come from.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import compiler, config, sigutils, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.codegen import JITCodeLibrary
from numba.core.typing.templates import make_concrete_template

_KERNEL = re.compile(r"^ *@_?compiled\b", re.MULTILINE)
_IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)
_FOLDER = "kernels-"
_OTHERS = 1
"""Folders of other sources that stay, so that two versions that take turns do not compile each time."""
_OTHERS_SHARED = 8
"""The same below NUMBA_CACHE_DIR, where all copies of a package keep theirs."""


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function on its first call and keep the result on disk; `options` are those of numba.njit.

    A division by zero gives what NumPy gives: to check for it would cost time, and more of it to compile. So
    does an assignment of one array to another, whose error message is compiled as well: loops do without.
    Where no folder can be written and none has it from before, each process compiles the function again.
    """
    if function is None:
        return lambda function: compiled(function, **options)
    # Nobody takes kernels as functions of C, whose wrappers cost as much again as those of Python.
    usual = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    # Here, what has a private name is called by kernels alone.
    usual["no_cpython_wrapper"] = function.__module__.startswith("tracker.") and function.__name__[0] == "_"
    dispatcher = numba.njit(**{**usual, **options})(function)
    _have_called_as_part(dispatcher)
    # Without a place for its cache numba raises RuntimeError.
    with contextlib.suppress(RuntimeError, OSError):
        dispatcher._cache = _Cache(function)  # type: ignore[no-untyped-call]
    return dispatcher


class _Part(JITCodeLibrary):
    """A function for others to link: it is optimised in each of them, and has no machine code of its own."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


def _have_called_as_part(dispatcher: Any) -> None:
    """Have kernels that call a kernel compile it as a part of themselves; nothing of it is kept on disk.

    Numba would optimise a kernel that is called, make machine code of it, link what it has optimised into
    the caller and optimise it there again, which takes half as long again and inlines less. Numbers that a
    caller writes out count as any of their type, so that none is compiled for.
    """
    parts: dict[tuple[types.Type, ...], Any] = {}

    def get_call_template(arguments: Any, keywords: dict[str, Any]) -> Any:
        plain: Callable[[Any], Any] = types.unliteral
        named = {name: plain(kind) for name, kind in keywords.items()}
        signature, folded = dispatcher.fold_argument_types(tuple(map(plain, arguments)), named)
        if folded not in parts:
            parts[folded] = _compiled_as_part(dispatcher, folded)
        name = dispatcher.py_func.__name__
        signatures = [part.signature for part in parts.values()]
        template = make_concrete_template(name, name, signatures)  # type: ignore[no-untyped-call]
        return template, signature, folded, {}

    def get_overload(signature: Any) -> Any:
        arguments, _ = sigutils.normalize_signature(signature)  # type: ignore[no-untyped-call]
        return parts[tuple(arguments)].library

    dispatcher.get_call_template, dispatcher.get_overload = get_call_template, get_overload


def _compiled_as_part(dispatcher: Any, arguments: tuple[types.Type, ...]) -> Any:
    """What numba knows of a kernel with arguments of some types, compiled for others to link."""
    description = dispatcher.targetdescr
    flags: Any = compiler.Flags()  # type: ignore[no-untyped-call]
    description.options.parse_as_flags(flags, dispatcher.targetoptions)
    flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
    context, function = description.target_context, dispatcher.py_func
    library = _Part(context.codegen(), function.__qualname__)  # type: ignore[no-untyped-call]
    result = compiler.compile_extra(  # type: ignore[no-untyped-call]
        description.typing_context, context, function, arguments, None, flags, {}, library=library
    )
    context.insert_user_function(library, result.fndesc, [library])
    return result


def is_cached(function: Any) -> bool:
    """Whether the machine code of a compiled function lies on disk, so that it starts at once."""
    folder = getattr(function.stats, "cache_path", None)
    stem, version = Path(function.py_func.__code__.co_filename).stem, "py{}{}".format(*sys.version_info)
    name = f"{stem}.{function.py_func.__qualname__}-*.{version}*.nbi"
    return folder is not None and any(Path(folder).glob(name))


@functools.cache
def fingerprint(package: str) -> str:
    """Hash of numba's version and of all sources that can matter to a package's compiled functions.

    These are the files that hold such functions, and those of the package and of this one that they import,
    directly or not: constants are compiled in.

    Raises:
        OSError: there are no such files, or they cannot be read.
    """
    root = Path(sys.modules[package].__path__[0])
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(root.rglob("*.py"))}
    waiting = [path for path, text in texts.items() if _KERNEL.search(text)]
    if not waiting:
        raise OSError(f"{root} holds no sources")
    own = {package: root, __name__.partition(".")[0]: Path(__file__).parent}
    sources: dict[Path, str] = {}
    while waiting:
        path = waiting.pop()
        if path not in sources and path.is_file():
            sources[path] = texts[path] if path in texts else path.read_text(encoding="utf-8")
            waiting += _imported(sources[path], own)
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(sources):
        digest.update(f"\0{path.relative_to(root.parent) if path in texts else path.name}\0".encode())
        digest.update(sources[path].encode())
    return digest.hexdigest()[:16]


def _imported(text: str, own: dict[str, Path]) -> Iterator[Path]:
    """Files, which need not exist, that a source's imports from some packages (their folders) may mean."""
    for module, names in _IMPORT.findall(text):
        first, *rest = module.split(".")
        if first not in own:
            continue
        place = own[first].joinpath(*rest)
        yield place.with_suffix(".py")
        yield place / "__init__.py"
        for name in re.findall(r"\w+", names):
            yield place / f"{name}.py"


def _shared() -> Path:
    """NUMBA_CACHE_DIR; `Path()` where it is not set."""
    return Path(config.CACHE_DIR)  # type: ignore[attr-defined]


def _base(found: Any, function: Callable[..., Any]) -> Path:
    """The folder that numba has found; below NUMBA_CACHE_DIR the same for all copies of a package."""
    if isinstance(found, CompileResultCacheImpl._locator_classes[0]):
        return _shared() / function.__module__.rpartition(".")[0]
    return Path(found.get_cache_path())


def _place(base: Path, name: str) -> Path:
    """The folder `name` in `base`. Where it has to be made, those of older sources are removed."""
    folder = base / name
    if not folder.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        # Another process may do the same, or still use what is removed: it compiles for itself then.
        with contextlib.suppress(OSError):
            others = [other for other in base.glob(f"{_FOLDER}*") if other != folder]
            others.sort(key=lambda other: other.stat().st_mtime)
            stay = _OTHERS_SHARED if _shared() != Path() else _OTHERS
            for other in others[: len(others) - stay]:
                shutil.rmtree(other, ignore_errors=True)
    return folder


class _Locator(_CacheLocator):
    """Where numba keeps a function: a folder of the present sources where it would keep it anyway."""

    def __init__(self, found: Any, function: Callable[..., Any]) -> None:
        package = function.__module__.partition(".")[0]
        alone = not hasattr(sys.modules[package], "__path__")
        self._found = found
        if alone:
            # What a script compiles may be made of this package's kernels.
            self._stamp = f"{found.get_source_stamp()} {fingerprint(__name__.partition('.')[0])}"
            self._folder = str(found.get_cache_path())
        else:
            self._stamp = fingerprint(package)
            self._folder = str(_place(_base(found, function), _FOLDER + self._stamp))

    def get_cache_path(self) -> str:
        return self._folder

    def get_source_stamp(self) -> Any:
        return self._stamp

    def get_disambiguator(self) -> str:
        return str(self._found.get_disambiguator())


def _left_by_others(kind: Any) -> Any:
    """A place of numba's that need not be writable where it holds machine code of the present sources.

    A container's image may have it: there nothing can be kept, but what was made with the image be read.
    """

    class Left(kind):  # type: ignore[misc]
        @classmethod
        def from_function(cls, function: Callable[..., Any], file: str) -> Any:
            found, package = cls(function, file), function.__module__.partition(".")[0]
            folder = _base(found, function)
            # Without NUMBA_CACHE_DIR the place of this name is relative, and in nobody's hands.
            if not folder.is_absolute() or not hasattr(sys.modules[package], "__path__"):
                return None
            return found if (folder / f"{_FOLDER}{fingerprint(package)}").is_dir() else None

    return Left


# The first two are NUMBA_CACHE_DIR and the source's own folder.
_PLACES = [
    *CompileResultCacheImpl._locator_classes,
    *map(_left_by_others, CompileResultCacheImpl._locator_classes[:2]),
]


class _Implementation(CompileResultCacheImpl):
    _locator_classes = _PLACES

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        super().__init__(function)  # type: ignore[no-untyped-call]

    @functools.cached_property
    def locator(self) -> _Locator:
        return _Locator(self._locator, self._function)


class _Cache(FunctionCache):
    _impl_class = _Implementation

    def load_overload(self, *arguments: Any) -> Any:
        # What is damaged may raise whatever it likes: it counts as nothing, and is forgotten.
        try:
            return super().load_overload(*arguments)  # type: ignore[no-untyped-call]
        except Exception:
            with contextlib.suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, *arguments: Any) -> None:
        # To keep machine code is a convenience: a full disk or a folder that is gone must stop nobody.
        with contextlib.suppress(OSError):
            super().save_overload(*arguments)  # type: ignore[no-untyped-call]
