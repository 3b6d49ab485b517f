"""What a file must hold, declared once: the entries of a table, and tensors whose shapes share symbols.

A declaration is data. Here is all that refuses: keys unknown or missing, values of another kind or beyond their bounds,
tensors of another type or shape. A message names the file, the key, its value, what it should be, and a way out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import first_not_finite, read_tensors, require_keys
from motorprior.bounds import LARGEST, is_number
from motorprior.exceptions import ArtifactError, cut, spelled

_SHOWN = 40
"""Characters of a bad value in a message."""


@dataclass(frozen=True)
class Field:
    """What an entry may be: ``accepts`` decides; a refusal reads "KEY = VALUE is not MEANING"."""

    meaning: str
    accepts: Callable[[Any], bool]


def number(least: float = -LARGEST, most: float = LARGEST, above: float = -inf, unit: str = "") -> Field:
    """A finite number in [least, most] and above ``above``; no truth value."""
    bounds = f" above {above:g}" if above > -inf else f" from {least:.3g}" if least > -LARGEST else ""
    bounds += f" to {most:.3g}" if most < LARGEST else ""
    return Field(
        f"a finite number{bounds} {unit}".rstrip(), lambda value: is_number(value, least, most) and value > above
    )


def integer(least: int, most: int) -> Field:
    """An integer in [least, most]."""
    return Field(f"an integer from {least} to {most}", lambda value: type(value) is int and least <= value <= most)


def one_of(*values: str) -> Field:
    """One of these texts."""
    return Field(" or ".join(values), lambda value: isinstance(value, str) and value in values)


def exactly(wanted: Any) -> Field:
    """This very value, of this very type."""
    return Field(repr(wanted), lambda value: type(value) is type(wanted) and value == wanted)


def maybe(field: Field) -> Field:
    """That, or null."""
    return Field(f"{field.meaning}, or null", lambda value: value is None or field.accepts(value))


def many(field: Field, least: int = 0) -> Field:
    """A list of at least so many of them."""
    return Field(
        f"a list of {least} or more, each {field.meaning}",
        lambda value: isinstance(value, list) and len(value) >= least and all(map(field.accepts, value)),
    )


TEXT = Field("a text", lambda value: isinstance(value, str))
TRUTH = Field("true or false", lambda value: isinstance(value, bool))
TABLE = Field("a table", lambda value: isinstance(value, Mapping))


@dataclass(frozen=True)
class Schema:
    """The entries of a table.

    Attributes:
        fields: key -> what it may be.
        remedy: what to do about a table that is refused.
        optional: keys that may be missing.
        name: of the table, where a file holds several.
    """

    fields: Mapping[str, Field]
    remedy: str
    optional: frozenset[str] = frozenset()
    name: str = ""

    def check(self, table: Any, where: str | Path | None) -> None:
        """Refuse what is no such table.

        Raises:
            ArtifactError: names the key, its value and what it should be.
        """
        if not TABLE.accepts(table):
            raise ArtifactError(f"{self.name or 'its content'} is not a table", where=where, remedy=self.remedy)
        known = f"; the keys are {', '.join(sorted(self.fields))}" if self.optional else ""
        require_keys(table, self.fields.keys() - (self.optional - table.keys()), where, self.remedy + known, self.name)
        for key, field in self.fields.items():
            if key in table:
                require(key, table[key], field, where, self.remedy, self.name)


def require(key: str, value: Any, field: Field, where: str | Path | None, remedy: str, name: str = "") -> None:
    """Refuse an entry that is not what ``field`` says.

    Raises:
        ArtifactError: names the key, after the ``name`` of its table, its value and what it should be.
    """
    if not field.accepts(value):
        owner = f"{name}: " if name else ""
        raise ArtifactError(f"{owner}{key} = {_shown(value)} is not {field.meaning}", where=where, remedy=remedy)


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else spelled(value, _SHOWN)


@dataclass(frozen=True)
class Tensor:
    """An array of float64, all finite.

    Attributes:
        shape: sizes; a name stands for the same size wherever it occurs.
        largest: of the absolute values.
        above: what every value exceeds.
    """

    shape: tuple[str | int, ...]
    largest: float = inf
    above: float = -inf


def check_tensors(
    tensors: Mapping[str, np.ndarray],
    wanted: Mapping[str, Tensor],
    where: str | Path | None,
    remedy: str,
    sizes: Mapping[str, int] | None = None,
) -> dict[str, int]:
    """Refuse arrays that are not the declared ones; returns every name of a size with its value.

    A name gets its value from ``sizes``, or where it occurs first, in the order of the declarations.

    Raises:
        ArtifactError: names the tensor, what it is and what it should be.
    """
    require_keys(tensors, wanted, where, remedy)
    known = dict(sizes or {})
    for name, tensor in wanted.items():
        problem = _problem(np.asarray(tensors[name]), tensor, known)
        if problem:
            raise ArtifactError(f"{name}{problem}", where=where, remedy=remedy)
    return known


def _problem(value: np.ndarray, tensor: Tensor, known: dict[str, int]) -> str:
    """What is wrong with an array; nothing if nothing is. Notes the sizes that it gives a value."""
    if value.ndim == len(tensor.shape):
        for size, length in zip(tensor.shape, value.shape, strict=True):
            if isinstance(size, str):
                known.setdefault(size, length)
    shape = [known.get(size, size) if isinstance(size, str) else size for size in tensor.shape]
    if value.dtype != np.float64 or list(value.shape) != shape:
        text = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
        return f" is {value.dtype}{value.shape}, wanted float64({text})"
    if (place := first_not_finite(value)) is not None:
        return f"{place} is not finite"
    if value.size and np.abs(value).max() > tensor.largest:
        return f" holds {np.abs(value).max():.3g}, beyond {tensor.largest:g}"
    if value.size and value.min() <= tensor.above:
        return f" holds {value.min():.3g}, not above {tensor.above:g}"
    return ""


@dataclass(frozen=True)
class Header:
    """The JSON header of an artefact.

    Attributes:
        kind: what the artefact is.
        version: of its entries.
        fields: its entries.
        remedy: what to do about one that is refused.
        file: name of the file.
        command: that writes it.
    """

    kind: str
    version: int
    fields: Mapping[str, Field]
    remedy: str
    file: str
    command: str

    def write(self, **entries: Any) -> dict[str, Any]:
        """The header of a file with these entries."""
        return {"kind": self.kind, "schema_version": self.version, **entries}

    def read(self, path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors, still to be checked, and header of a file that passes `check` before any tensor is read.

        Raises:
            ArtifactError: as `read_tensors` and `check`; of a folder that holds such a file, its path.
        """
        if path.is_dir():
            inside = (path / self.file).is_file()
            remedy = f"give {path / self.file}" if inside else f"give the {self.file} that `{self.command}` wrote"
            raise ArtifactError("a folder, not a file", where=path, remedy=remedy)
        return read_tensors(path, self.check)

    def check(self, header: Mapping[str, Any], where: str | Path | None) -> None:
        """Refuse a header of another kind or version, whatever else it holds, or with an entry not as declared."""
        found = header.get("kind")
        if isinstance(found, str) and found != self.kind:
            remedy = f"give the {self.file} that `{self.command}` wrote"
            raise ArtifactError(f"a {cut(found, _SHOWN)}, not a {self.kind}", where=where, remedy=remedy)
        version = header.get("schema_version")
        if type(version) is int and version > self.version:
            raise ArtifactError(
                f"of a newer motorprior: schema_version {version}, this one reads {self.version}", where=where,
                remedy="update motorprior",
            )  # fmt: skip
        identity = {"kind": exactly(self.kind), "schema_version": exactly(self.version)}
        for key, field in identity.items():
            require(key, header.get(key), field, where, self.remedy)
        Schema(identity | dict(self.fields), self.remedy).check(header, where)
