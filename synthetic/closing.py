"""A base class for resources that a `with` block closes."""

from typing import TypeVar

Own = TypeVar("Own", bound="Closing")


class Closing:
    """A context manager that closes itself on exit."""

    def close(self) -> None:
        """Release what is held outside of Python."""
        raise NotImplementedError

    def __enter__(self: Own) -> Own:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
