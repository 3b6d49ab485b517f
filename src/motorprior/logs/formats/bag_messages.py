"""Messages of a ROS 2 bag in MCAP: a .mcap file, or the folder of METADATA and such a file of ``ros2 bag record``.

Needs the extra ``ros``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import IO, Any

from motorprior.exceptions import LogError
from motorprior.logs.formats.mcap_chunks import mcap_messages, mcap_summary
from motorprior.logs.formats.table_columns import unreadable

METADATA = "metadata.yaml"
NANOSECOND = 1e-9
_SHOWN = 8
"""Topics that an error names."""


def is_bag(path: Path) -> bool:
    """Whether it is a bag, whatever its messages: a .mcap file, or a folder as ``ros2 bag record`` writes it.

    Not that of a bag of several .mcap files, each of which is a recording: it is a folder of logs.
    """
    if not path.is_dir():
        return path.suffix == ".mcap" and path.is_file()
    found = _files(path) if (path / METADATA).is_file() else []
    return len(found) == 1 or any(file.suffix != ".mcap" for file in found)


class Bag:
    """An open bag.

    Attributes:
        path: of its .mcap file.
        types: topic -> type of its messages.
    """

    def __init__(self, file: IO[bytes], path: Path):
        self.path, self._file, self._summary = path, file, mcap_summary(file, path)
        self.types = {channel.topic: self._type(channel) for channel in self._summary.channels.values()}

    def _type(self, channel: Any) -> str:
        kind = self._summary.schemas.get(channel.schema_id)
        return "no type" if kind is None else kind.name

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, time of recording [ns] and content of every message of these topics, in order of time.

        Raises:
            LogError: messages in another encoding than that of ROS 2.
            Exception: whatever damaged bytes end in.
        """
        from mcap_ros2.decoder import DecoderFactory  # pyright: ignore[reportMissingImports]

        channels = {number: each for number, each in self._summary.channels.items() if each.topic in topics}
        found = [
            (message.log_time, message.channel_id, message.data)
            for message in mcap_messages(self._file, self._summary.chunk_indexes, set(channels), self.path)
        ]
        factory, decoders = DecoderFactory(), {}
        for number, channel in channels.items():
            kind = self._summary.schemas.get(channel.schema_id)
            decoders[number] = decoder = factory.decoder_for(channel.message_encoding, kind)
            if decoder is None:
                problem = f"messages of {channel.topic} are encoded as {channel.message_encoding[:40]!r}"
                raise LogError(problem, where=self.path, remedy="record it with ROS 2, whose encoding is cdr")
        for time, number, data in sorted(found, key=itemgetter(0)):
            yield channels[number].topic, time, decoders[number](data)

    def topics_but(self, kind: str = "") -> str:
        """Its topics of other types than this one, for an error; empty if it has none."""
        found = [f"{topic} ({other})" for topic, other in sorted(self.types.items()) if other != kind]
        return ", ".join(found[:_SHOWN]) + (", …" if len(found) > _SHOWN else "")


@contextmanager
def opened_bag(path: Path) -> Iterator[Bag]:
    """The bag of a .mcap file, or of the folder that holds one beside METADATA.

    Raises:
        LogError: the extra `ros` is not installed; a folder of a bag in another storage; a damaged file, also one that
            turns out to be damaged while it is read.
    """
    path = _only_file(path)
    try:
        import mcap.reader  # noqa: F401  # pyright: ignore[reportMissingImports]
        import mcap_ros2.decoder  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise LogError(
            "ROS 2 bags need the libraries mcap and mcap-ros2-support", where=path,
            remedy='pip install "motorprior[ros]"',
        ) from error  # fmt: skip
    try:
        with open(path, "rb") as file:
            yield Bag(file, path)
    except LogError:
        raise
    except Exception as error:  # a decoder of damaged bytes may end in anything
        raise unreadable(path, error) from error


def _files(folder: Path) -> list[Path]:
    return sorted(entry for entry in folder.iterdir() if entry.suffix in (".mcap", ".db3"))


def _only_file(path: Path) -> Path:
    """The .mcap file of a bag's folder, or the path itself if it is none.

    Raises:
        LogError: a bag of another storage.
    """
    if not path.is_dir():
        return path
    found = _files(path)
    if other := [file.name for file in found if file.suffix != ".mcap"]:
        remedy = "turn it into MCAP with `ros2 bag convert` (storage_id: mcap)"
        raise LogError(f"a bag that is not stored as MCAP: {other[0]}", where=path, remedy=remedy)
    return found[0]
