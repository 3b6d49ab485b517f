"""The file of a robot's model, MJCF or URDF, and the files that it names."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from xml.etree import ElementTree


@dataclass(frozen=True)
class ModelFile:
    """A model of a robot alone, without floor."""

    files: tuple[Path, ...]  # its own first, then included files and meshes
    sha256: str  # `files_digest` of these files when the robot was loaded
    # returns URDF for engines without MJCF; gets reflected inertias [kg·m²] and a shift of the
    # base's mass centre [m]
    urdf: Callable[..., str] | None = None

    @classmethod
    def of(cls, path: Path, urdf: Callable[..., str] | None = None) -> "ModelFile":
        """The model of a file with its present content."""
        files = model_files(path)
        return cls(files, files_digest(files), urdf)

    @property
    def path(self) -> Path:
        """The model's own file."""
        return self.files[0]


def model_files(path: Path) -> tuple[Path, ...]:
    """A model's file, and the existing files that it includes or names, at any depth."""
    files: dict[Path, None] = {}  # the keys are an ordered set
    unread = [path.resolve()]
    while unread:
        file = unread.pop(0)
        if file in files:
            continue
        files[file] = None
        for element, named_file in _named_files(file, path):
            if element in ("include", "model"):
                unread.append(named_file)
            else:
                files[named_file] = None
    return tuple(files)


def _named_files(file: Path, model: Path) -> Iterator[tuple[str, Path]]:
    """Elements of an XML file of a model and the existing files that they name."""
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, OSError):  # MuJoCo's error is clearer
        return

    folders = {""}
    for compiler in root.iter("compiler"):
        folders |= {compiler.get("meshdir", ""), compiler.get("assetdir", "")}
    for element in root.iter():
        text = element.get("file") or element.get("filename") or ""
        for start, folder in product((file, model), sorted(folders)):
            named_file = mesh_file(start, text, folder)
            if named_file is not None:
                yield element.tag, named_file.resolve()


def is_urdf(path: Path) -> bool:
    """Whether a readable model is a URDF; otherwise it is MJCF."""
    return ElementTree.parse(path).getroot().tag == "robot"


def mesh_file(model: Path, text: str, folder: str = "") -> Path | None:
    """The file that a model names; None if there is no such file.

    The text is a path relative to the model or to its meshdir ``folder``, or
    ``package://PACKAGE/PATH`` below a folder above the model.
    """
    start = model.resolve().parent
    scheme, _, path = text.rpartition("://")
    if scheme:
        _, _, path_in_package = path.partition("/")
        candidates = []
        for above in (start, *start.parents):
            candidates += [above / path, above / path_in_package]
    else:
        candidates = [start / folder / path, start / path, start / folder / Path(path).name]
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def files_digest(files: Iterable[Path]) -> str:
    """SHA-256 of the content of files, in this order; raises OSError if one cannot be read."""
    digests = "".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
    return hashlib.sha256(digests.encode()).hexdigest()
