"""What a comparison of real motors is made of, and the rows of its tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from motorprior.results import Results

RMSE, FREE_RUN = "real_motors_rmse", "real_motors_free_run_rmse"
"""Errors of free runs of whole stretches of log, and of a second."""
CONSTANT = "real_motors_"
"""Prefix of `Result.quantity` in rows of a motor constant. The value is that of the joint named by ``part``; in a row
without ``part`` it is what ``statistic`` says: a quantile of a fleet's draws, or the motors' median (UNIDENTIFIED)."""
UNIDENTIFIED = "not_shown"
"""Statistic of a constant that the logs do not show: its value is that of a fit, not of the motors."""
NAMES = {
    "ideal_pd": "an ideal PD", "tuned_pd": "one tuned PD", "prior": "the prior", "prior_mean": "its central motor",
    "pure_delay": "a pure delay", "second_order": "second order + delay", "servo_limits": "the same with limits",
    "physical": "the central motor of the fleet", "physical_draws": "draws of the fleet",
}  # fmt: skip
"""Models in the order of tables, in words."""


@dataclass(frozen=True)
class Trace:
    """One joint of one log.

    Attributes:
        log: its name.
        joint: its name.
        time: (T,) [s].
        target: (T,) [rad].
        measured: (T,) [rad].
        models: (T,) by model [rad].
    """

    log: str
    joint: str
    time: np.ndarray
    target: np.ndarray
    measured: np.ndarray
    models: dict[str, np.ndarray]


def as_tensors(traces: tuple[Trace, ...]) -> tuple[dict[str, np.ndarray], list[list[str]]]:
    """Arrays by name, and log and joint of each trace."""
    arrays = {}
    for index, trace in enumerate(traces):
        arrays |= {f"{index}/{name}": getattr(trace, name) for name in ("time", "target", "measured")}
        arrays |= {f"{index}/model/{name}": values for name, values in trace.models.items()}
    return arrays, [[trace.log, trace.joint] for trace in traces]


def from_tensors(tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> list[Trace]:
    """The traces that `as_tensors` wrote; ``header`` has its second value as ``traces``."""
    found = []
    for index, (log, joint) in enumerate(header["traces"]):
        prefix = f"{index}/model/"
        models = {name.removeprefix(prefix): values for name, values in tensors.items() if name.startswith(prefix)}
        time, target, measured = (tensors[f"{index}/{name}"] for name in ("time", "target", "measured"))
        found.append(Trace(log, joint, time, target, measured, models))
    return found


def models_in(results: Results, quantity: str = RMSE) -> list[str]:
    """Models of a comparison, in the order of NAMES."""
    found = results.where(quantity=quantity).distinct("model")
    return [name for name in NAMES if name in found]


def error_rows(results: Results) -> list[list[str]]:
    """RMSE [mrad] per joint, mean over its logs, of all `models_in` the results; then per log, and the mean of all."""
    errors, rows = results.where(quantity=RMSE), []
    models = models_in(results)
    for column in ("part", "log"):
        for name in errors.distinct(column):
            if name is not None:
                rows.append([name, *(_milli(errors.where(**{column: name, "model": model})) for model in models)])
    whole = errors.where(part=None, log=None)
    return [*rows, ["mean", *(_milli(whole.where(model=model)) for model in models)]]


def _milli(found: Results) -> str:
    return f"{1e3 * found.rows[0].value:.1f}" if len(found) else "–"


@dataclass(frozen=True)
class ConstantTable:
    """Constants of motors, beside a fleet's if there is one; no rows where there are no constants.

    Attributes:
        caption: what it shows.
        columns: the constant with its unit; the motor's value or, of several, the least, median and most; 5 % and 95 %
            of the fleet's draws.
        rows: one per constant.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def constant_table(results: Results) -> ConstantTable:
    """Of a comparison's constants."""
    constants = _of_constants(results)
    alone = len({row.part for row in constants} - {None}) == 1
    motors = ("your motor",) if alone else ("least", "median", "most")
    fleet = {"p05": "fleet 5 %", "p95": "fleet 95 %"} if constants.where(statistic="p05") else {}
    caption = (
        "Constants of your motor"
        + ("" if alone else "s")
        + (", and 90 % of the draws of the fleet beside which they stand" if fleet else "")
    )
    rows = tuple(
        _constant_row(constants.where(quantity=quantity), len(motors), tuple(fleet))
        for quantity in constants.distinct("quantity")
    )
    return ConstantTable(caption, ("constant", *motors, *fleet.values()), rows)


def _of_constants(results: Results) -> Results:
    rows = (row for row in results.rows if row.quantity.startswith(CONSTANT))
    return Results.of(row for row in rows if row.quantity not in (RMSE, FREE_RUN))


def _constant_row(of: Results, columns: int, fleet: tuple[str, ...]) -> tuple[str, ...]:
    """Of one constant, with so many ``columns`` for the motors and those quantiles of the fleet."""
    values = [row.value for row in of if row.part is not None]
    if of.where(statistic=UNIDENTIFIED):
        shown = ["not shown by the logs"] if columns == 1 else ["–", "not shown by the logs", "–"]
    else:
        shown = [f"{value:.3g}" for value in np.quantile(values, np.linspace(0.0, 1.0, columns))]
    ends = [of.where(statistic=statistic) for statistic in fleet]
    name, unit = of.rows[0].quantity.removeprefix(CONSTANT).replace("_", " "), of.rows[0].unit
    named = f"{name} [{unit}]" if unit != "1" else name
    return (named, *shown, *(f"{each.value():.3g}" if len(each) else "–" for each in ends))
