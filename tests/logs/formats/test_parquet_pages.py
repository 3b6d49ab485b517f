"""Pages of a Parquet file are looked at before they are unpacked: what all writers write passes, bombs do not."""

import struct
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.formats.parquet_pages import MAX_FOOTER, require_parquet, require_small_pages
from motorprior.logs.formats.table_columns import table_columns

ROWS = 50_000
BIG = 1_900_000_000
INTEGER, LONG, TEXT, LIST, STRUCTURE = 5, 6, 8, 9, 12
"""Kinds of Thrift's compact protocol."""


@pytest.mark.parametrize("compression", ["none", "snappy", "gzip", "brotli", "lz4", "zstd"])
@pytest.mark.parametrize("dictionary", [False, True])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_what_writers_write_passes(tmp_path: Path, compression: str, dictionary: bool, version: str):
    path = tmp_path / "x.parquet"
    lists = pa.FixedSizeListArray.from_arrays(np.zeros(6 * ROWS), 6)
    table = pa.table(
        {"t": np.arange(ROWS, dtype=float), "flat": np.ones(ROWS, "f4"), "list": lists, "word": ["x"] * ROWS}
    )
    pq.write_table(
        table, path, compression=compression, use_dictionary=dictionary, data_page_version=version,
        write_page_index=True, row_group_size=20_000, data_page_size=10_000, write_page_checksum=True,
    )  # fmt: skip
    require_small_pages(path, {"t", "flat", "list"})
    read = [batch["list[5]"] for batch in table_columns(path, ["t", "flat", "list[5]"])]
    assert sum(map(len, read)) == ROWS


@pytest.mark.parametrize("rows", [0, 1])
def test_a_file_of_hardly_any_rows_passes(tmp_path: Path, rows: int):
    pq.write_table(pa.table({"t": np.zeros(rows)}), tmp_path / "x.parquet")
    require_small_pages(tmp_path / "x.parquet", {"t"})


def test_more_numbers_than_a_log_may_have_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("motorprior.logs.formats.parquet_pages.MAX_NUMBERS", 99)
    pq.write_table(pa.table({"t": np.zeros(50), "x": np.zeros(50), "y": np.zeros(50)}), tmp_path / "x.parquet")
    require_small_pages(tmp_path / "x.parquet", {"x"})
    with pytest.raises(
        LogError, match=r"more than 99 numbers: it has 50 rows of 2 numbers .* may have 49 \(2 columns: t, x\)"
    ):
        require_small_pages(tmp_path / "x.parquet", {"t", "x"})


def test_a_table_of_a_robot_says_first_how_many_rows_it_may_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("motorprior.logs.formats.parquet_pages.MAX_NUMBERS", 99)
    names = [f"commanded_position_of_the_joint_{joint}" for joint in range(25)]
    pq.write_table(pa.table(dict.fromkeys(names, np.zeros(4))), tmp_path / "x.parquet")
    with pytest.raises(LogError, match=r"4 rows of 25 numbers .* may have 3 \(25 columns: .*, …\)") as refusal:
        require_small_pages(tmp_path / "x.parquet", set(names))
    assert len(str(refusal.value)) < 500


def number(value: int) -> bytes:
    """Zigzag, seven bits a byte."""
    value, found = 2 * value, b""
    while value > 127:
        found, value = found + bytes([value & 127 | 128]), value >> 7
    return found + bytes([value])


def integers(**fields: int) -> bytes:
    """Fields of a structure by number, as in ``integers(f1=0, f2=5)``."""
    found, last = b"", 0
    for name, value in fields.items():
        found += bytes([(int(name[1:]) - last) << 4 | INTEGER]) + number(value)
        last = int(name[1:])
    return found


def page(unpacked: int = BIG, packed: int = 8, numbers: int = 2, more: bytes = b"") -> bytes:
    """Its head."""
    counted = bytes([2 << 4 | STRUCTURE]) + integers(f1=numbers, f2=0, f3=3, f4=3) + b"\0"
    return integers(f1=0, f2=unpacked, f3=packed) + counted + more + b"\0"


def bomb(path: Path, head: bytes, name: bytes = b"t", leaf_name: bytes = b"t") -> None:
    """A column of two numbers, in a page that says that it unpacks to gigabytes."""
    chunk = integers(f1=5) + bytes([1 << 4 | LIST, 1 << 4 | INTEGER, 0])  # type, encodings
    chunk += bytes([1 << 4 | LIST, 1 << 4 | TEXT, len(name)]) + name  # path
    chunk += bytes([1 << 4 | INTEGER]) + number(6) + bytes([1 << 4 | LONG]) + number(2)  # zstd, numbers
    chunk += bytes([1 << 4 | LONG]) + number(16) + bytes([1 << 4 | LONG]) + number(len(head) + 8)  # its sizes
    chunk += bytes([2 << 4 | LONG]) + number(4) + b"\0"  # where its pages begin
    column = bytes([2 << 4 | LONG]) + number(4) + bytes([1 << 4 | STRUCTURE]) + chunk + b"\0"
    group = bytes([1 << 4 | LIST, 1 << 4 | STRUCTURE]) + column
    group += bytes([1 << 4 | LONG]) + number(16) + bytes([1 << 4 | LONG]) + number(2) + b"\0"
    root = bytes([4 << 4 | TEXT, 4]) + b"root" + bytes([1 << 4 | INTEGER]) + number(1) + b"\0"
    leaf = integers(f1=5) + bytes([2 << 4 | INTEGER]) + number(0) + bytes([1 << 4 | TEXT, len(leaf_name)]) + leaf_name
    leaf += b"\0"
    footer = integers(f1=1) + bytes([1 << 4 | LIST, 2 << 4 | STRUCTURE]) + root + leaf
    footer += bytes([1 << 4 | LONG]) + number(2) + bytes([1 << 4 | LIST, 1 << 4 | STRUCTURE]) + group + b"\0"
    path.write_bytes(b"PAR1" + head + bytes(8) + footer + struct.pack("<I", len(footer)) + b"PAR1")


@pytest.mark.parametrize("name", [b"t", b"u"])
def test_a_page_of_gigabytes_is_refused_before_it_is_unpacked(tmp_path: Path, name: bytes):
    """Whatever the column calls itself: the library goes by its place."""
    path = tmp_path / "x.parquet"
    bomb(path, page(), name)
    assert pq.read_metadata(path).num_rows == 2, "the library believes it"
    with pytest.raises(LogError, match=f"column 't': a page of {BIG} bytes for 2 numbers"):
        next(table_columns(path, ["t"]))
    bomb(path, page(16), name)
    require_small_pages(path, {"t"})


TWICE = bytes([LONG]) + number(2) + number(16)
"""Field 2 again, of a kind that the library skips."""


@pytest.mark.parametrize(
    "head",
    [
        page(more=TWICE), page(16, packed=2**32 + 8), page(16, packed=200), page(16, numbers=3),
        page(16, more=bytes([1 << 4 | LIST]) + 5000 * bytes([1 << 4 | LIST])),
        page(16, more=bytes([LONG]) + number(2**15) + number(0)),
    ],
    ids=["a field twice", "33 bits", "beyond its column", "more numbers", "nested lists", "field number"],
)  # fmt: skip
def test_what_the_library_would_read_otherwise_is_refused(tmp_path: Path, head: bytes):
    bomb(tmp_path / "x.parquet", head)
    with pytest.raises(LogError, match="the description of a column is damaged"):
        require_small_pages(tmp_path / "x.parquet", {"t"})


def test_columns_within_structures_and_lists_belong_to_the_outermost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    inner = pa.array([{"a": [1.0, 2.0], "b": 1.0}] * 50)
    pq.write_table(pa.table({"s": inner, "t": np.zeros(50), "l": [[1.0, 2.0, 3.0]] * 50}), tmp_path / "x.parquet")
    for names, count in (({"s"}, 150), ({"t"}, 50), ({"l"}, 150), ({"l", "t"}, 200)):
        monkeypatch.setattr("motorprior.logs.formats.parquet_pages.MAX_NUMBERS", count)
        require_small_pages(tmp_path / "x.parquet", names)
        monkeypatch.setattr("motorprior.logs.formats.parquet_pages.MAX_NUMBERS", count - 1)
        with pytest.raises(LogError, match=f"50 rows of {count // 50} numbers"):
            require_small_pages(tmp_path / "x.parquet", names)


def test_a_description_that_is_too_long_or_damaged_is_refused(tmp_path: Path):
    path = tmp_path / "x.parquet"
    bomb(path, page())
    whole = path.read_bytes()
    path.write_bytes(whole[:-20] + b"\xff" * 12 + whole[-8:])
    with pytest.raises(LogError, match="the description of a column is damaged"):
        require_small_pages(path, {"t"})
    path.write_bytes(bytes(MAX_FOOTER + 100) + struct.pack("<I", MAX_FOOTER + 1) + b"PAR1")
    with pytest.raises(LogError, match=f"bytes of description, more than {MAX_FOOTER}"):
        require_parquet(path)
    path.write_bytes(whole[-30:])
    with pytest.raises(LogError, match="not a complete Parquet file"):
        require_parquet(path)
