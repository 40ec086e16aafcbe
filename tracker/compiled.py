"""Compiled functions: one decorator for all, and whether their machine code lies on disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function on its first call and keep the result on disk; `options` are those of numba.njit.

    A division by zero gives what NumPy gives: to check for it would cost time, and more of it to compile.
    Where no folder can be written, the function is compiled anew by each process.
    """
    if function is None:
        return lambda function: compiled(function, **options)
    options = {"nogil": True, "error_model": "numpy", **options}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no place for its cache
        return numba.njit(**options)(function)


def is_cached(function: Any) -> bool:
    """Whether the machine code of a compiled function lies on disk, so that it starts at once."""
    folder = getattr(function.stats, "cache_path", None)
    name = f"{Path(function.py_func.__code__.co_filename).stem}.{function.py_func.__qualname__}-*.nbi"
    return folder is not None and any(Path(folder).glob(name))
