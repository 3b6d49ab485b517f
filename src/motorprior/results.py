"""Tidy table of measurements; the names in figures.json are made from its columns."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError
from motorprior.stage import FIGURES, RESULTS
from motorprior.texts import html_table, text_table

# suffix of a figure's name by statistic; other statistics, such as the median, have no suffix
_ENDINGS = {"mean": "_mean", "p05": "_p05", "p95": "_p95", "low": "/low", "high": "/high"}


@dataclass(frozen=True)
class Result:
    """One measurement."""

    quantity: str
    unit: str  # 1 for shares and ratios
    value: float  # finite
    model: str | None = None  # actuator model, or the one that a policy was trained on
    # train or held_out motors; for walks own (the motors of the training) or twin (held-out robots)
    motors: str | None = None
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
        return text_table(*self._table())

    def _repr_html_(self) -> str:  # of notebooks
        return html_table(*self._table())

    def _table(self) -> tuple[list[str], list[list[str]]]:
        """Names of the columns with any value, and the cells."""
        columns = []
        for name in Result.__dataclass_fields__:
            if any(getattr(row, name) is not None for row in self):
                columns.append(name)
        cells = []
        for row in self:
            cells.append([_cell(getattr(row, name)) for name in columns])
        return columns, cells

    def where(self, **columns: Any) -> "Results":
        """Rows whose columns have these values.

        A tuple selects rows with any of its values. None selects rows without a value.
        """
        allowed = {
            name: value if isinstance(value, tuple) else (value,) for name, value in columns.items()
        }

        def is_selected(row: Result) -> bool:
            return all(getattr(row, name) in values for name, values in allowed.items())

        return Results(filter(is_selected, self))

    def distinct(self, column: str) -> list[Any]:
        """Distinct values of a column, in the order of the rows."""
        return list(dict.fromkeys(getattr(row, column) for row in self))

    def value(self, **columns: Any) -> float:
        """Value of the only row with these values; ValueError if there are none or several."""
        (row,) = self.where(**columns)
        return row.value

    def mean(self, **columns: Any) -> float:
        """Mean value of the rows with these values."""
        return float(np.mean([row.value for row in self.where(**columns)]))

    def to_figures(self) -> dict[str, float]:
        """Name -> value, as in ``figures.json``.

        A quantity that was measured on both training and held-out motors has two values, NAME/train
        and NAME/held_out; NAME without suffix is the value on training motors. A quantity that was
        measured for several seeds has a value per seed, and their mean under the name without seed.
        """
        figures: dict[str, float] = {}
        on_training_motors = set(self.where(motors="train").distinct("quantity"))
        on_held_out_motors = set(self.where(motors="held_out").distinct("quantity"))
        on_both = on_training_motors & on_held_out_motors
        for row in self:
            name = _name(row)
            if row.quantity in on_both:
                figures[f"{name}/{row.motors}"] = row.value
                if row.motors == "train":
                    figures[name] = row.value
            else:
                figures[name] = row.value

            if row.seed is not None:
                name_without_seed = _name(replace(row, seed=None))
                all_seeds = asdict(row)
                del all_seeds["seed"]
                del all_seeds["value"]
                figures[name_without_seed] = self.mean(**all_seeds)
        return figures


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def write_results(folder: Path, results: Results) -> None:
    """Write results.json (rows) and figures.json (name -> value), each atomically."""
    rows = []
    for row in results:
        rows.append({name: value for name, value in asdict(row).items() if value is not None})
    write_json(folder / RESULTS, {"rows": rows})
    write_json(folder / FIGURES, results.to_figures())


def read_results(folder: Path) -> Results:
    """Results of a finished stage; raises ArtifactError if its file is missing or damaged."""
    path = folder / RESULTS
    try:
        return Results(Result(**row) for row in read_json(path)["rows"])
    except (KeyError, TypeError) as error:
        problem = f"not a table of results ({error})"
        remedy = f"delete the folder {folder} and run the same command again"
        raise ArtifactError(problem, where=path, remedy=remedy) from error


def _name(row: Result) -> str:
    """Name of a row in figures.json, such as twin_upright_mean/prior/seed_0."""
    environment = f"{row.motors}_" if row.motors in ("own", "twin") else ""
    ending = _ENDINGS.get(row.statistic or "", "")
    seconds = None if row.seconds is None else f"{row.seconds:g}"
    seed = None if row.seed is None else f"seed_{row.seed}"
    words = (f"{environment}{row.quantity}{ending}", row.log, row.part, row.model, seconds, seed)
    return "/".join(word for word in words if word is not None)
