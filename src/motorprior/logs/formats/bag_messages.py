"""Messages of a ROS 2 bag in MCAP: a .mcap file, or the folder of METADATA and such a file of ``ros2 bag record``.

Needs the extra ``ros``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from motorprior.exceptions import LogError

METADATA = "metadata.yaml"
NANOSECOND = 1e-9
_RECOVER = "repair it with `mcap recover`, or copy it again from its source"
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
        from mcap.reader import make_reader  # pyright: ignore[reportMissingImports]
        from mcap_ros2.decoder import DecoderFactory  # pyright: ignore[reportMissingImports]

        self.path = path
        self._reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = self._reader.get_summary()
        if summary is None:
            raise LogError("the bag has no summary: its recorder was not closed", where=path, remedy=_RECOVER)
        kinds = {number: schema.name for number, schema in summary.schemas.items()}
        self.types = {channel.topic: kinds.get(channel.schema_id, "no type") for channel in summary.channels.values()}

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, time of recording [ns] and content of every message of these topics, in order of time."""
        for found in self._reader.iter_decoded_messages(topics=list(topics), log_time_order=True):
            yield found.channel.topic, found.message.log_time, found.decoded_message

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
        raise LogError(f"cannot be read ({str(error)[:300]})", where=path, remedy=_RECOVER) from error


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
