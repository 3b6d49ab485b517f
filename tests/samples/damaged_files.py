"""Files that a disk or a network damaged."""

from pathlib import Path


def damage(path: Path, share: float, byte: int | None) -> bool:
    """Put a byte, or the file's end if it is None, at a share of its length from 0 to below 1; whether it was cut."""
    data = bytearray(path.read_bytes())
    place = int(share * len(data))
    if byte is None:
        del data[place:]
    else:
        data[place] = byte
    path.write_bytes(data)
    return byte is None
