"""Declarations of file contents: the keys of a table with their values, and tensors whose shapes share symbols.

Errors name the file, the key, its value, the allowed values and a remedy.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_tensors
from motorprior.bounds import TABLE, Field, exactly, require
from motorprior.exceptions import ArtifactError, quoted


def require_keys(
    given: Iterable[str], wanted: Iterable[str], where: str | Path | None, remedy: str
) -> None:
    """Raise ArtifactError, with unknown and missing keys, unless a table has exactly the wanted keys."""
    given = set(given)
    wanted = set(wanted)
    kinds = {"unknown": sorted(given - wanted), "missing": sorted(wanted - given)}
    problems = [f"{kind} keys {quoted(keys, 300)}" for kind, keys in kinds.items() if keys]
    if problems:
        raise ArtifactError(" and ".join(problems), where=where, remedy=remedy)


@dataclass(frozen=True)
class Schema:
    """Declaration of a table."""

    fields: Mapping[str, Field]  # key -> declared value
    remedy: str  # remedy in errors
    optional: frozenset[str] = frozenset()  # keys that may be missing
    name: str = ""  # of the table, if a file has several

    def check(self, table: Any, where: str | Path | None) -> None:
        """Raise ArtifactError for no table, an unknown or missing key, or a value that is not as declared."""
        where = f"{where}[{self.name}]" if self.name else where
        require("content", table, TABLE, where, self.remedy)
        keys = f"; the keys are {', '.join(sorted(self.fields))}" if self.optional else ""
        require_keys(
            table, self.fields.keys() - (self.optional - table.keys()), where, self.remedy + keys
        )
        for key in table:
            require(key, table[key], self.fields[key], where, self.remedy)


@dataclass(frozen=True)
class Tensor:
    """Declaration of a float64 array."""

    shape: tuple[str | int, ...]  # sizes; a name stands for the same size wherever it occurs
    above: float = -inf  # exclusive lower bound of the values


def check_tensors(
    tensors: Mapping[str, np.ndarray],
    wanted: Mapping[str, Tensor],
    where: str | Path | None,
    remedy: str,
    sizes: Mapping[str, int] | None = None,
) -> dict[str, int]:
    """Check arrays and return every named size, taken from ``sizes`` or from the first array that has it."""
    require_keys(tensors, wanted, where, remedy)
    known = dict(sizes or {})
    for name, tensor in wanted.items():
        value = tensors[name]
        for size, length in zip(tensor.shape, value.shape, strict=False):
            if isinstance(size, str):
                known.setdefault(size, length)
        shape = tuple(
            known.get(size, size) if isinstance(size, str) else size for size in tensor.shape
        )
        if value.dtype != np.float64 or value.shape != shape:
            problem = f"{name} is {value.dtype}{value.shape}, wanted float64{shape}"
            raise ArtifactError(problem, where=where, remedy=remedy)
        if not np.all(value > tensor.above):
            problem = f"{name} has a value of {value.min():.3g}, not above {tensor.above:g}"
            raise ArtifactError(problem, where=where, remedy=remedy)
    return known


@dataclass(frozen=True)
class Header:
    """Declaration of the JSON header of an artefact."""

    kind: str  # kind of artefact
    version: int  # of the header's keys
    fields: Mapping[str, Field]  # key -> declared value
    remedy: str  # remedy in errors
    file: str  # default name
    command: str  # writes it

    def make(self, **entries: Any) -> dict[str, Any]:
        """The header with these entries."""
        return {"kind": self.kind, "schema_version": self.version, **entries}

    def read(self, path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors (not checked) and checked header of a file; raises ArtifactError as `read_tensors` and `check`."""
        if path.is_dir():
            remedy = f"give {path / self.file}" if (path / self.file).is_file() else self._give
            raise ArtifactError("a folder, not a file", where=path, remedy=remedy)
        tensors, header = read_tensors(path)
        self.check(header, path)
        return tensors, header

    def check(self, header: Any, where: str | Path | None) -> None:
        """Raise ArtifactError for another kind, a newer version, or an entry that is not as declared."""
        require("header", header, TABLE, where, self.remedy)
        found = header.get("kind")
        version = header.get("schema_version")
        if found != self.kind:
            raise ArtifactError(
                f"a {quoted(str(found))[1:-1]}, not a {self.kind}", where=where, remedy=self._give
            )
        if isinstance(version, int) and version > self.version:
            problem = f"written by a newer motorprior: schema_version {version}, this one reads {self.version}"
            raise ArtifactError(problem, where=where, remedy="update motorprior")
        identity = {"kind": exactly(self.kind), "schema_version": exactly(self.version)}
        Schema(identity | dict(self.fields), self.remedy).check(header, where)

    @property
    def _give(self) -> str:
        return f"give the {self.file} that `{self.command}` wrote"
