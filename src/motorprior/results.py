"""Tidy table of measurements; the names in figures.json are made from its columns."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError
from motorprior.stage import FIGURES, RESULTS
from motorprior.texts import text_table

# suffix of a figure's name by statistic; others, such as the median, have none
_ENDINGS = {"mean": "_mean", "p05": "_p05", "p95": "_p95", "low": "/low", "high": "/high"}


@dataclass(frozen=True)
class Result:
    """One measurement."""

    quantity: str
    unit: str  # 1 for shares and ratios
    value: float  # finite
    model: str | None = None  # actuator model, or the one that a policy was trained on
    motors: str | None = None  # train or held_out; for a walk, own (training motors) or twin
    # statistic over motors or samples: median, mean, low, high, p05, p95
    statistic: str | None = None
    seed: int | None = None  # training seed
    log: str | None = None  # name of a log of the real robot
    part: str | None = None  # joint, excitation or feature
    seconds: float | None = None  # duration of the log of the motors [s]


class Results(tuple[Result, ...]):
    """Rows in the order of their measurement."""

    __slots__ = ()

    def __add__(self, other: tuple[Any, ...]) -> "Results":
        return Results((*self, *other))

    def __str__(self) -> str:
        named = [
            name
            for name in Result.__dataclass_fields__
            if any(getattr(row, name) is not None for row in self)
        ]
        rows = [[getattr(row, name) for name in named] for row in self]
        rows = [["" if cell is None else cell for cell in row] for row in rows]
        cells = [
            [f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row]
            for row in rows
        ]
        return text_table(named, cells)

    def where(self, **columns: Any) -> "Results":
        """Rows with these values; a tuple stands for any of its values, None for no value."""
        wanted = {
            name: value if isinstance(value, tuple) else (value,) for name, value in columns.items()
        }
        return Results(
            row
            for row in self
            if all(getattr(row, name) in any_of for name, any_of in wanted.items())
        )

    def distinct(self, column: str) -> list[Any]:
        """Distinct values of a column, in the order of the rows."""
        return list(dict.fromkeys(getattr(row, column) for row in self))

    def value(self, **columns: Any) -> float:
        """Value of the only row with these values; raises ValueError unless there is exactly one."""
        (row,) = self.where(**columns)
        return row.value

    def mean(self, **columns: Any) -> float:
        """Mean value of the rows with these values."""
        return float(np.mean([row.value for row in self.where(**columns)]))

    def to_figures(self) -> dict[str, float]:
        """Name -> value, as in ``figures.json``.

        A quantity measured on both training and held-out motors has two names with the suffix train
        or held_out, and its value on training motors also has the name without suffix. The mean
        over seeds has the name without seed.
        """
        figures: dict[str, float] = {}
        both = set.intersection(
            *({row.quantity for row in self.where(motors=name)} for name in ("train", "held_out"))
        )
        for row in self:
            name = _name(row)
            if row.quantity in both:
                figures[f"{name}/{row.motors}"] = row.value
            if row.quantity not in both or row.motors == "train":
                figures[name] = row.value
            if row.seed is not None:
                seeds = {
                    column: value
                    for column, value in asdict(row).items()
                    if column not in ("seed", "value")
                }
                figures[_name(replace(row, seed=None))] = self.mean(**seeds)
        return figures


def write_results(folder: Path, results: Results) -> None:
    """Write results.json (rows) and figures.json (name -> value), each atomically."""
    rows = [
        {name: value for name, value in asdict(row).items() if value is not None} for row in results
    ]
    write_json(folder / RESULTS, {"rows": rows})
    write_json(folder / FIGURES, results.to_figures())


def read_results(folder: Path) -> Results:
    """Results of a finished stage; raises ArtifactError if its file is missing or damaged."""
    path = folder / RESULTS
    try:
        return Results(Result(**row) for row in read_json(path)["rows"])
    except (KeyError, TypeError) as error:
        remedy = f"delete the folder {folder} and run the same command again"
        raise ArtifactError(
            f"not a table of results ({error})", where=path, remedy=remedy
        ) from error


def _name(row: Result) -> str:
    walked = f"{row.motors}_" if row.motors in ("own", "twin") else ""
    seconds = None if row.seconds is None else f"{row.seconds:g}"
    seed = None if row.seed is None else f"seed_{row.seed}"
    parts = (
        walked + row.quantity + _ENDINGS.get(row.statistic or "", ""),
        row.log,
        row.part,
        row.model,
        seconds,
        seed,
    )
    return "/".join(part for part in parts if part is not None)
