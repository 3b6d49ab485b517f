"""Messages of an MCAP file, whose packed chunks are unpacked within bounds, and whose checksums are those of its bytes.

A chunk of a kilobyte can unpack to gigabytes, and say that it does not; the library mcap believes it. Chunks and the
summary have checksums (CRC-32; 0 where the recorder made none), so that no damaged byte becomes another angle.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from motorprior.exceptions import LogError, shown

_MOST_CHUNK = 64_000_000
"""Bytes of one chunk, packed or not; recorders make chunks of one to some megabytes."""
_MOST_UNPACKED, _MOST_TIMES = 100_000_000, 200
"""All chunks together may unpack to so many bytes, or to so many times those of the file."""
_RECORD_HEAD = 9
"""Bytes before a record's content: its kind and its length."""
_MAGIC = b"\x89MCAP0\r\n"
"""Bytes at both ends of a file that was finished."""
_CRC_SIZE, _BLOCK = 4, 2**20
_AGAIN = "copy the file again from its source, or record in smaller chunks"
_RECOVER = "repair it with `mcap recover`, or copy it again from its source"


def mcap_summary(file: IO[bytes], path: Path) -> Any:
    """Channels, schemas and chunks of an MCAP file.

    Raises:
        LogError: no MCAP file, or one that is not finished, without a summary, or with one of another checksum; a chunk
            where the summary should be: the library would unpack it.
        Exception: whatever a damaged file ends in.
    """
    from mcap.reader import FOOTER_SIZE, make_reader  # pyright: ignore[reportMissingImports]
    from mcap.records import Chunk  # pyright: ignore[reportMissingImports]
    from mcap.stream_reader import MAGIC_SIZE  # pyright: ignore[reportMissingImports]

    _require_finished(file, path)
    file.seek(-(FOOTER_SIZE + MAGIC_SIZE), 2)
    footer = next(_as_they_are(file))
    begin = getattr(footer, "summary_start", 0)
    _require_crc(file, begin, getattr(footer, "summary_crc", 0), path)
    if begin:
        file.seek(begin)
    if isinstance(footer, Chunk) or (begin and any(isinstance(record, Chunk) for record in _as_they_are(file))):
        raise LogError("its summary holds a chunk of messages", where=path, remedy=_AGAIN)
    file.seek(0)
    summary = make_reader(file).get_summary()
    if summary is None:
        raise LogError("the bag has no summary: its recorder was not closed", where=path, remedy=_RECOVER)
    return summary


def mcap_messages(file: IO[bytes], indexes: Iterable[Any], wanted: set[int], path: Path) -> Iterator[Any]:
    """Messages of some channels, in the order of the file.

    Args:
        file: open MCAP file.
        indexes: its chunks, as its summary has them.
        wanted: numbers of the channels.
        path: for messages.

    Raises:
        LogError: chunks that unpack to too much or not to what they say, or that lie in one another.
        Exception: whatever a damaged file ends in.
    """
    from mcap.records import Chunk, Message  # pyright: ignore[reportMissingImports]
    from mcap.stream_reader import breakup_chunk  # pyright: ignore[reportMissingImports]

    most, done = max(_MOST_UNPACKED, _MOST_TIMES * path.stat().st_size), 0
    for record in _records(file, sorted(indexes, key=lambda index: index.chunk_start_offset), wanted, path):
        if isinstance(record, Chunk):
            chunk = unpacked(record, path)
            done += len(chunk.data)
            if done > most:
                raise LogError(f"it unpacks to more than {most} bytes", where=path, remedy=_AGAIN)
            inside = breakup_chunk(chunk)
        else:
            inside = [record]
        yield from (one for one in inside if isinstance(one, Message) and one.channel_id in wanted)


def unpacked(chunk: Any, path: Path) -> Any:
    """The same chunk without compression.

    Raises:
        LogError: too large, packed in an unknown way, or not as large as it says, or with another checksum.
    """
    import lz4.frame  # pyright: ignore[reportMissingImports]
    import zstandard  # pyright: ignore[reportMissingImports]

    size, packing = chunk.uncompressed_size, chunk.compression
    _require_size(size, path)
    if packing == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif packing == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif packing == "":
        data = chunk.data
    else:
        raise LogError(f"a chunk is packed with {shown(packing)}", where=path, remedy="pack it with zstd or lz4")
    if len(data) != size:
        problem = f"a chunk says that it unpacks to {size} bytes, and does not"
        raise LogError(problem, where=path, remedy=_AGAIN)
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise LogError("a chunk is damaged: its checksum is not that of its bytes", where=path, remedy=_RECOVER)
    return replace(chunk, compression="", data=data)


def _require_finished(file: IO[bytes], path: Path) -> None:
    """Refuse what does not begin and end as the file of a recorder that was closed."""
    if file.read(len(_MAGIC)) != _MAGIC:
        raise LogError("not an MCAP file: it does not begin as one", where=path, remedy=_AGAIN)
    file.seek(max(len(_MAGIC), file.seek(0, 2) - len(_MAGIC)))
    if file.read() != _MAGIC:
        problem = "the bag is not finished: its recorder was not closed, or the file was cut"
        raise LogError(problem, where=path, remedy=_RECOVER)


def _require_crc(file: IO[bytes], begin: int, said: int, path: Path) -> None:
    """Refuse a summary, the bytes from ``begin`` to its checksum in the footer, that has another one."""
    if 0 in (begin, said):  # no summary, or none that says it
        return
    left = file.seek(0, 2) - len(_MAGIC) - _CRC_SIZE - begin
    file.seek(begin)
    crc = 0
    while left > 0 and (block := file.read(min(_BLOCK, left))):
        crc, left = zlib.crc32(block, crc), left - len(block)
    if crc != said:
        raise LogError("the bag's summary is damaged: its checksum is another", where=path, remedy=_RECOVER)


def _records(file: IO[bytes], indexes: list[Any], wanted: set[int], path: Path) -> Iterator[Any]:
    """Chunks that have messages of the wanted channels; everything, where the summary knows of no chunk."""
    from mcap.data_stream import ReadDataStream  # pyright: ignore[reportMissingImports]
    from mcap.records import Chunk  # pyright: ignore[reportMissingImports]

    if not indexes:
        file.seek(0)
        yield from _as_they_are(file, skip_magic=False)
    end = 0
    for index in indexes:
        if index.chunk_start_offset < end:
            raise LogError("its chunks lie in one another", where=path, remedy=_AGAIN)
        end = index.chunk_start_offset + index.chunk_length
        if index.message_index_offsets and wanted.isdisjoint(index.message_index_offsets):
            continue
        _require_size(index.chunk_length, path)
        file.seek(index.chunk_start_offset + _RECORD_HEAD)
        yield Chunk.read(ReadDataStream(BytesIO(file.read(index.chunk_length - _RECORD_HEAD))))


def _as_they_are(file: IO[bytes], skip_magic: bool = True) -> Iterator[Any]:
    """Records from here on; chunks are not unpacked."""
    from mcap.stream_reader import StreamReader  # pyright: ignore[reportMissingImports]

    return StreamReader(file, skip_magic, emit_chunks=True, record_size_limit=_MOST_CHUNK).records


def _require_size(size: int, path: Path) -> None:
    if size > _MOST_CHUNK:
        raise LogError(f"a chunk of {size} bytes, more than {_MOST_CHUNK}", where=path, remedy=_AGAIN)
