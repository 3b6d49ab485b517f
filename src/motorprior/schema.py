"""Declarations of file contents: keys of tables with their values, and shapes of tensors.

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
    keys: Iterable[str], declared: Iterable[str], where: str | Path | None, remedy: str
) -> None:
    """Raise ArtifactError, with unknown and missing keys, unless the keys are those declared."""
    unknown = sorted(set(keys) - set(declared))
    missing = sorted(set(declared) - set(keys))
    problems = []
    if unknown:
        problems.append(f"unknown keys {quoted(unknown, 300)}")
    if missing:
        problems.append(f"missing keys {quoted(missing, 300)}")
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
        """Raise ArtifactError for an unknown or missing key, or a value that is not as declared."""
        where = f"{where}[{self.name}]" if self.name else where
        require("content", table, TABLE, where, self.remedy)

        remedy = self.remedy
        if self.optional:
            remedy += f"; the keys are {', '.join(sorted(self.fields))}"
        omitted = self.optional - table.keys()
        require_keys(table, self.fields.keys() - omitted, where, remedy)

        for key in table:
            require(key, table[key], self.fields[key], where, self.remedy)


@dataclass(frozen=True)
class Tensor:
    """Declaration of a float64 array."""

    # sizes; a name stands for the same size wherever it occurs
    shape: tuple[str | int, ...]
    above: float = -inf  # exclusive lower bound of the values


def check_tensors(
    tensors: Mapping[str, np.ndarray],
    declared: Mapping[str, Tensor],
    where: str | Path | None,
    remedy: str,
    sizes: Mapping[str, int] | None = None,
) -> dict[str, int]:
    """Check arrays and return every named size.

    A size is in ``sizes``, or is that of the first array that has it. Raises ArtifactError for
    another set of names, another type or shape, or a value that is too small.
    """
    require_keys(tensors, declared, where, remedy)
    size_of_name = dict(sizes or {})
    for name, tensor in declared.items():
        value = tensors[name]
        for size, length in zip(tensor.shape, value.shape, strict=False):
            if isinstance(size, str):
                size_of_name.setdefault(size, length)

        shape = tuple(
            size_of_name.get(size, size) if isinstance(size, str) else size for size in tensor.shape
        )
        if value.dtype != np.float64 or value.shape != shape:
            problem = f"{name} is {value.dtype}{value.shape}, wanted float64{shape}"
            raise ArtifactError(problem, where=where, remedy=remedy)
        if not np.all(value > tensor.above):
            problem = f"{name} has a value of {value.min():.3g}, not above {tensor.above:g}"
            raise ArtifactError(problem, where=where, remedy=remedy)
    return size_of_name


@dataclass(frozen=True)
class Header:
    """Declaration of the JSON header of an artefact."""

    artefact: str  # its name
    version: int  # of the header's keys
    fields: Mapping[str, Field]  # key -> declared value
    remedy: str  # remedy in errors
    file: str  # default name
    command: str  # writes it

    def make(self, **entries: Any) -> dict[str, Any]:
        """The header with these entries."""
        return {"kind": self.artefact, "schema_version": self.version, **entries}

    def read(self, path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors, which are not checked, and checked header of a file.

        Raises ArtifactError as `read_tensors` and `check`.
        """
        if path.is_dir():
            default_file = path / self.file
            remedy = f"give {default_file}" if default_file.is_file() else self._give
            raise ArtifactError("a folder, not a file", where=path, remedy=remedy)
        tensors, header = read_tensors(path)
        self.check(header, path)
        return tensors, header

    def check(self, header: Any, where: str | Path | None) -> None:
        """Raise ArtifactError for another artefact, a newer version, or an undeclared entry."""
        require("header", header, TABLE, where, self.remedy)
        artefact = header.get("kind")
        if artefact != self.artefact:
            problem = f"a {quoted(str(artefact))[1:-1]}, not a {self.artefact}"
            raise ArtifactError(problem, where=where, remedy=self._give)

        version = header.get("schema_version")
        if isinstance(version, int) and version > self.version:
            problem = (
                f"written by a newer motorprior: schema_version {version}, "
                f"this one reads {self.version}"
            )
            raise ArtifactError(problem, where=where, remedy="update motorprior")

        identity = {"kind": exactly(self.artefact), "schema_version": exactly(self.version)}
        Schema(identity | dict(self.fields), self.remedy).check(header, where)

    @property
    def _give(self) -> str:
        return f"give the {self.file} that `{self.command}` wrote"
