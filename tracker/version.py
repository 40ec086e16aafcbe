"""The version of this package."""

from __future__ import annotations


def version() -> str:
    """As its metadata say, or `(not installed)` where it runs from a checkout."""
    from importlib import metadata  # takes longer to load than most commands take to fail

    try:
        return metadata.version("trifinger-object-tracker")
    except metadata.PackageNotFoundError:
        return "(not installed)"
