"""What a Parquet file says of its own columns and pages, read before any library unpacks them.

A page of a kilobyte can say that it unpacks to gigabytes, and the library takes the memory. The file's description and
the head of every page are structures of Thrift's compact protocol; here only their numbers and texts are read.
Format: parquet.thrift (Apache Parquet) and the compact protocol's specification (Apache Thrift).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from motorprior.exceptions import LogError
from motorprior.outside_files import require_file

COPY_AGAIN = "copy or record it again"
MAX_FOOTER = 5_000_000
"""Bytes at the end of a Parquet file that say what is in it."""
MAX_NUMBERS = 60_000_000
"""Of a log: half a gigabyte."""
_MOST_PAGES = 200_000
_MOST_NAMED, _LONGEST = 4, 400
"""Columns that an error names, and its letters."""
_PAGE_HEAD = 8192
"""Most bytes of the head of a page of numbers."""
_BYTES_PER_NUMBER, _BYTES_PER_TEXT, _ROOM, _LARGEST_PAGE = 16, 64, 65_536, 256_000_000
"""A page may unpack to so many bytes per number, or time stamp in letters, of its column and so many more, but to no
more than the last."""
_BEYOND = 100
"""Bytes that the last page may be longer than its column says: old writers forgot its head."""
_DEEPEST, _LARGEST_FIELD = 16, 2**15 - 1
_TRUE, _FALSE, _BYTE, _SHORT, _INTEGER, _LONG, _DOUBLE, _TEXT, _LIST, _SET, _, _STRUCT = range(1, 13)
_BITS = {_SHORT: 16, _INTEGER: 32, _LONG: 64}
_COUNTED = {0: 5, 3: 8}
"""Kind of a page of numbers -> field of its head that counts them (DataPageHeader, DataPageHeaderV2)."""
Fields = Mapping[int, tuple[int, Any]]
"""Number of a field -> its kind and its value."""


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


def require_small_pages(
    path: Path, wanted: Collection[str], texts: Collection[str] = (), most: int | None = None
) -> None:
    """Refuse columns of too many numbers, or with a page that unpacks to more than numbers take.

    Args:
        path: a file that passes `require_parquet`.
        wanted: names of columns; those of lists count with all elements.
        texts: those of them that may hold time stamps as texts, which take more room.
        most: numbers of all these columns together; `MAX_NUMBERS` if not given.

    Raises:
        LogError: so it is, or the description or the head of a page is damaged.
    """
    length = require_parquet(path)
    with open(path, "rb") as file:
        file.seek(-length - 8, 2)
        try:
            footer = _Reader(file.read(length)).structure()
            columns = [each for each in _columns(footer) if each.name in wanted]
            _require_few(footer, columns, MAX_NUMBERS if most is None else most, path)
            for number, page in enumerate(_pages(file, columns)):
                _require_small(page, _BYTES_PER_TEXT if page.column.name in texts else _BYTES_PER_NUMBER, path)
                if number == _MOST_PAGES:
                    remedy = "write it with larger groups of rows"
                    raise LogError(f"more than {_MOST_PAGES} pages", where=path, remedy=remedy)
        except (IndexError, KeyError, TypeError, ValueError) as error:
            problem = "cannot be read (the description of a column is damaged)"
            raise LogError(problem, where=path, remedy=COPY_AGAIN) from error


@dataclass(frozen=True)
class _Column:
    """A column of a group of rows: how many numbers, and the bytes from ``begin`` to ``end`` that hold its pages."""

    name: str
    numbers: int
    begin: int
    end: int


@dataclass(frozen=True)
class _Page:
    """A page of a column: bytes that it says it unpacks to."""

    column: _Column
    unpacked: int


def _require_few(footer: Fields, columns: list[_Column], most: int, path: Path) -> None:
    """Refuse more than ``most`` numbers, FileMetaData.num_rows of them in each column or, of lists, more."""
    if (count := sum(column.numbers for column in columns)) <= most:
        return
    rows = max(1, _get(footer, 3, _LONG))
    per_row = -(-count // rows)
    names = sorted({column.name for column in columns})
    problem = (
        f"more than {most:,} numbers: it has {rows:,} rows of {per_row:,} numbers that are read, and may have "
        f"{most // per_row:,} ({len(names)} columns: {', '.join(names[:_MOST_NAMED])}"
    )
    problem += ", …)" if len(names) > _MOST_NAMED else ")"
    raise LogError(problem[:_LONGEST], where=path, remedy="split the recording")


def _require_small(page: _Page, per_number: int, path: Path) -> None:
    column = page.column
    if page.unpacked > min(per_number * column.numbers + _ROOM, _LARGEST_PAGE):
        problem = f"column {column.name[:80]!r}: a page of {page.unpacked} bytes for {column.numbers} numbers"
        raise LogError(problem, where=path, remedy=COPY_AGAIN)


def _columns(footer: Fields) -> Iterator[_Column]:
    """FileMetaData.row_groups[].columns[].meta_data, in the order of the leaves of FileMetaData.schema."""
    leaves = _leaves(_get(footer, 2, _LIST))
    for group in _get(footer, 4, _LIST):
        for name, chunk in zip(leaves, _get(group, 1, _LIST), strict=True):
            about = _get(chunk, 3, _STRUCT)
            numbers, size, begin = (_get(about, field, _LONG) for field in (5, 7, 9))
            dictionary = _get(about, 11, _LONG) if 11 in about else 0
            if 0 < dictionary < begin:
                begin = dictionary
            if min(numbers, size, begin) < 0:
                raise ValueError("a negative size")
            yield _Column(name, numbers, begin, begin + size)


def _leaves(schema: list[Fields]) -> list[str]:
    """Of every column of numbers the name of the column, of lists or structures, that it belongs to."""
    found: list[str] = []
    open_nodes: list[int] = []
    top = ""
    for index, element in enumerate(schema):
        children = _get(element, 5, _INTEGER) if 5 in element else 0
        if len(open_nodes) == 1:
            top = _get(element, 4, _TEXT).decode()
        if index and children == 0:
            found.append(top)
        if index:
            open_nodes[-1] -= 1
        open_nodes.append(children)
        while len(open_nodes) > 1 and open_nodes[-1] == 0:
            open_nodes.pop()
    return found


def _get(fields: Fields, number: int, kind: int) -> Any:
    """A field's value; one of another kind is none, for the library skips it."""
    found, value = fields[number]
    if found != kind:
        raise ValueError(f"field {number} is of kind {found}")
    return value


def _pages(file: IO[bytes], columns: Iterable[_Column]) -> Iterator[_Page]:
    """PageHeader.uncompressed_page_size of every page; together they have no more numbers than their column."""
    for column in columns:
        if column.numbers == 0:  # its pages are not read, and may be nowhere
            continue
        at, numbers = column.begin, 0
        while at < column.end:
            file.seek(at)
            reader = _Reader(file.read(_PAGE_HEAD))
            head = reader.structure()
            kind, unpacked, packed = (_get(head, field, _INTEGER) for field in (1, 2, 3))
            if kind in _COUNTED:
                numbers += _get(_get(head, _COUNTED[kind], _STRUCT), 1, _INTEGER)
            at += reader.at + packed
            if unpacked < 0 or packed < 0 or numbers > column.numbers or at > column.end + _BEYOND:
                raise ValueError("more than the column says")
            yield _Page(column, unpacked)


class _Reader:
    """Values of Thrift's compact protocol.

    Attributes:
        at: index of the next byte.
    """

    def __init__(self, data: bytes):
        self._data, self.at = data, 0

    def structure(self, depth: int = 0) -> Fields:
        """Its fields, each once.

        Raises:
            IndexError, ValueError: the bytes end early, or are no structure.
        """
        found: dict[int, tuple[int, Any]] = {}
        number = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            number = number + step if step else self._signed(_SHORT)
            if number in found or not 0 < number <= _LARGEST_FIELD:
                raise ValueError(f"field {number}")
            found[number] = kind, kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind, depth + 1)
        return found

    def _value(self, kind: int, depth: int) -> Any:
        if depth > _DEEPEST:
            raise ValueError("too deep")
        if kind in _BITS:
            return self._signed(kind)
        if kind in (_TRUE, _FALSE, _BYTE):  # in a list, a truth value takes a byte
            return self._byte()
        if kind == _TEXT:
            return self._bytes(self._unsigned())
        if kind in (_LIST, _SET):
            return self._list(depth + 1)
        if kind == _STRUCT:
            return self.structure(depth)
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

    def _signed(self, kind: int) -> int:
        value = self._unsigned()
        if value >> _BITS[kind]:
            raise ValueError(f"a number of more than {_BITS[kind]} bits")
        return (value >> 1) ^ -(value & 1)
