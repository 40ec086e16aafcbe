"""Values in an LMDB database, read by their keys, trusting nothing.

The LMDB library maps the file to memory and follows whatever number stands in it: a damaged one, or a page
that is missing, ends the whole process. Here pages are read, and every number is compared with the file.

    file  = page 0, page 1 (heads, of which the newer counts), pages of the tree, pages of large values
    page  = u64 number | 2 bytes | u16 kind | u16 end of the offsets | 2 bytes | u16 offsets of nodes …
    node  = u32 size | u16 marks | u16 length of the key | key | data, or where they start
    node of a branch = 48 bits of the page below | u16 length of the key | the least key there
"""

from __future__ import annotations

import struct
from bisect import bisect_left, bisect_right
from pathlib import Path

from tracker.errors import LogError
from tracker.files.reading import cannot_read

_PAGE_HEAD = 16
_MAGIC, _VERSION = 0xBEEFC0DE, 1
_HEAD = struct.Struct("<II16x I44x 4xHH24xQQ QQ")
"""Magic, version; of the free pages' table the page size; of the main one marks, depth, entries and root;
number of the last page, of the transaction."""
_NODE = struct.Struct("<HHHH")
_BRANCH, _LEAF, _LARGE = 1, 2, 4  # kinds of pages
_ELSEWHERE = 1  # mark of a node whose data are on pages of their own
_MAX_DEPTH = 32
_NO_PAGE = 2**64 - 1


class LmdbFile:
    """A database without further databases in it, open for reading.

    Raises:
        LogError: the file is no such database, or shorter than it says.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("rb")
            self.size = self._file.seek(0, 2)
        except OSError as error:
            raise cannot_read(path, error) from error
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def get(self, key: str, largest: int) -> bytes | None:
        """The value of a key, or None where there is none.

        Raises:
            LogError: the database is damaged on the way to it, or it has more than `largest` bytes.
        """
        wanted, number = key.encode("ascii"), self._root
        for _ in range(_MAX_DEPTH):
            if number == _NO_PAGE:
                return None
            page = self._page(number)
            keys, nodes = self._nodes(page, number)
            if _kind(page) & _LEAF:
                place = bisect_left(keys, wanted)
                there = place < len(keys) and keys[place] == wanted
                return self._value(page, nodes[place], number, largest) if there else None
            # The first key of a branch is not there: it holds all that is less than the second.
            low, middle, high, _ = _NODE.unpack_from(page, nodes[max(0, bisect_right(keys, wanted, 1) - 1)])
            number = low | middle << 16 | high << 32
        raise self._damaged(f"a tree deeper than {_MAX_DEPTH} pages")

    def _open(self) -> None:
        head = self._read(0, _PAGE_HEAD + _HEAD.size)
        size = _HEAD.unpack_from(head, _PAGE_HEAD)[2] if len(head) == _PAGE_HEAD + _HEAD.size else 0
        if not 512 <= size <= 65536 or size & (size - 1):
            raise self._damaged(f"{self.size} bytes that do not start as an LMDB store does")
        self._page_size = size
        heads = [_HEAD.unpack_from(self._page(number), _PAGE_HEAD) for number in (0, 1)]
        if any(head[:2] != (_MAGIC, _VERSION) for head in heads):
            raise self._damaged("no head of an LMDB store")
        *_, marks, _, self.entries, self._root, last, _ = max(heads, key=lambda head: int(head[-1]))
        if marks:
            raise self._damaged(f"a table of kind {marks}, expected a plain one")
        expected = (last + 1) * size
        if expected > self.size:
            found = f"found {self.size} bytes, expected at least {expected}"
            raise LogError(f"{self._path}: {found}: it is truncated")

    def _nodes(self, page: bytes, number: int) -> tuple[list[bytes], list[int]]:
        """Keys of a page's nodes in order, and where the nodes are in the page."""
        (end,) = struct.unpack_from("<H", page, 12)
        if _kind(page) not in (_BRANCH, _LEAF) or not _PAGE_HEAD < end <= len(page) or end % 2:
            raise self._damaged(f"page {number}, expected nodes")
        nodes = list(struct.unpack_from(f"<{(end - _PAGE_HEAD) // 2}H", page, _PAGE_HEAD))
        keys = []
        for node in nodes:
            if not end <= node <= len(page) - _NODE.size:
                raise self._damaged(f"page {number}: a node at {node}")
            *_, length = _NODE.unpack_from(page, node)
            keys.append(page[node + _NODE.size : node + _NODE.size + length])
        return keys, nodes

    def _value(self, page: bytes, node: int, number: int, largest: int) -> bytes:
        low, high, marks, length = _NODE.unpack_from(page, node)
        size, start = low | high << 16, node + _NODE.size + length
        if marks not in (0, _ELSEWHERE) or size > largest:
            raise self._damaged(f"page {number}: {size} bytes of kind {marks}, expected at most {largest}")
        if not marks:
            value = page[start : start + size]
        elif start + 8 <= len(page):
            (first,) = struct.unpack_from("<Q", page, start)
            if not _kind(self._page(first)) & _LARGE:
                raise self._damaged(f"page {first}, expected a large value")
            value = self._read(first * self._page_size + _PAGE_HEAD, size)
        else:
            value = b""
        if len(value) < size:
            raise self._damaged(f"page {number}: {len(value)} bytes, expected {size}")
        return value

    def _page(self, number: int) -> bytes:
        page = self._read(number * self._page_size, self._page_size)
        if len(page) < self._page_size or struct.unpack_from("<Q", page)[0] != number:
            raise self._damaged(f"page {number} missing")
        return page

    def _read(self, offset: int, size: int) -> bytes:
        if offset >= self.size:
            return b""
        try:
            self._file.seek(offset)
            return self._file.read(min(size, self.size - offset))
        except OSError as error:
            raise cannot_read(self._path, error) from error

    def _damaged(self, found: str) -> LogError:
        return LogError(f"{self._path}: found {found}: it is no LMDB store, or damaged")


def _kind(page: bytes) -> int:
    (marks,) = struct.unpack_from("<H", page, 10)
    return int(marks) & 0x2F
