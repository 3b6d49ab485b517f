"""Declarations of file contents: the keys of a table with their values, and tensors whose shapes share symbols.

Errors name the file, the key, its value, the allowed values and a remedy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import first_not_finite, read_tensors, require_keys
from motorprior.bounds import MAX_NUMBER, is_number
from motorprior.exceptions import ArtifactError, cut, quoted


@dataclass(frozen=True)
class Field:
    """A declared value: ``accepts`` tests it; the error reads "KEY = VALUE is not MEANING"."""

    meaning: str
    accepts: Callable[[Any], bool]


def number(minimum: float = -MAX_NUMBER, maximum: float = MAX_NUMBER, above: float = -inf, unit: str = "") -> Field:
    """A finite number in [minimum, maximum] and above ``above``, not a bool."""
    bounds = f" above {above:g}" if above > -inf else f" from {minimum:.3g}" if minimum > -MAX_NUMBER else ""
    bounds += f" to {maximum:.3g}" if maximum < MAX_NUMBER else ""
    return Field(
        f"a finite number{bounds} {unit}".rstrip(), lambda value: is_number(value, minimum, maximum) and value > above
    )


def integer(minimum: int, maximum: int) -> Field:
    """An integer in [minimum, maximum]."""
    return Field(
        f"an integer from {minimum} to {maximum}", lambda value: type(value) is int and minimum <= value <= maximum
    )


def one_of(*values: str) -> Field:
    """One of these texts."""
    return Field(" or ".join(values), lambda value: isinstance(value, str) and value in values)


def exactly(wanted: Any) -> Field:
    """This value, of the same type."""
    return Field(repr(wanted), lambda value: type(value) is type(wanted) and value == wanted)


def maybe(field: Field) -> Field:
    """The field or null."""
    return Field(f"{field.meaning}, or null", lambda value: value is None or field.accepts(value))


def many(field: Field, minimum: int = 0) -> Field:
    """A list of at least ``minimum`` values of a field."""
    return Field(
        f"a list of {minimum} or more, each {field.meaning}",
        lambda value: isinstance(value, list) and len(value) >= minimum and all(map(field.accepts, value)),
    )


TEXT = Field("a text", lambda value: isinstance(value, str))
BOOLEAN = Field("true or false", lambda value: isinstance(value, bool))
TABLE = Field("a table", lambda value: isinstance(value, Mapping))


@dataclass(frozen=True)
class Schema:
    """Declaration of a table.

    Attributes:
        fields: key -> declared value.
        remedy: for errors.
        optional: keys that may be missing.
        name: of the table, if a file has several.
    """

    fields: Mapping[str, Field]
    remedy: str
    optional: frozenset[str] = frozenset()
    name: str = ""

    def check(self, table: Any, where: str | Path | None) -> None:
        """Check a table from the file ``where``.

        Raises:
            ArtifactError: not a table, an unknown or missing key, or a value that is not as declared.
        """
        if not TABLE.accepts(table):
            raise ArtifactError(f"{self.name or 'its content'} is not a table", where=where, remedy=self.remedy)
        keys = f"; the keys are {', '.join(sorted(self.fields))}" if self.optional else ""
        require_keys(table, self.fields.keys() - (self.optional - table.keys()), where, self.remedy + keys, self.name)
        for key, field in self.fields.items():
            if key in table:
                require(key, table[key], field, where, self.remedy, self.name)


def require(key: str, value: Any, field: Field, where: str | Path | None, remedy: str, name: str = "") -> None:
    """Check the value of a key in the table ``name``.

    Raises:
        ArtifactError: it is not as declared.
    """
    if not field.accepts(value):
        text = f"{value:.6g}" if isinstance(value, float) else quoted(value)
        owner = f"{name}: " if name else ""
        raise ArtifactError(f"{owner}{key} = {text} is not {field.meaning}", where=where, remedy=remedy)


@dataclass(frozen=True)
class Tensor:
    """Declaration of a float64 array of finite values.

    Attributes:
        shape: sizes; a name stands for the same size wherever it occurs.
        max_abs: maximum absolute value.
        above: exclusive lower bound of the values.
    """

    shape: tuple[str | int, ...]
    max_abs: float = inf
    above: float = -inf


def check_tensors(
    tensors: Mapping[str, np.ndarray],
    wanted: Mapping[str, Tensor],
    where: str | Path | None,
    remedy: str,
    sizes: Mapping[str, int] | None = None,
) -> dict[str, int]:
    """Check arrays and return every named size, taken from ``sizes`` or from the first array that has it.

    Raises:
        ArtifactError: names the tensor, its property and the declared one.
    """
    require_keys(tensors, wanted, where, remedy)
    known = dict(sizes or {})
    for name, tensor in wanted.items():
        problem = _problem(np.asarray(tensors[name]), tensor, known)
        if problem:
            raise ArtifactError(f"{name}{problem}", where=where, remedy=remedy)
    return known


def _problem(value: np.ndarray, tensor: Tensor, known: dict[str, int]) -> str:
    """The violation of a declaration, or ""; adds new named sizes to ``known``."""
    if value.ndim == len(tensor.shape):
        for size, length in zip(tensor.shape, value.shape, strict=True):
            if isinstance(size, str):
                known.setdefault(size, length)
    shape = [known.get(size, size) if isinstance(size, str) else size for size in tensor.shape]
    if value.dtype != np.float64 or list(value.shape) != shape:
        text = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
        return f" is {value.dtype}{value.shape}, wanted float64({text})"
    if (index := first_not_finite(value)) is not None:
        return f"{index} is not finite"
    if value.size and np.abs(value).max() > tensor.max_abs:
        return f" has a value of {np.abs(value).max():.3g}, beyond {tensor.max_abs:g}"
    if value.size and value.min() <= tensor.above:
        return f" has a value of {value.min():.3g}, not above {tensor.above:g}"
    return ""


@dataclass(frozen=True)
class Header:
    """Declaration of the JSON header of an artefact.

    Attributes:
        kind: of artefact.
        version: of the header's keys.
        fields: key -> declared value.
        remedy: for errors.
        file: default name of the file.
        command: the command that writes it.
    """

    kind: str
    version: int
    fields: Mapping[str, Field]
    remedy: str
    file: str
    command: str

    def write(self, **entries: Any) -> dict[str, Any]:
        """The header with these entries."""
        return {"kind": self.kind, "schema_version": self.version, **entries}

    def read(self, path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors (not checked) and checked header of a file.

        Raises:
            ArtifactError: a folder, or see `read_tensors` and `check`.
        """
        if path.is_dir():
            inside = (path / self.file).is_file()
            remedy = f"give {path / self.file}" if inside else f"give the {self.file} that `{self.command}` wrote"
            raise ArtifactError("a folder, not a file", where=path, remedy=remedy)
        return read_tensors(path, self.check)

    def check(self, header: Mapping[str, Any], where: str | Path | None) -> None:
        """Check a header.

        Raises:
            ArtifactError: another kind, a newer version, or an entry that is not as declared.
        """
        found, version = header.get("kind"), header.get("schema_version")
        if isinstance(found, str) and found != self.kind:
            remedy = f"give the {self.file} that `{self.command}` wrote"
            raise ArtifactError(f"a {cut(found, 40)}, not a {self.kind}", where=where, remedy=remedy)
        if type(version) is int and version > self.version:
            problem = f"written by a newer motorprior: schema_version {version}, this one reads {self.version}"
            raise ArtifactError(problem, where=where, remedy="update motorprior")
        identity = {"kind": exactly(self.kind), "schema_version": exactly(self.version)}
        for key, field in identity.items():
            require(key, header.get(key), field, where, self.remedy)
        Schema(identity | dict(self.fields), self.remedy).check(header, where)
