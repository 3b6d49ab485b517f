"""Tables of models evaluated on logs and of motor constants, and the traces that a page draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from motorprior.results import Results

# quantities of the quick report: errors of free runs of whole segments and of 1 s, and the prefix of constants
WHOLE_RUN, FREE_RUN, CONSTANT = "real_motors_rmse", "real_motors_free_run_rmse", "real_motors_"
UNIDENTIFIED = "not_shown"  # statistic of a constant that the logs do not identify; its value is the median of a fit


@dataclass(frozen=True)
class Trace:
    """One joint of one log: (T,) time [s], target, measured and simulated angles by model [rad]."""

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
    values = 1e3 * np.array(list(errors.values()))
    joint = list(errors)[int(values.argmax())]
    return f"{np.median(values):.1f}", f"{np.mean(values):.1f}", f"{np.max(values):.1f} ({joint})"


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
        if row.quantity.startswith(CONSTANT) and row.quantity not in (WHOLE_RUN, FREE_RUN):
            name = row.quantity.removeprefix(CONSTANT).replace("_", " ") + f" [{row.unit}]"
            found.setdefault(name, []).extend([] if row.statistic == UNIDENTIFIED else [row.value])
    return found
