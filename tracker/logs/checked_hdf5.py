"""Access to HDF5 files in which nothing is believed without a look.

Type and shape are compared before anything is read, and texts are of fixed length: those of variable
length lie in a heap without a checksum, and damage to it can make the HDF5 library search without end.
"""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from tracker.conventions import Array
from tracker.errors import LogError

TYPES = {
    "f": "floating-point numbers",
    "iu": "whole numbers",
    "u": "unsigned numbers",
    "b": "bool",
    "S": "texts of fixed length",
}
"""NumPy's letters of types, and what they are in messages."""


def dataset(file: Any, name: str) -> Any:
    """The dataset of that name, with nothing read yet.

    Raises:
        LogError: there is none.
    """
    found = file.get(name)
    if not isinstance(found, h5py.Dataset):
        what = "nothing" if found is None else f"a {type(found).__name__.lower()}"
        raise LogError(f"/{name}: found {what}, expected a dataset")
    return found


def array(file: Any, name: str, shape: tuple[int, ...], kinds: str) -> Array:
    """The values of a dataset.

    Args:
        file: file or group.
        name: of the dataset.
        shape: the only valid one.
        kinds: of valid types, a key of TYPES.

    Raises:
        LogError: there is no such dataset, or it is of another type or shape.
    """
    stored = dataset(file, name)
    if stored.dtype.kind not in kinds or stored.shape != shape:
        found = f"{stored.dtype} of shape {stored.shape}"
        raise LogError(f"/{name}: found {found}, expected {TYPES[kinds]} of shape {shape}")
    return np.asarray(stored[()])


def attribute(item: Any, name: str, kinds: str, shape: tuple[int, ...] | None) -> Array:
    """The value of an attribute of a file, group or dataset.

    Args:
        item: what has the attribute.
        name: of the attribute.
        kinds: of valid types, a key of TYPES.
        shape: the only valid one; None: a list of any length.

    Raises:
        LogError: there is no such attribute, or it is of another type or shape.
    """
    wanted = TYPES[kinds] + ("" if shape == () else ", a list of them")
    if name not in item.attrs:
        raise LogError(f"{name}: found no such attribute, expected {wanted}")
    stored = item.attrs.get_id(name)
    if stored.dtype.kind not in kinds or (len(stored.shape) != 1 if shape is None else stored.shape != shape):
        raise LogError(f"{name}: found {stored.dtype} of shape {stored.shape}, expected {wanted}")
    return np.asarray(item.attrs[name])


def text(file: Any, key: str) -> str:
    """The text in an attribute; LogError where there is none."""
    return decoded(attribute(file, key, "S", ()))[0]


def encoded(texts: list[str]) -> Array:
    """Texts as an array (k,) of UTF-8 of one length, without null characters."""
    contents = [text.encode("utf-8") for text in texts]
    return np.array(contents, dtype=f"S{max(map(len, contents), default=0) or 1}")


def encoded_text(text: str) -> Array:
    """A single text, as an array without axes."""
    return encoded([text]).reshape(())


def decoded(texts: Array) -> list[str]:
    """The texts in an array of UTF-8; UnicodeDecodeError where it is none."""
    return [bytes(text).decode("utf-8") for text in texts.ravel().tolist()]
