"""Errors: every fault that a caller can mend derives from TrackerError."""

from __future__ import annotations


class TrackerError(Exception):
    """Base of all errors of this package; its message names the offender and what would be valid."""


class CalibrationError(TrackerError):
    """A calibration file or camera parameter is missing, malformed or impossible."""


class ObjectModelError(TrackerError):
    """An object is unknown, or its description is malformed."""


class ColorModelError(TrackerError):
    """A colour model is unknown, or its file is malformed."""


class ImageError(TrackerError):
    """An image is unreadable, or of the wrong count, shape, size or type."""


class TaskError(TrackerError):
    """A task's goal, state or masks are malformed or impossible."""


class LogError(TrackerError):
    """A recording or a file of poses is missing, malformed, truncated or damaged, or of an unknown kind."""


class NotBetterError(TrackerError):
    """What was found is no better than what there was before, so it is not kept."""


class LiveError(TrackerError):
    """A source of live images cannot be opened or goes no further, or poses cannot be handed on."""


def install(extra: str) -> str:
    """How to get the packages of one of this package's extras, in one line; no index has this package.

    In place (-e), since a copy would be compiled again, and `synthetic` and `benchmarks` are in no copy.
    """
    return f"python3 -m pip install -e '.[{extra}]' in a clone of the tracker"


def shown(value: object) -> str:
    """A short description of a value of any type, whatever its size."""
    if isinstance(value, (dict, list)):
        return f"a {'mapping' if isinstance(value, dict) else 'list'} of {len(value)}"
    if isinstance(value, int) and abs(value) > 10**18:
        return "a whole number above 10^18"  # Python refuses to print very large ones
    try:
        return " ".join(repr(value).split())[:60]
    except ValueError:  # of such a number inside
        return f"a {type(value).__name__}"


def reason(error: Exception) -> str:
    """What an error says, in one line."""
    text = str(error)
    if isinstance(error, OSError):
        text = f"{error.filename or 'output'}: {error.strerror or error}"
    return " ".join(text.split()) or type(error).__name__
