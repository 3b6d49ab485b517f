"""The files that a user's MJCF or URDF is made of: what it includes, and the meshes and height fields that it names."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree

_XML = ("include", "model")
"""Elements that name another file of XML."""


def model_files(path: Path) -> tuple[Path, ...]:
    """A model's file and, after it, those that it is made of, at any depth; those that are not there are left out."""
    found: dict[Path, None] = {}
    waiting = [path.resolve()]
    while waiting:
        file = waiting.pop(0)
        if file in found:
            continue
        found[file] = None
        for element, named in _named(file, path.resolve().parent):
            if element in _XML:
                waiting.append(named)
            else:
                found[named] = None
    return tuple(found)


def _named(file: Path, beside: Path) -> Iterator[tuple[str, Path]]:
    """Every element that names a file which is there, beside this one or beside the model's first."""
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, OSError):  # MuJoCo says what is wrong with it
        return
    folders = {""} | {each.get(key, "") for each in root.iter("compiler") for key in ("meshdir", "assetdir")}
    for element in root.iter():
        name = (element.get("file") or element.get("filename") or "").partition("://")
        name = Path(name[2] or name[0])
        if not name.name:
            continue
        for folder in (start / inner for start in (file.parent, beside) for inner in sorted(folders)):
            for place in (folder / name, folder / name.name):  # the second: where paths are stripped
                if place.is_file():
                    yield element.tag, place.resolve()


def files_digest(files: Iterable[Path]) -> str:
    """SHA-256 of what is in files, in this order.

    Raises:
        OSError: one cannot be read.
    """
    digests = "".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
    return hashlib.sha256(digests.encode()).hexdigest()
