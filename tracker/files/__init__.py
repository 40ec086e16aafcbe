"""Bounded reads, and atomic writes by one process at a time."""

import contextlib
import csv
import errno
import fcntl
import functools
import hashlib
import io
import os
import stat
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import BufferedReader
from pathlib import Path
from typing import Any

from tracker.checks import optional, path_of
from tracker.errors import LogError, TrackerError, shown

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file; here, so that h5py is loaded for such files only."""

_NOT_REGULAR = "found a pipe or a device, expected a regular file"


@contextlib.contextmanager
def on_error(undo: Callable[[], object]) -> Iterator[None]:
    """Call `undo` if the `with` block raises, for instance to close a half-opened file; then re-raise."""
    try:
        yield
    except BaseException:
        undo()
        raise


class OneAtATime:
    """Lets one thread at a time use an open file, only in the process that opened it.

    Forked processes share the position in the file, and would move it for each other.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._process, self._lock = path, os.getpid(), threading.Lock()

    def lock(self) -> threading.Lock:
        """Return the lock to hold, whose with-statement Ctrl-C cannot leave locked; LogError if forked."""
        if os.getpid() != self._process:
            raise LogError(f"{self._path}: was opened in another process, expected to be opened in this one")
        return self._lock


def open_regular(path: str | os.PathLike[str]) -> BufferedReader:
    """Open a regular file for reading; OSError for folders, devices and pipes, even without a writer."""
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
    file = open(path, "rb", opener=lambda name, _: os.open(name, flags))  # noqa: SIM115 - the caller closes it
    with on_error(file.close):
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, _NOT_REGULAR, os.fspath(path))
        return file


def read_bounded(path: str | os.PathLike[str], largest: int) -> bytes:
    """Return the content of a regular file; OSError, without reading all of it, above `largest` bytes."""
    with open_regular(path) as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"found more than {largest} bytes", os.fspath(path))
    return content


def visible(folder: Path) -> Iterator[Path]:
    """Return what is in a folder except hidden files, which editors and Mac file systems leave there."""
    return (item for item in folder.iterdir() if not item.name.startswith("."))


def names_in(folder: Path, suffix: str) -> tuple[str, ...]:
    """Return the sorted names of the files with a suffix in a folder of the package."""
    return tuple(sorted(path.stem for path in folder.glob(f"[!.]*{suffix}")))


def found_by(
    given: object, folder: Path, suffix: str, what: str, fault: type[TrackerError], *, others: bool = False
) -> Path:
    """Return the file with this name in a folder of the package, or the given path; `fault` if neither.

    others: whether an existing file with another suffix counts, too.
    """
    path, names = path_of(given, what, fault), names_in(folder, suffix)
    if str(path) in names:
        return folder / f"{path}{suffix}"
    if path.suffix != suffix and not (others and os.path.exists(path)):
        valid = f"valid are {', '.join(names)}, or the path of a {suffix} file"
        raise fault(f"unknown {what} {shown(str(path))}; {valid}")
    return path


@contextlib.contextmanager
def reading(path: str | os.PathLike[str], fault: Callable[[str], Exception] = LogError) -> Iterator[None]:
    """Turn an OSError raised while a file is read into a `fault` with a one-line message."""
    try:
        yield
    except OSError as error:
        raise fault(f"{os.fspath(path)}: cannot be read: {error.strerror or error}") from error


def check_suffix(path: Path, suffixes: Sequence[str], what: str, fault: type[Exception]) -> None:
    """Raise `fault`, which names `what`, if a file name has none of these suffixes."""
    if path.suffix.lower() not in suffixes:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise fault(f"{what} {path}: found {found}, expected {' or '.join(suffixes)}")


_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EROFS)
"""Errors raised by file systems without locks, such as some network drives."""

_MOST_BYTES = 200
"""Largest part of a file name to keep in names derived from it [bytes]."""


@contextlib.contextmanager
def writing(fault: Callable[[str], Exception], what: str | os.PathLike[str]) -> Iterator[None]:
    """Turn an error from writing `what`, or a file in it, into a `fault` with a one-line message."""
    if not isinstance(what, str | os.PathLike):
        raise fault(f"output: found {shown(what)}, expected a path")
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        if isinstance(error, FileNotFoundError) and isinstance(error.filename, str):
            folder = os.path.dirname(error.filename)
            reason = f"there is no folder {folder}" if folder and not os.path.isdir(folder) else reason
        name = str(getattr(error, "filename", ""))
        where = name if os.path.dirname(name) == os.fspath(what) else os.fspath(what)
        raise fault(f"{where}: cannot be written: {' '.join(str(reason).split())}") from error


def csv_text(header: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table as CSV text; None gives an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def write_whole(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Write a file (text as UTF-8) under a temporary name, then rename it; errors as for `whole_file`."""
    write_together([(path, content)])


def write_together(contents: Iterable[tuple[str | os.PathLike[str], bytes | str]]) -> None:
    """Write pairs of path and content as `write_whole` does, and rename none before all are written."""
    with contextlib.ExitStack() as stack:
        for path, content in contents:
            temporary = stack.enter_context(whole_file(path))
            temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path; the file or new folder there is renamed to `path` if the block does not raise.

    A file is synced to disk before it is renamed, so that a power cut leaves either the old or the new one.
    The files in a new folder are not. A symbolic link is kept: its target is replaced.

    Raises:
        OSError: the file cannot be written, or is a pipe or a device, such as /dev/null, which a superuser
            would replace; the old one is unchanged.
        ValueError: the path is invalid, for instance because of a null byte.
    """
    target = Path(os.path.realpath(path))
    if os.path.exists(target) and not (os.path.isfile(target) or os.path.isdir(target)):
        raise OSError(errno.EINVAL, _NOT_REGULAR, os.fspath(path))
    # Use a temporary folder, not a temporary file, so that the file gets its usual permissions.
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
def parquet_file(path: str | os.PathLike[str]) -> Iterator[Callable[[Any], object]]:
    """Yield a function that appends pyarrow's tables of one schema; the file appears as in `whole_file`."""
    new = functools.partial(optional("pyarrow.parquet", None, "this").ParquetWriter, compression="zstd")
    # Open the file here: pyarrow takes no path that is not UTF-8.
    with whole_file(path) as temporary, temporary.open("wb") as file, contextlib.ExitStack() as stack:
        writer = functools.cache(lambda schema: stack.enter_context(new(file, schema)))
        yield lambda table: writer(table.schema).write_table(table)


@contextlib.contextmanager
def claimed(path: str | os.PathLike[str]) -> Iterator[None]:
    """Lock a file for writing until the `with` block or the process ends; other callers get an error.

    The lock is on a hidden file beside it, which is removed at the end. File systems without locks give no
    protection. (filelock would save forty lines, but add a dependency to the core.)

    Raises:
        BlockingIOError: another run has locked the file.
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
        # Remove it while it is locked: a process that already has it open then notices that it is gone.
        lock.unlink(missing_ok=True)
        os.close(descriptor)


def lock_of(path: str | os.PathLike[str]) -> Path:
    """Return the hidden lock file beside a file; it exists while a process has `claimed` that file."""
    target = Path(os.path.realpath(path))
    return target.with_name(f".{_beginning(target.name)}.lock")


def _beginning(name: str) -> str:
    """Shorten a name so that a suffix still fits: file systems allow 255 bytes. A hash keeps it unique."""
    encoded = os.fsencode(name)
    if len(encoded) <= _MOST_BYTES:
        return name
    return f"{encoded[:_MOST_BYTES].decode('utf-8', 'ignore')}-{hashlib.sha256(encoded).hexdigest()[:12]}"


def _locked(lock: Path) -> int:
    """Create and lock the lock file; return its descriptor once the locked file still has this name."""
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
    except PermissionError:  # a folder that is writable but not readable
        if path.is_dir():
            return
        raise
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, *_NO_LOCKS):  # some file systems cannot sync folders
            raise
    finally:
        os.close(descriptor)


def _about(error: OSError, path: str | os.PathLike[str]) -> OSError:
    """Return the error with the requested path in place of a temporary or missing file name."""
    name = str(error.filename or ".tmp")
    own = name.endswith((".tmp", ".lock")) or ".tmp/" in name
    return OSError(error.errno, error.strerror, os.fspath(path)) if error.errno and own else error
