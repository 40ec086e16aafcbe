"""The decorator of all compiled functions, and a cache of their machine code that is never out of date.

Numba notices changes in a function's own file, but not in the files of functions that it calls. Machine code
is therefore kept in folders named after a hash of all source files of a package's compiled functions.
"""

import contextlib
import functools
import hashlib
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import compiler, config, sigutils, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.codegen import JITCodeLibrary, ll  # type: ignore[attr-defined]
from numba.core.runtime.nrt import rtsys
from numba.core.typing.templates import make_concrete_template

_KERNEL = re.compile(r"@_?compiled\b")
_IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)
_CREATING = {"array", "copy", "empty", "eye", "zeros"}
"""Names of functions with which kernels may create arrays; kernels that use others fail to compile."""

_FOLDER = "kernels-"
_OTHERS, _OTHERS_SHARED = 1, 8
"""Number of other versions' cache folders to keep; the same below NUMBA_CACHE_DIR, which all copies share."""


class _Uncounted(compiler.Compiler):
    """Counts no references to arrays: that would take a tenth of the time."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)  # type: ignore[no-untyped-call]
        self.state.targetctx = self.state.targetctx.subtarget(enable_nrt=False)


def compiled(function: Callable[..., Any] | None = None, *, counted: bool = False, **options: Any) -> Any:
    """Compile a function on its first call and keep the result on disk; `options` are those of numba.njit.

    Division by zero gives what NumPy gives: checks would cost time, mostly in compilation. Assigning one
    array to another is slow to compile, too, as its error message is compiled as well: use loops instead.
    If no folder is writable or holds the machine code already, each process compiles it again.

    Only a kernel that creates arrays by the names in _CREATING counts references to arrays. A kernel needs
    `counted` to free new arrays that a function returns to it.
    """
    if function is None:
        return lambda function: compiled(function, counted=counted, **options)
    # Kernels are never called from C; wrappers for C would take as long to compile as those for Python.
    usual: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    # In this package, only kernels call functions with private names.
    part = function.__module__.startswith("tracker.") and function.__name__[0] == "_"
    usual["no_cpython_wrapper"] = part
    if not counted and _CREATING.isdisjoint(function.__code__.co_names):
        usual["pipeline_class"] = _Uncounted
    dispatcher = numba.njit(**{**usual, **options})(function)
    _have_called_as_part(dispatcher)
    if not part:
        # Numba raises RuntimeError if it finds no place for its cache.
        with contextlib.suppress(RuntimeError, OSError):
            dispatcher._cache = _Cache(function)  # type: ignore[no-untyped-call]
    return dispatcher


class _Part(JITCodeLibrary):
    """A function to be linked into its callers: it is optimised there, without machine code of its own."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


def _have_called_as_part(dispatcher: Any) -> None:
    """Make kernels that call this kernel compile it as part of themselves; it is not cached separately.

    By default numba optimises the called kernel, generates its machine code, links the optimised code into
    the caller and optimises it there again. This takes half as long again and inlines less. Literal
    arguments count as their type, so that no version is compiled for a single literal value.
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
    """Compile a kernel for given argument types, to be linked into its callers; return numba's result."""
    description = dispatcher.targetdescr
    flags: Any = compiler.Flags()  # type: ignore[no-untyped-call]
    description.options.parse_as_flags(flags, dispatcher.targetoptions)
    flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
    context, function = description.target_context, dispatcher.py_func
    library = _Part(context.codegen(), function.__qualname__)  # type: ignore[no-untyped-call]
    pipeline = dispatcher._compiler.pipeline_class
    result = compiler.compile_extra(  # type: ignore[no-untyped-call]
        description.typing_context, context, function, arguments, None, flags, {}, library, pipeline
    )
    if pipeline is _Uncounted and "array(" in str(result.signature.return_type):
        raise TypeError(f"{function.__qualname__}: returns an array, but creates none")
    context.insert_user_function(library, result.fndesc, [library])
    return result


def is_cached(function: Any) -> bool:
    """Whether a compiled function's machine code for this processor is on disk: its first call is quick."""
    with contextlib.suppress(Exception):  # it has no cache, or a damaged one
        processor = function.targetctx.codegen().magic_tuple()
        return any(processor == its for _, its, _ in function._cache._cache_file._load_index())
    return False


@functools.cache
def fingerprint(package: str) -> str:
    """Return a hash of numba's version and of all sources that can affect a package's compiled functions.

    These are the files that hold such functions, and all files of the package and of this one that they
    import, directly or indirectly, since constants are compiled in. OSError if there are none, or they cannot
    be read.
    """
    root = Path(sys.modules[package].__path__[0])
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(root.rglob("[!.]*.py"))}
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
    """Files that a source may import from the packages `own` (name: folder); they need not exist."""
    for module, names in _IMPORT.findall(text):
        first, *rest = module.split(".")
        if first not in own:
            continue
        place = own[first].joinpath(*rest)
        yield place.with_suffix(".py")
        for name in ("__init__", *re.findall(r"\w+", names)):
            yield place / f"{name}.py"


def _base(found: Any, function: Callable[..., Any]) -> Path:
    """Return the folder that numba chose; below NUMBA_CACHE_DIR all copies of a package share it."""
    if isinstance(found, CompileResultCacheImpl._locator_classes[0]):
        return Path(config.CACHE_DIR) / function.__module__.rpartition(".")[0]  # type: ignore[attr-defined]
    return Path(found.get_cache_path())


def _place(base: Path, name: str) -> Path:
    """Return the folder `name` in `base`. If it is new, create it and remove folders of older sources."""
    folder = base / name
    if not folder.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        # Another process may do the same, or still use a removed folder: it then compiles on its own.
        with contextlib.suppress(OSError):
            others = [other for other in base.glob(f"{_FOLDER}*") if other != folder]
            others.sort(key=lambda other: other.stat().st_mtime)
            stay = _OTHERS_SHARED if config.CACHE_DIR else _OTHERS  # type: ignore[attr-defined]
            for other in others[:-stay]:
                shutil.rmtree(other, ignore_errors=True)
    return folder


class _Locator(_CacheLocator):
    """Where numba caches a function: a folder for the current sources, inside numba's own choice."""

    def __init__(self, found: Any, function: Callable[..., Any]) -> None:
        self._found, package = found, function.__module__.partition(".")[0]
        if not hasattr(sys.modules[package], "__path__"):
            # Functions compiled in a script may contain this package's kernels.
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
    """Make a numba locator that accepts a read-only folder if it holds code of the current sources.

    In a container, the folder may be part of the image: nothing can be written, but its code can be used.
    """

    class Left(kind):  # type: ignore[misc]
        @classmethod
        def from_function(cls, function: Callable[..., Any], file: str) -> Any:
            found, package = cls(function, file), function.__module__.partition(".")[0]
            folder = _base(found, function)
            # If NUMBA_CACHE_DIR is not set, its locator gives a relative path, where anyone may write.
            if not folder.is_absolute() or not hasattr(sys.modules[package], "__path__"):
                return None
            return found if os.path.isdir(folder / f"{_FOLDER}{fingerprint(package)}") else None

    return Left


# The first two are NUMBA_CACHE_DIR and the source's own folder.
_PLACES = [
    *CompileResultCacheImpl._locator_classes,
    *map(_left_by_others, CompileResultCacheImpl._locator_classes[:2]),
]


class _Implementation(CompileResultCacheImpl):
    _locator_classes = _PLACES

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._locator = _Locator(self._locator, function)

    def reduce(self, result: Any) -> Any:
        # Kernels compile what they call: of the bitcode that is kept to be linked into other code, only the
        # name of the function that Python calls is needed. Environments serve errors whose text is composed
        # as they occur, and kernels raise none; loading them imports numba's arrays.
        (name, kind, (code, _)), *others, _envs = super().reduce(result)  # type: ignore[no-untyped-call]
        entry = f'define void @"{result.fndesc.llvm_cpython_wrapper_name}"() {{ ret void }}'
        return (name, kind, (code, ll.parse_assembly(entry).as_bitcode())), *others, ()


class _Cache(FunctionCache):
    _impl_class = _Implementation

    def _index_key(self, *arguments: Any) -> Any:
        # The folder stands for the sources. Their bytecode also differs if Python strips docstrings (-OO).
        kind, processor, (_, captured) = super()._index_key(*arguments)  # type: ignore[no-untyped-call]
        return kind, processor, captured

    def load_overload(self, *arguments: Any) -> Any:
        # Damaged files may raise any error: they count as missing, and the index is cleared. Numba's own
        # method also imports all that only a compiler needs, SciPy's linear algebra among it.
        try:
            rtsys.initialize(arguments[1])
            return self._load_overload(*arguments)  # type: ignore[no-untyped-call]
        except Exception:
            with contextlib.suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, *arguments: Any) -> None:
        # The cache is a convenience: a full disk or a missing folder must not stop the program.
        with contextlib.suppress(OSError):
            super().save_overload(*arguments)  # type: ignore[no-untyped-call]
