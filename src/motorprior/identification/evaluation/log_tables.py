"""Tables of models evaluated on logs, and of motor constants."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from motorprior.results import Results

MAX_ERROR = math.tau  # [rad]; an error that is larger, or not finite, counts as this one: the simulation diverged
# quantities of the quick report: errors of free runs of whole segments and of 1 s, and the prefix of constants
WHOLE_RUN_RMSE, FREE_RUN_RMSE, CONSTANT = "real_motors_rmse", "real_motors_free_run_rmse", "real_motors_"
UNIDENTIFIED = "not_shown"  # statistic of a constant that the logs do not identify; its value is the median of a fit


def capped(errors: np.ndarray, limit: np.ndarray | float = MAX_ERROR) -> np.ndarray:
    """The errors, at most ``limit``, which is also the error of a simulation that diverged."""
    return np.minimum(np.where(np.isnan(errors), limit, errors), limit)


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
            rows.setdefault(model, [model]).extend(_summary(errors))
    return ["model", *columns], list(rows.values())


def error_line(results: Results, quantity: str) -> str:
    """The same in a line."""
    parts = []
    for model, errors in errors_by_joint(results, quantity).items():
        median, mean, maximum = _summary(errors)
        parts.append(f"{model} median {median}, mean {mean}, max {maximum}")
    return f"replayed log, joint RMSE [mrad]: {'; '.join(parts)}"


def _summary(errors: Mapping[str, float]) -> tuple[str, str, str]:
    """Median, mean and maximum [mrad]."""
    values = np.array(list(errors.values()))
    median, mean, maximum = (
        f"{1e3 * value:.1f}" if value < MAX_ERROR else "diverged"
        for value in (np.median(values), np.mean(values), np.max(values))
    )
    return median, mean, f"{maximum} ({list(errors)[int(values.argmax())]})"


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
