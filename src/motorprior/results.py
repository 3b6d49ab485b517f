"""What was measured, as one tidy table: a row per measurement. Names of figures are made from it, never read back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError
from motorprior.schema import TEXT, Field, Schema, exactly, integer, number

SCHEMA_VERSION = 1
_ENDINGS = {"mean": "_mean", "p05": "_p05", "p95": "_p95", "low": "/low", "high": "/high"} | {
    quantile: f"/{quantile}" for quantile in ("p50", "p99", "max")
}
"""What a row's statistic adds to the quantity in a figure's name; others, such as the median, add nothing."""


@dataclass(frozen=True)
class Result:
    """One measurement.

    Attributes:
        quantity: what was measured.
        unit: of the value; 1 for shares and ratios.
        value: a finite number.
        model: the actuator model, what a policy was trained on, or the way to simulate.
        motors: which motors: train, held_out; of a walk, own (those it was trained on) or twin.
        statistic: over motors or draws: median, mean, low, high, max, p05, p50, p95, p99; none for a single value.
        seed: which of several trainings.
        log: name of a log of the real robot.
        part: joint, excitation or feature, where each has a value of its own.
        seconds: how much log of the motors was known [s].
    """

    quantity: str
    unit: str
    value: float
    model: str | None = None
    motors: str | None = None
    statistic: str | None = None
    seed: int | None = None
    log: str | None = None
    part: str | None = None
    seconds: float | None = None


_COLUMNS = tuple(field.name for field in fields(Result))
_KINDS: dict[str, Field] = {"value": number(), "seed": integer(0, 2**31 - 1), "seconds": number(0.0)}
_OPTIONAL = frozenset(_COLUMNS[3:])


@dataclass(frozen=True)
class Results:
    """Rows in the order of their measurement."""

    rows: tuple[Result, ...] = ()

    @classmethod
    def of(cls, rows: Iterable[Result]) -> Results:
        """The table of some rows."""
        return cls(tuple(rows))

    def __iter__(self) -> Iterator[Result]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __add__(self, other: Results) -> Results:
        return Results(self.rows + other.rows)

    def where(self, **columns: Any) -> Results:
        """The rows with these values; a tuple stands for any of its values, None for no value."""
        wanted = {name: value if isinstance(value, tuple) else (value,) for name, value in columns.items()}
        return Results.of(row for row in self if all(getattr(row, name) in any_of for name, any_of in wanted.items()))

    def having(self, **columns: Any) -> Results:
        """The same rows with other values in some columns."""
        return Results.of(replace(row, **columns) for row in self)

    def distinct(self, column: str) -> list[Any]:
        """The values of a column, each once, in the order of the rows."""
        return list(dict.fromkeys(getattr(row, column) for row in self))

    def value(self, **columns: Any) -> float:
        """The value of the one row with these values.

        Raises:
            ArtifactError: there is none, or more than one.
        """
        found = self.where(**columns)
        if len(found) != 1:
            raise ArtifactError(f"{len(found)} results with {columns}, wanted one")
        return found.rows[0].value

    def mean(self, **columns: Any) -> float:
        """Mean value of the rows with these values, of several seeds for example.

        Raises:
            ArtifactError: there is none.
        """
        found = self.where(**columns)
        if not found:
            raise ArtifactError(f"no result with {columns}")
        return float(np.mean([row.value for row in found]))

    def to_figures(self) -> dict[str, float]:
        """Name -> value, as ``figures.json`` has them.

        What was measured on motors of both sets has names that end in the set, and that on the training motors a plain
        one, too; what was measured for several seeds also has a mean. The seconds of preset rollout stand for all.
        """
        figures: dict[str, float] = {}
        both = {row.quantity for row in self.where(motors="train")}
        both &= {row.quantity for row in self.where(motors="held_out")}
        for row in self:
            name = _name(row)
            if row.quantity in both:
                figures[f"{name}/{row.motors}"] = row.value
            if row.quantity not in both or row.motors == "train":
                figures[name] = row.value
            if row.seed is not None:
                seeds = {column: value for column, value in asdict(row).items() if column not in ("seed", "value")}
                figures[_name(replace(row, seed=None))] = self.mean(**seeds)
            if (row.quantity, row.model) == ("identify_seconds", "rollout"):
                figures[row.quantity] = row.value
        return figures

    def save(self, path: Path) -> None:
        """Write JSON, atomically."""
        rows = [{name: value for name, value in asdict(row).items() if value is not None} for row in self]
        write_json(path, {"schema_version": SCHEMA_VERSION, "rows": rows})

    @classmethod
    def load(cls, path: Path) -> Results:
        """Read what `save` wrote.

        Raises:
            ArtifactError: missing, damaged, or with a row that is none.
        """
        remedy = f"delete the folder {path.parent} and run the same command again"
        try:
            data = read_json(path)
        except ArtifactError as error:
            raise ArtifactError(error.problem, where=path, remedy=remedy) from error
        rows = Field("a list", lambda value: isinstance(value, list))
        Schema({"schema_version": exactly(SCHEMA_VERSION), "rows": rows}, remedy).check(data, path)
        row = Schema({name: _KINDS.get(name, TEXT) for name in _COLUMNS}, remedy, _OPTIONAL, "a row")
        for entry in data["rows"]:
            row.check(entry, path)
        return cls.of(Result(**entry) for entry in data["rows"])


def _name(row: Result) -> str:
    walked = row.motors in ("own", "twin")
    name = f"{row.motors}_{row.quantity}" if walked else row.quantity
    seconds = None if row.seconds is None else f"{row.seconds:g}"
    seed = None if row.seed is None else f"seed_{row.seed}"
    parts = (row.log, row.part, row.model, seconds, seed)
    return "/".join([name + _ENDINGS.get(row.statistic or "", ""), *(part for part in parts if part is not None)])
