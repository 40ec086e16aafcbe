"""Bounded reads, atomic writes, by one process at a time."""

from __future__ import annotations

import contextlib
import csv
import errno
import fcntl
import io
import os
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import BufferedReader
from pathlib import Path

from tracker.errors import LogError


@contextlib.contextmanager
def on_error(undo: Callable[[], object]) -> Iterator[None]:
    """Whatever is raised, `undo` is called before it goes on, for instance to close what is half open."""
    try:
        yield
    except BaseException:
        undo()
        raise


def open_regular(path: str | os.PathLike[str]) -> BufferedReader:
    """A regular file, open for reading; nothing is waited for, as a pipe without a writer would.

    Raises:
        OSError: the file cannot be opened, or is a folder, a pipe or a device.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with on_error(lambda: os.close(handle)):
        kind = os.fstat(handle).st_mode
        if stat.S_ISDIR(kind):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
        if not stat.S_ISREG(kind):
            raise OSError(errno.EINVAL, "found a pipe or a device, expected a regular file", os.fspath(path))
        return os.fdopen(handle, "rb")


def read_bounded(path: str | os.PathLike[str], largest: int) -> bytes:
    """The content of a regular file of at most `largest` bytes; no more are read of one that has more.

    Raises:
        OSError: the file cannot be read, is no regular file, or is larger.
    """
    with open_regular(path) as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"found more than {largest} bytes", os.fspath(path))
    return content


@contextlib.contextmanager
def told_of(path: str | os.PathLike[str], fault: Callable[[str], Exception] = LogError) -> Iterator[None]:
    """What the operating system refuses while a file is read is raised as `fault`, in one line."""
    try:
        yield
    except OSError as error:
        raise fault(f"{os.fspath(path)}: cannot be read: {error.strerror or error}") from error


def check_suffix(path: Path, suffixes: Sequence[str], what: str, fault: type[Exception]) -> None:
    """`fault`, which names `what`, for a file whose name says that it is of none of these kinds."""
    if path.suffix.lower() not in suffixes:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise fault(f"{what} {path}: found {found}, expected {' or '.join(suffixes)}")


_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EROFS)
"""What file systems say that have no locks, as some network drives."""

_MOST_BYTES = 200
"""Of a name, in one that is made from it."""


@contextlib.contextmanager
def told_as(fault: Callable[[str], Exception], what: str | os.PathLike[str]) -> Iterator[None]:
    """What the operating system refuses while `what` is written is raised as `fault`, in one line."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        if isinstance(error, FileNotFoundError) and isinstance(error.filename, str):
            folder = os.path.dirname(error.filename)
            reason = f"there is no folder {folder}" if folder and not os.path.isdir(folder) else reason
        raise fault(f"{os.fspath(what)}: cannot be written: {' '.join(str(reason).split())}") from error


def csv_text(header: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table as CSV; cells of None are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def write_whole(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Write a file, text as UTF-8, under a temporary name, then rename it; errors as for `whole_file`."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path; the file or new folder that is there when the `with` block ends well takes the name.

    It is on the disk before it has its name, so that a power cut leaves the old or the new one. A symbolic
    link stays one: what it points to is replaced.

    Raises:
        OSError: the file cannot be written; what was there before is untouched.
        ValueError: the path is none, for instance because of a null byte.
    """
    target = Path(os.path.realpath(path))
    # A folder of its own, so that the file gets the permissions that it would get without us.
    prefix = f".{_beginning(target.name)}."
    try:
        with tempfile.TemporaryDirectory(".tmp", prefix, target.parent, ignore_cleanup_errors=True) as folder:
            temporary = Path(folder) / target.name
            yield temporary
            _to_disk(temporary)
            os.replace(temporary, target)
            _to_disk(target.parent)
    except OSError as error:
        raise _about(error, path) from error


@contextlib.contextmanager
def claimed(path: str | os.PathLike[str]) -> Iterator[None]:
    """Nobody else who asks may write this file until the `with` block ends, however it or the process ends.

    The claim is a lock on a hidden file beside it, gone at the end. On file systems that have no locks
    there is none. (filelock would be one more dependency of the core, for forty lines.)

    Raises:
        BlockingIOError: another run has claimed it.
        OSError: the folder is missing or cannot be written.
    """
    lock = lock_of(path)
    try:
        descriptor = _locked(lock)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, "another run is writing it", os.fspath(path)) from error
    except OSError as error:
        raise _about(error, path) from error
    try:
        yield
    finally:
        # While it is still locked: another process that has it open sees that it has gone.
        lock.unlink(missing_ok=True)
        os.close(descriptor)


def lock_of(path: str | os.PathLike[str]) -> Path:
    """The hidden file beside a file, which exists while a process has claimed that file."""
    target = Path(os.path.realpath(path))
    return target.with_name(f".{_beginning(target.name)}.lock")


def _beginning(name: str) -> str:
    """So much of a name that something can be added: file systems count bytes, and allow for 255."""
    encoded = os.fsencode(name)
    return name if len(encoded) <= _MOST_BYTES else encoded[:_MOST_BYTES].decode("utf-8", "ignore")


def _locked(lock: Path) -> int:
    """Descriptor of the lock's file, which is locked and has this name."""
    while True:
        with contextlib.ExitStack() as undo:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
            undo.callback(os.close, descriptor)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.stat()):
                    undo.pop_all()
                    return descriptor


def _to_disk(path: Path) -> None:
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except PermissionError:  # a folder that may be written but not read
        if path.is_dir():
            return
        raise
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, *_NO_LOCKS):  # some file systems cannot for folders
            raise
    finally:
        os.close(descriptor)


def _about(error: OSError, path: str | os.PathLike[str]) -> OSError:
    """The error with the name of the file that was asked for, where it names a temporary one or none."""
    name = os.fspath(error.filename) if isinstance(error.filename, (str, os.PathLike)) else None
    if error.errno is None or (
        name is not None and not name.endswith((".tmp", ".lock")) and ".tmp/" not in name
    ):
        return error
    return OSError(error.errno, error.strerror, os.fspath(path))
