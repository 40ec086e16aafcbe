"""The version of this package."""


def version() -> str:
    """Return the version from the package's metadata, or `(not installed)` if it runs from a checkout."""
    from importlib import metadata  # slow to import: most commands fail in less time

    try:
        return metadata.version("trifinger-object-tracker")
    except metadata.PackageNotFoundError:
        return "(not installed)"
