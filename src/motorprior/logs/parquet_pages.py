"""What a Parquet file says of its own columns and pages, read before any library unpacks them.

A page of a kilobyte can say that it unpacks to gigabytes, and the library takes the memory. The file's description and
the head of every page are structures of Thrift's compact protocol; here only their numbers and texts are read.
Format: parquet.thrift (Apache Parquet) and the compact protocol's specification (Apache Thrift).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from motorprior.exceptions import LogError
from motorprior.outside_files import require_file

COPY_AGAIN = "copy or record it again"
MAX_FOOTER = 2_000_000
"""Bytes at the end of a Parquet file that say what is in it."""
MAX_NUMBERS = 60_000_000
"""Of a log: half a gigabyte."""
_MOST_PAGES = 200_000
_PAGE_HEAD = 8192
"""Most bytes of the head of a page of numbers."""
_BYTES_PER_NUMBER, _ROOM = 16, 65_536
"""A page may unpack to so many bytes per number of its column, and so many more."""
_DEEPEST = 16
_TRUE, _FALSE, _BYTE = range(1, 4)
_DOUBLE, _TEXT, _LIST, _SET, _, _STRUCT = range(7, 13)
_INTEGERS = (4, 5, 6)


def require_parquet(path: Path) -> int:
    """The length [bytes] of the description at its end; what is no Parquet file, or says too much, is refused.

    Raises:
        LogError: no file, not a Parquet file, or a description of more than `MAX_FOOTER` bytes.
    """
    size = require_file(path, LogError)
    with open(path, "rb") as file:
        file.seek(max(0, size - 8))
        end = file.read(8)
    length = int.from_bytes(end[:4], "little")
    if end[4:] != b"PAR1" or length > size - 8:
        raise LogError("not a complete Parquet file (its end is no Parquet file's)", where=path, remedy=COPY_AGAIN)
    if length > MAX_FOOTER:
        problem = f"it has {length} bytes of description, more than {MAX_FOOTER}"
        raise LogError(problem, where=path, remedy="write it with fewer columns and larger groups of rows")
    return length


def require_small_pages(path: Path, wanted: Collection[str]) -> None:
    """Refuse columns of more than `MAX_NUMBERS` numbers, or with a page that unpacks to more than numbers take.

    Args:
        path: a file that passes `require_parquet`.
        wanted: names of columns; those of lists count with all elements.

    Raises:
        LogError: so it is, or the description or the head of a page is damaged.
    """
    length = require_parquet(path)
    with open(path, "rb") as file:
        file.seek(-length - 8, 2)
        try:
            columns = [each for each in _columns(_Reader(file.read(length)).structure()) if each.name in wanted]
            if (count := sum(column.numbers for column in columns)) > MAX_NUMBERS:
                problem = f"{count} numbers in {', '.join(sorted(wanted))}, more than {MAX_NUMBERS}"
                raise LogError(problem, where=path, remedy="split the recording")
            for number, (column, unpacked) in enumerate(_pages(file, columns)):
                if unpacked > _BYTES_PER_NUMBER * column.numbers + _ROOM:
                    problem = f"column {column.name[:80]!r}: a page of {unpacked} bytes for {column.numbers} numbers"
                    raise LogError(problem, where=path, remedy=COPY_AGAIN)
                if number == _MOST_PAGES:
                    remedy = "write it with larger groups of rows"
                    raise LogError(f"more than {_MOST_PAGES} pages", where=path, remedy=remedy)
        except (IndexError, KeyError, TypeError, ValueError, AttributeError) as error:
            problem = "cannot be read (the description of a column is damaged)"
            raise LogError(problem, where=path, remedy=COPY_AGAIN) from error


@dataclass(frozen=True)
class _Column:
    """A column of a group of rows: how many numbers, and the bytes from ``begin`` to ``end`` that hold its pages."""

    name: str
    numbers: int
    begin: int
    end: int


def _columns(footer: dict[int, Any]) -> Iterator[_Column]:
    """FileMetaData.row_groups[].columns[].meta_data."""
    for group in footer[4]:
        for chunk in group[1]:
            about = chunk[3]
            begin, dictionary = about[9], about.get(11, 0)
            if 0 < dictionary < begin:
                begin = dictionary
            if min(about[5], about[7], begin) < 0:
                raise ValueError("a negative size")
            yield _Column(about[3][0].decode(), about[5], begin, begin + about[7])


def _pages(file: IO[bytes], columns: Iterable[_Column]) -> Iterator[tuple[_Column, int]]:
    """Bytes that each page of the columns says it unpacks to (PageHeader.uncompressed_page_size)."""
    for column in columns:
        if column.numbers == 0:  # its pages are not read, and may be nowhere
            continue
        at = column.begin
        while at < column.end:
            file.seek(at)
            reader = _Reader(file.read(_PAGE_HEAD))
            head = reader.structure()
            unpacked, packed = head[2], head[3]
            if unpacked < 0 or packed < 0:
                raise ValueError("a negative size")
            yield column, unpacked
            at += reader.at + packed


class _Reader:
    """Values of Thrift's compact protocol.

    Attributes:
        at: index of the next byte.
    """

    def __init__(self, data: bytes):
        self._data, self.at = data, 0

    def structure(self, depth: int = 0) -> dict[int, Any]:
        """Number of every field -> its value.

        Raises:
            IndexError, ValueError: the bytes end early, or are no structure.
        """
        if depth > _DEEPEST:
            raise ValueError("too deep")
        found: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            number = number + step if step else self._signed()
            found[number] = kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind, depth)
        return found

    def _value(self, kind: int, depth: int) -> Any:
        if kind in _INTEGERS:
            return self._signed()
        if kind in (_TRUE, _FALSE, _BYTE):  # in a list, a truth value takes a byte
            return self._byte()
        if kind == _TEXT:
            return self._bytes(self._unsigned())
        if kind in (_LIST, _SET):
            return self._list(depth)
        if kind == _STRUCT:
            return self.structure(depth + 1)
        if kind == _DOUBLE:
            return self._bytes(8)
        raise ValueError(f"a value of kind {kind}")

    def _list(self, depth: int) -> list[Any]:
        head = self._byte()
        size, kind = head >> 4, head & 15
        size = self._unsigned() if size == 15 else size
        if size > len(self._data):
            raise ValueError("a list longer than the file")
        return [self._value(kind, depth) for _ in range(size)]

    def _byte(self) -> int:
        value = self._data[self.at]
        self.at += 1
        return value

    def _bytes(self, count: int) -> bytes:
        if self.at + count > len(self._data):
            raise IndexError("a text longer than the file")
        self.at += count
        return self._data[self.at - count : self.at]

    def _unsigned(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7
            if shift > 63:
                raise ValueError("a number of more than 64 bits")

    def _signed(self) -> int:
        value = self._unsigned()
        return (value >> 1) ^ -(value & 1)
