"""What is closed at the end of a `with` block."""

from __future__ import annotations

from typing import TypeVar

Own = TypeVar("Own", bound="Closing")


class Closing:
    """A context manager that closes itself."""

    def close(self) -> None:
        """Give back what is held outside of Python."""
        raise NotImplementedError

    def __enter__(self: Own) -> Own:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
