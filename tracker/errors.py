"""Errors. All errors that a caller can fix derive from TrackerError."""


class TrackerError(Exception):
    """Base of all errors of this package. The message states what is wrong and what would be valid."""


class CalibrationError(TrackerError):
    """A calibration file or camera parameter is missing, malformed or impossible."""


class ObjectModelError(TrackerError):
    """An object is unknown, or its description is malformed."""


class ColorModelError(TrackerError):
    """A colour model is unknown, or its file is malformed."""


class ImageError(TrackerError):
    """An image is unreadable, or the number, shape, size or type of images is wrong."""


class TaskError(TrackerError):
    """A task's goal, state or masks are malformed or impossible."""


class LogError(TrackerError):
    """A recording or a file of poses is missing, malformed, truncated, damaged or of an unknown format."""


class NotBetterError(TrackerError):
    """A new result is not better than the old one, so it is discarded."""


class LiveError(TrackerError):
    """A source of live images cannot be opened or has failed, or poses cannot be published."""


def install(extra: str) -> str:
    """Return the command that installs an extra, on one line. No package index has this package.

    It installs in place (-e): a copy would be compiled again, and would lack `synthetic` and `benchmarks`.
    """
    return f"python3 -m pip install -e '.[{extra}]' in a clone of the tracker"


def shown(value: object) -> str:
    """Return a short description of a value of any type and size: for arrays, their dtype and shape."""
    if (shape := getattr(value, "shape", ())) and hasattr(value, "dtype"):
        return f"{value.dtype} of shape {shape}"
    if isinstance(value, (dict, list)):
        return f"a {'mapping' if isinstance(value, dict) else 'list'} of {len(value)}"
    if isinstance(value, int) and abs(value) > 10**18:
        return "a whole number above 10^18"  # Python refuses to print very large integers
    try:
        return " ".join(repr(value).split())[:60]
    except ValueError:  # the value contains such an integer
        return f"a {type(value).__name__}"


def message(error: BaseException) -> str:
    """Return an error's message on one line, or its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def reason(error: Exception) -> str:
    """Return an error's message on one line, with the file that the operating system's errors concern."""
    if not isinstance(error, OSError):
        return message(error)
    return " ".join(f"{error.filename or 'output'}: {error.strerror or message(error)}".split())
