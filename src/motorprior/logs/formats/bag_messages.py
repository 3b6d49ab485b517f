"""Messages of a ROS 2 bag in MCAP: a .mcap file, or a folder of ``ros2 bag record``. Needs the extra ``ros``."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from motorprior.exceptions import LogError, listed

NANOSECOND = 1e-9
_RECOVER = "repair it with `mcap recover`, or copy it again from its source"


def is_bag(path: Path) -> bool:
    """Whether a path is a .mcap file, or the folder of a bag with a single file.

    The folder of a bag with several .mcap files is a folder of logs.
    """
    if not path.is_dir():
        return path.suffix == ".mcap" and path.is_file()
    found = _files(path) if (path / "metadata.yaml").is_file() else []
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
        """Topic, recording time [ns] and content of every message of these topics, in order of time."""
        for found in self._reader.iter_decoded_messages(topics=list(topics), log_time_order=True):
            yield found.channel.topic, found.message.log_time, found.decoded_message

    def topics_text(self) -> str:
        """Its topics with their types, for an error."""
        return listed([f"{topic} ({kind})" for topic, kind in sorted(self.types.items())], 8) or "none"


@contextmanager
def opened_bag(path: Path) -> Iterator[Bag]:
    """Open a .mcap file, or the one in the folder of a bag.

    Raises:
        LogError: the extra `ros` is not installed, another storage than MCAP, or a damaged file, at opening or reading.
    """
    if path.is_dir():
        found = sorted(_files(path), key=lambda file: file.suffix == ".mcap")
        path = found[0]
        if path.suffix != ".mcap":
            remedy = "convert it to MCAP with `ros2 bag convert` (storage_id: mcap)"
            raise LogError(f"the bag is not stored as MCAP: {path.name}", where=path.parent, remedy=remedy)
    try:
        import mcap.reader  # noqa: F401  # pyright: ignore[reportMissingImports]
        import mcap_ros2.decoder  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        problem = "ROS 2 bags need the libraries mcap and mcap-ros2-support"
        raise LogError(problem, where=path, remedy='pip install "motorprior[ros]"') from error
    try:
        with open(path, "rb") as file:
            yield Bag(file, path)
    except LogError:
        raise
    except Exception as error:  # decoders of damaged bytes raise many types
        raise LogError(f"cannot be read ({str(error)[:300]})", where=path, remedy=_RECOVER) from error


def _files(folder: Path) -> list[Path]:
    return sorted(entry for entry in folder.iterdir() if entry.suffix in (".mcap", ".db3"))
