"""Tables of text, plain or gzip, in blocks of a few megabytes, each read by pyarrow: the one way to read a CSV file.

Cells stand between commas, semicolons or tabs, as the first line has it. A number has a decimal point, or, where cells
do not stand between commas, a decimal comma in the whole file.
"""

from __future__ import annotations

import csv
import gzip
import math
import re
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from motorprior.exceptions import LogError, shown
from motorprior.outside_files import require_file

READ = "UTF-8, cells between commas, semicolons or tabs, numbers like -1.5e-3 (or -1,5e-3 between semicolons or tabs)"
"""What is read, for messages."""
_CR_ALONE = "a line end that is CR alone: save with LF or CRLF"
_OPEN = "a quote is opened in row {} and not closed"
_AGAIN = "copy the file again from its source"
_BLOCK, _LONGEST_LINE = 4_000_000, 1_000_000
_MOST_COLUMNS = 10_000
_MOST_UNPACKED, _MOST_TIMES, _MOST_EVER = 100_000_000, 200, 500_000_000
"""A gzip file may unpack to so many bytes, or to so many times its own, but to no more than the last; motor logs pack
to a tenth."""
_DELIMITERS = ",;\t"
_QUOTED = re.compile(r'"[^"]*"')
_NUMBER = re.compile(r"[+-]?((\d+[.]?\d*|[.]\d+)(e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE | re.ASCII)


@dataclass(frozen=True)
class CsvHead:
    """The names of the columns, in the order of the file, and what stands between cells."""

    names: tuple[str, ...]
    delimiter: str


def csv_head(path: Path) -> CsvHead:
    """What the first line says.

    Raises:
        LogError: no file, damaged, no text in UTF-8, or a first line that is too long.
    """
    with _opened(path) as file:
        return _head(file, path)


def csv_batches(path: Path, wanted: list[str], texts: Collection[str] = (), may_be_cut: bool = False) -> Iterator[Any]:
    """Arrow batches of some columns, of consecutive rows.

    Args:
        path: ``.csv``, or gzip where the name ends in ``.gz``.
        wanted: their names.
        texts: those whose cells come as they stand in the file, not as numbers.
        may_be_cut: its writer may have been killed; a last line without an end does not count.

    Raises:
        LogError: as `csv_head`; a row with too few or too many cells, a cell that is no number (row from 0, column,
            value), a line that is too long, or more text than a motor log packs into its bytes.
    """
    rows, decimal = 0, ""
    with _opened(path) as file:
        head = _head(file, path)
        for block in _blocks(file, path, may_be_cut):
            table, decimal = _read(block, head, wanted, texts, decimal, rows, path)
            rows += table.num_rows
            yield from table.to_batches()


def _opened(path: Path) -> IO[bytes]:
    require_file(path, LogError)
    try:
        return gzip.open(path, "rb") if path.suffix == ".gz" else open(path, "rb")  # type: ignore[return-value]
    except OSError as error:
        raise LogError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error


def _line(file: IO[bytes], path: Path) -> bytes:
    """The rest of a line."""
    try:
        line = file.readline(_LONGEST_LINE + 1)
    except (EOFError, zlib.error, OSError) as error:
        raise LogError(f"truncated or damaged file ({error})", where=path, remedy=_AGAIN) from error
    if len(line) > _LONGEST_LINE:
        problem = f"it has {_CR_ALONE}" if b"\r" in line else f"a line of more than {_LONGEST_LINE} bytes"
        raise LogError(problem, where=path, remedy=f"give a table: {READ}")
    return line


def _head(file: IO[bytes], path: Path) -> CsvHead:
    line = _line(file, path)
    if not line:
        raise LogError("the file is empty", where=path, remedy=_AGAIN)
    try:
        text = line.decode("utf-8-sig").strip("\r\n")
        if "\0" in text:
            raise ValueError("it holds the character 0")
        if "\r" in text:
            raise LogError(f"it has {_CR_ALONE}", where=path, remedy=f"save it as {READ}")
        delimiter = max(_DELIMITERS, key=_QUOTED.sub("", text).count)
        names = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    except UnicodeDecodeError as error:
        raise LogError(f"not UTF-8 ({error})", where=path, remedy=f"save it as {READ}") from error
    except (ValueError, csv.Error) as error:
        raise LogError(f"not a text file in UTF-8 ({error})", where=path, remedy=f"save it as {READ}") from error
    if len(names) > _MOST_COLUMNS:
        raise LogError(f"{len(names)} columns, more than {_MOST_COLUMNS}", where=path, remedy="leave columns out")
    return CsvHead(tuple(name.strip() for name in names), delimiter)


def _blocks(file: IO[bytes], path: Path, may_be_cut: bool) -> Iterator[bytes]:
    """Whole lines."""
    size, done = path.stat().st_size, 0
    most = min(max(_MOST_UNPACKED, _MOST_TIMES * size), _MOST_EVER) if path.suffix == ".gz" else math.inf
    while block := _block(file, path):
        done += len(block)
        if done > most:
            raise LogError(f"unpacks to more than {most} bytes", where=path, remedy="pack the table of a motor log")
        if may_be_cut and not block.endswith(b"\n"):
            block = block[: block.rfind(b"\n") + 1]
        if block.strip():
            yield block
        elif len(block) >= _BLOCK:
            raise LogError(f"{len(block)} bytes of empty lines", where=path, remedy=_AGAIN)


def _block(file: IO[bytes], path: Path) -> bytes:
    try:
        block = file.read(_BLOCK)
    except (EOFError, zlib.error, OSError) as error:
        raise LogError(f"truncated or damaged file ({error})", where=path, remedy=_AGAIN) from error
    return block if block.endswith(b"\n") or len(block) < _BLOCK else block + _line(file, path)


def _read(
    block: bytes, head: CsvHead, wanted: list[str], texts: Collection[str], decimal: str, before: int, path: Path
) -> tuple[Any, str]:
    """The wanted columns, and the sign before decimals, "" as long as there are none."""
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    numbers = [name for name in wanted if name not in texts]
    kinds = {name: pa.float64() if name in numbers else pa.string() for name in wanted}
    possible = decimal or ("." if head.delimiter == "," or not numbers else ".,")
    said = ""
    for sign in possible:
        try:
            found = pa_csv.read_csv(
                pa.py_buffer(block),
                pa_csv.ReadOptions(column_names=list(head.names), block_size=2 * _BLOCK, use_threads=False),
                pa_csv.ParseOptions(delimiter=head.delimiter),
                pa_csv.ConvertOptions(
                    include_columns=wanted, column_types=kinds, null_values=[""],
                    decimal_point=sign,
                ),
            )  # fmt: skip
        except pa.ArrowException as error:
            said = str(error)
            continue
        if not any(column.null_count for column in found.columns):
            if block.count(b'"') % 2 and (error := _first_bad_row(block, head, (), decimal, before, path)):
                raise error  # or the rows that it swallows would be missing
            return found, sign if sign.encode() in block else decimal
    problem = f"the rows from {before} on cannot be read ({said})"
    otherwise = LogError(problem, where=path, remedy=_AGAIN)
    raise _first_bad_row(block, head, numbers, decimal, before, path) or otherwise


def _first_bad_row(
    block: bytes, head: CsvHead, numbers: Collection[str], decimal: str, before: int, path: Path
) -> LogError | None:
    """The error for the first row that is not as many cells as there are columns, or whose cell is no number."""
    columns = [(head.names.index(name), name) for name in numbers]
    row, lines, remedy = before, 1, f"correct the row; read are {READ}"
    for cells, lines, problem in _rows(block, head.delimiter):
        if not problem:
            problem, decimal = _problem(cells, head, columns, decimal)
        if problem:
            problem = _OPEN.format(row) if lines > 1 else f"row {row}{problem}"
            return LogError(problem, where=path, remedy=remedy)
        row += 1
    still_open = lines > 1 and block.count(b'"') % 2  # the last row went on to the end
    return LogError(_OPEN.format(row - 1), where=path, remedy=remedy) if still_open else None


def _rows(block: bytes, delimiter: str) -> Iterator[tuple[list[str], int, str]]:
    """Cells of every row, the lines that it takes, and what makes it unreadable; nothing follows such a row."""
    lines = block.decode("utf-8", errors="replace").split("\n")
    reader = csv.reader([*lines, ""], delimiter=delimiter)  # the last: a quote that stays open takes a line more
    before = 0
    try:
        for cells in reader:
            if cells:
                yield cells, reader.line_num - before, ""
            before = reader.line_num
    except csv.Error as error:
        alone = "\r" in lines[before].rstrip("\r")
        yield [], reader.line_num - before, f" has {_CR_ALONE}" if alone else f" cannot be read ({error})"


def _problem(cells: list[str], head: CsvHead, columns: list[tuple[int, str]], decimal: str) -> tuple[str, str]:
    """What is wrong with a row, nothing if nothing is, and the sign before decimals as far as it is known."""
    if len(cells) != len(head.names):
        return f" has {len(cells)} cells, expected {len(head.names)}", decimal
    for index, name in columns:
        cell, signs = cells[index].strip(" \t"), decimal or (".," if head.delimiter != "," else ".")
        if not any(_is_number(cell, sign) for sign in signs):
            return f", {name} is {shown(cell)}, not a number", decimal
        decimal = decimal or next((sign for sign in signs if sign in cell), "")
    return "", decimal


def _is_number(cell: str, sign: str) -> bool:
    plain = cell if sign == "." else cell.replace(".", "_").replace(sign, ".")
    return _NUMBER.fullmatch(plain) is not None
