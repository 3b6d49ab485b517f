"""Evaluation of models in free runs over logs: errors with their tables, warnings, and traces of two joints."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from motorprior.actuator.constants import Constants
from motorprior.evaluation.errors import MAX_ERROR, TUNED_PD, LogErrors, capped, summary
from motorprior.identification.baselines.response_fit import ResponseMotors
from motorprior.identification.physics import window_runs
from motorprior.identification.physics.window_runs import (
    POSITION_SCALE,
    MotorsOnLoads,
    WindowRuns,
    whole_runs,
)
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import POS, SECONDS, TARGET, training_data
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import excited_joints
from motorprior.results import Result, Results
from motorprior.signals import rms
from motorprior.texts import Overview, Printable

# name in results -> function
Statistics: TypeAlias = Mapping[str | None, Callable[[np.ndarray], np.floating]]
MEAN: Statistics = MappingProxyType({None: np.nanmean})
MEDIAN_AND_MEAN: Statistics = MappingProxyType({"median": np.nanmedian, "mean": np.nanmean})
FREE_RUN = "free_run"
WHOLE_RUN = "whole_run"
DURATION = 1.0  # of a FREE_RUN [s]
# models of a log's motors: on its loads, or responses that need no loads
MotorModel: TypeAlias = MotorsOnLoads | ResponseMotors


def free_runs(log: MotorLog, preset: Recipe) -> dict[str, list[WindowRuns]]:
    """A log as free runs of DURATION (FREE_RUN) and of whole segments (WHOLE_RUN); raises as `training_data`."""
    window = round(DURATION / preset.period)
    short = replace(window_runs.with_gains_of(preset, log), objective="rollout", window=window)
    return {
        FREE_RUN: [WindowRuns(training_data(log, short, log.source), short)],
        WHOLE_RUN: whole_runs(log, preset),
    }


def angle_errors(runs: WindowRuns, motors: MotorModel) -> np.ndarray:
    """(M, N, W) simulated minus recorded angles [rad] of a model of the log's M motors."""
    return (
        motors.errors(runs)
        if isinstance(motors, ResponseMotors)
        else POSITION_SCALE * runs.errors(motors)[:, :, 0]
    )


def free_run_errors(
    runs: Sequence[WindowRuns], models: Mapping[str, MotorModel]
) -> dict[str, np.ndarray]:
    """(M,) root mean square error [rad] of each model of the log's M motors over all samples, `capped`."""
    found = {}
    for name, motors in models.items():
        parts = [angle_errors(one, motors).reshape(one.num_motors, -1) for one in runs]
        found[name] = capped(rms(np.concatenate(parts, axis=1, dtype=np.float64), axis=1))
    return found


@dataclass(frozen=True)
class Trace:
    """One joint of one log: (T,) time [s], target, measured and simulated angles by model [rad]."""

    log: str
    joint: str
    time: np.ndarray
    target: np.ndarray
    measured: np.ndarray
    models: dict[str, np.ndarray]


@dataclass(frozen=True, repr=False)
class Validation(Printable):
    """Errors, and traces of two joints."""

    results: Results
    traces: list[Trace]
    warnings: list[str]
    constants: Constants | None = None  # constants of the fitted models

    def overview(self) -> Overview:
        """Errors of every model over the joints."""
        by_joint = [row.quantity for row in self.results if row.part is not None]
        titles = {quantity: quantity.removesuffix("_rmse") for quantity in by_joint}
        facts = {"warnings": f"{len(self.warnings)}, see `warnings`" if self.warnings else ""}
        return Overview("joint RMSE [mrad] of free runs", facts, *error_table(self.results, titles))


def log_errors(
    logs: Mapping[str, MotorLog], errors: Sequence[Mapping[str, np.ndarray]]
) -> LogErrors:
    """Errors (J,) of each model on each of the logs; joints that are not excited are NaN."""
    tables = {name: np.stack([found[name] for found in errors]) for name in errors[0]}
    for row, log in enumerate(logs.values()):
        static = np.isin(np.arange(log.num_joints), excited_joints(log), invert=True)
        for table in tables.values():
            table[row, static] = np.nan
    return LogErrors(tuple(logs), next(iter(logs.values())).joint_names, tables)


def median_and_max(values: np.ndarray) -> list[tuple[int, int]]:
    """Log and joint of the median and of the maximum of errors (L, J); once if they are the same."""
    order = np.argsort(values, axis=None)[: int(np.isfinite(values).sum())]  # NaN is last
    places = [np.unravel_index(order[rank], values.shape) for rank in (len(order) // 2, -1)]
    return list(dict.fromkeys((int(log), int(joint)) for log, joint in places))


def validation_of(
    logs: Mapping[str, MotorLog],
    runs: Mapping[str, Mapping[str, Sequence[WindowRuns]]],
    models: Mapping[str, MotorModel],
    main_model: str,
    plotted: Collection[str],
    statistics: Statistics = MEAN,
    failed: Collection[str] = (),
) -> Validation:
    """Errors of models of the motors of some joints in free runs over their test logs.

    ``runs`` are by quantity and log; the last quantity is that of whole segments. Warnings are
    about ``main_model``, if there is a tuned PD; traces are of the ``plotted`` models, in the
    longest runs of the joints with its median and maximum error. The ``statistics`` are over joints
    and logs. The errors of ``failed`` models, which were not fitted, are MAX_ERROR.
    """
    errors = {}
    for quantity, of_logs in runs.items():
        found = [free_run_errors(of_logs[name], models) for name in logs]
        failures = dict.fromkeys(failed, np.full(next(iter(logs.values())).num_joints, MAX_ERROR))
        errors[quantity] = log_errors(logs, [each | failures for each in found])
    whole = list(errors.values())[-1]
    whole_runs_of = list(runs.values())[-1]
    results = sum(
        (error_results(each, quantity, statistics) for quantity, each in errors.items()), Results()
    )
    warnings = whole.warnings(main_model) if TUNED_PD in models else []
    traces = []
    for log, joint in median_and_max(whole.models[main_model]):
        name = whole.logs[log]
        longest_run = max(whole_runs_of[name], key=lambda run: run.recipe.window)
        time, target, measured = (
            longest_run.recorded(channel)[joint, 0] for channel in (SECONDS, TARGET, POS)
        )
        simulated = {
            key: measured + angle_errors(longest_run, models[key])[joint, 0] for key in plotted
        }
        traces.append(Trace(name, whole.joints[joint], time, target, measured, simulated))
    return Validation(results, traces, warnings)


def error_results(errors: LogErrors, quantity: str, statistics: Statistics = MEAN) -> Results:
    """Statistics of each model over all joints and logs; its means by joint and by log."""
    rows = []
    for model, values in errors.models.items():
        for statistic, function in statistics.items():
            rows.append(
                Result(quantity, "rad", float(function(values)), model, statistic=statistic)
            )
        for column, names, table in (
            ("part", errors.joints, values.T),
            ("log", errors.logs, values),
        ):
            rows += [
                replace(Result(quantity, "rad", float(np.nanmean(row)), model), **{column: name})
                for name, row in zip(names, table, strict=True)
                if np.isfinite(row).any()
            ]
    return Results(rows)


def errors_by_joint(results: Results, quantity: str) -> dict[str, dict[str, float]]:
    """Model -> joint -> RMSE [rad]."""
    errors: dict[str, dict[str, float]] = {}
    for row in results.where(quantity=quantity, log=None):
        if row.model is not None and row.part is not None:
            errors.setdefault(row.model, {})[row.part] = row.value
    return errors


def error_table(
    results: Results, quantities: Mapping[str, str]
) -> tuple[list[str], list[list[str]]]:
    """Columns and a row per model: median, mean and maximum over joints [mrad] of each quantity, by its title."""
    columns = [
        f"{title}, {name}" for title in quantities.values() for name in ("median", "mean", "max")
    ]
    rows: dict[str, list[str]] = {}
    for quantity in quantities:
        for model, errors in errors_by_joint(results, quantity).items():
            rows.setdefault(model, [model]).extend(summary(errors))
    return ["model", *columns], list(rows.values())
