"""Tables of models evaluated on logs, and of motor constants."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from motorprior.identification.evaluation.errors import LogErrors, summary
from motorprior.results import Result, Results

# quantities of the quick report: errors of free runs of whole segments and of 1 s, and the prefix of constants
WHOLE_RUN_RMSE, FREE_RUN_RMSE, CONSTANT = "real_motors_rmse", "real_motors_free_run_rmse", "real_motors_"
UNIDENTIFIED = "unidentified"  # statistic of a constant that the logs do not identify; its value is the median of a fit


def error_results(
    errors: LogErrors,
    quantity: str,
    statistics: Mapping[str | None, Callable[[np.ndarray], np.floating]] = MappingProxyType({None: np.nanmean}),
) -> Results:
    """Statistics of each model over all joints and logs; its means by joint and by log."""
    rows = []
    for model, values in errors.models.items():
        for statistic, function in statistics.items():
            rows.append(Result(quantity, "rad", float(function(values)), model, statistic=statistic))
        for column, names, table in (("part", errors.joints, values.T), ("log", errors.logs, values)):
            rows += [
                replace(Result(quantity, "rad", float(np.nanmean(row)), model), **{column: name})
                for name, row in zip(names, table, strict=True)
                if np.isfinite(row).any()
            ]
    return Results.of(rows)


def errors_by_joint(results: Results, quantity: str) -> dict[str, dict[str, float]]:
    """Model -> joint -> RMSE [rad]."""
    errors: dict[str, dict[str, float]] = {}
    for row in results.where(quantity=quantity, log=None):
        if row.model is not None and row.part is not None:
            errors.setdefault(row.model, {})[row.part] = row.value
    return errors


def error_table(results: Results, quantities: Mapping[str, str]) -> tuple[list[str], list[list[str]]]:
    """Columns and a row per model: median, mean and maximum over joints [mrad], with the joint of the maximum.

    Args:
        results: a row per model and joint.
        quantities: title of each quantity.
    """
    columns = [f"{title}, {name}" for title in quantities.values() for name in ("median", "mean", "max")]
    rows: dict[str, list[str]] = {}
    for quantity in quantities:
        for model, errors in errors_by_joint(results, quantity).items():
            rows.setdefault(model, [model]).extend(summary(errors))
    return ["model", *columns], list(rows.values())


def constant_table(constants: Mapping[str, Sequence[float] | np.ndarray]) -> tuple[list[str], list[list[str]]]:
    """Columns and a row per constant with its minimum, median and maximum over motors, or "not identifiable"."""
    rows = []
    for name, values in constants.items():
        cells = [f"{value:.3g}" for value in np.quantile(values, [0.0, 0.5, 1.0])] if len(values) else []
        rows.append([name, *(cells or ("", "not identifiable", ""))])
    return ["constant", "minimum", "median", "maximum"], rows


def constants_in(results: Results) -> dict[str, list[float]]:
    """Constants of a quick report, by name and unit: a value per motor, or none if the logs do not identify it."""
    found: dict[str, list[float]] = {}
    for row in results:
        if row.quantity.startswith(CONSTANT) and row.quantity not in (WHOLE_RUN_RMSE, FREE_RUN_RMSE):
            name = row.quantity.removeprefix(CONSTANT).replace("_", " ") + f" [{row.unit}]"
            found.setdefault(name, []).extend([] if row.statistic == UNIDENTIFIED else [row.value])
    return found
