"""Evaluation of models in free runs over logs: errors, warnings, and traces of two joints."""

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
    TorqueMotors,
    WindowRuns,
    whole_runs,
)
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import MIN_WINDOW, POS, SECONDS, TARGET, training_data
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
DURATION = 1.0  # of a free run of FREE_RUN [s]
SPAN_TITLES = {FREE_RUN: "1 s", WHOLE_RUN: "whole log"}
# a model of a log's motors: motors that move the log's loads, or responses, which need no loads
MotorModel: TypeAlias = TorqueMotors | ResponseMotors


def free_runs(log: MotorLog, recipe: Recipe) -> dict[str, list[WindowRuns]]:
    """A log as free runs of DURATION (FREE_RUN) and of whole segments (WHOLE_RUN).

    If all segments are shorter, the first are as long as the longest segment after its warm-up.
    Raises errors as `training_data`.
    """
    max_rows = max(segment.stop - segment.start for segment in log.segment_slices())
    longest_run = max(MIN_WINDOW, max_rows - recipe.history - 1)
    window = min(round(DURATION / recipe.period), longest_run)
    recipe_with_unit = window_runs.with_gain_unit_of(recipe, log)
    short_recipe = replace(recipe_with_unit, objective="rollout", window=window)
    short_runs = WindowRuns(training_data(log, short_recipe, log.source), short_recipe)
    return {
        FREE_RUN: [short_runs],
        WHOLE_RUN: whole_runs(log, recipe),
    }


def angle_errors(runs: WindowRuns, motors: MotorModel) -> np.ndarray:
    """(M, N, W) simulated minus recorded angles [rad] of a model of the log's M motors."""
    if isinstance(motors, ResponseMotors):
        return motors.errors(runs)
    position_errors = runs.errors(motors)[:, :, 0]
    return POSITION_SCALE * position_errors


def free_run_errors(
    runs: Sequence[WindowRuns], models: Mapping[str, MotorModel]
) -> dict[str, np.ndarray]:
    """(M,) root-mean-square error [rad] of each model of the log's M motors, `capped`.

    The mean is over all samples of the runs.
    """
    errors = {}
    for name, motors in models.items():
        samples = []
        for windows in runs:
            samples.append(angle_errors(windows, motors).reshape(windows.num_motors, -1))
        all_samples = np.concatenate(samples, axis=1, dtype=np.float64)
        errors[name] = capped(rms(all_samples, axis=1))
    return errors


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
    """Errors of models on logs, and traces of two joints."""

    results: Results
    traces: list[Trace]
    warnings: list[str]
    constants: Constants | None = None  # constants of the fitted models

    def overview(self) -> Overview:
        """Errors of every model over the joints."""
        titles = {}
        for row in self.results:
            if row.part is not None:
                titles[row.quantity] = row.quantity.removesuffix("_rmse")
        facts = {}
        if self.warnings:
            facts["warnings"] = f"{len(self.warnings)}, see `warnings`"
        columns, rows = error_table(self.results, titles)
        return Overview("joint RMSE [mrad] of free runs", facts, columns, rows)


def log_errors(
    logs: Mapping[str, MotorLog], errors: Sequence[Mapping[str, np.ndarray]]
) -> LogErrors:
    """Errors (J,) of each model on each of the logs; joints that are not excited are NaN."""
    tables = {}
    for model in errors[0]:
        tables[model] = np.stack([errors_on_log[model] for errors_on_log in errors])

    for row, log in enumerate(logs.values()):
        is_excited = np.isin(np.arange(log.num_joints), excited_joints(log))
        for table in tables.values():
            table[row, ~is_excited] = np.nan
    joint_names = next(iter(logs.values())).joint_names
    return LogErrors(tuple(logs), joint_names, tables)


def median_and_max(values: np.ndarray) -> list[tuple[int, int]]:
    """Log and joint with the median error, and with the maximum error, of errors (L, J).

    If both have the same log and joint, it is returned once.
    """
    num_finite = int(np.isfinite(values).sum())
    order = np.argsort(values, axis=None)[:num_finite]  # NaN is last
    places = []
    for index in (order[len(order) // 2], order[-1]):
        log, joint = np.unravel_index(index, values.shape)
        place = (int(log), int(joint))
        if place not in places:
            places.append(place)
    return places


def validation_of(
    logs: Mapping[str, MotorLog],
    runs: Mapping[str, Mapping[str, Sequence[WindowRuns]]],
    quantities: Mapping[str, str],
    models: Mapping[str, MotorModel],
    main_model: str,
    plotted: Collection[str],
    statistics: Statistics = MEAN,
    failed: Collection[str] = (),
) -> Validation:
    """Free-run errors of several models on test logs.

    Args:
        logs: the test logs, by name, all of the same joints.
        runs: log -> span, FREE_RUN or WHOLE_RUN -> free runs of the log, as from `free_runs`.
        quantities: span -> name of its errors in the results; WHOLE_RUN is needed.
        models: models of the motors of the logs' joints, by name.
        main_model: name of the model that the warnings are about; there are warnings only if
            ``models`` has a tuned PD. The traces show the longest runs of the joints with this
            model's median and maximum error.
        plotted: names of the models in the traces.
        statistics: over joints and logs.
        failed: names of models that could not be fitted; their errors are MAX_ERROR.
    """
    num_joints = next(iter(logs.values())).num_joints
    failures = dict.fromkeys(failed, np.full(num_joints, MAX_ERROR))
    errors = {}
    results = Results()
    for span, quantity in quantities.items():
        errors_of_logs = []
        for name in logs:
            errors_of_models = free_run_errors(runs[name][span], models)
            errors_of_logs.append(errors_of_models | failures)
        errors[span] = log_errors(logs, errors_of_logs)
        results += error_results(errors[span], quantity, statistics)

    whole_run_errors = errors[WHOLE_RUN]
    warnings = whole_run_errors.warnings(main_model) if TUNED_PD in models else []
    traces = []
    for log, joint in median_and_max(whole_run_errors.models[main_model]):
        name = whole_run_errors.logs[log]
        longest_run = max(runs[name][WHOLE_RUN], key=lambda windows: windows.recipe.window)
        traces.append(
            _trace(name, whole_run_errors.joints[joint], longest_run, joint, models, plotted)
        )
    return Validation(results, traces, warnings)


def _trace(
    log_name: str,
    joint_name: str,
    runs: WindowRuns,
    joint: int,
    models: Mapping[str, MotorModel],
    plotted: Collection[str],
) -> Trace:
    """Trace of one joint in the first window of the runs."""
    time = runs.recorded(SECONDS)[joint, 0]
    target = runs.recorded(TARGET)[joint, 0]
    measured = runs.recorded(POS)[joint, 0]
    simulated = {}
    for model in plotted:
        simulated[model] = measured + angle_errors(runs, models[model])[joint, 0]
    return Trace(log_name, joint_name, time, target, measured, simulated)


def error_results(errors: LogErrors, quantity: str, statistics: Statistics = MEAN) -> Results:
    """Statistics of each model over all joints and logs; its means by joint and by log."""
    rows = []
    for model, values in errors.models.items():
        for statistic, function in statistics.items():
            value = float(function(values))
            rows.append(Result(quantity, "rad", value, model, statistic=statistic))
        for joint, joint_errors in zip(errors.joints, values.T, strict=True):
            if np.isfinite(joint_errors).any():
                value = float(np.nanmean(joint_errors))
                rows.append(Result(quantity, "rad", value, model, part=joint))
        for log, log_values in zip(errors.logs, values, strict=True):
            if np.isfinite(log_values).any():
                value = float(np.nanmean(log_values))
                rows.append(Result(quantity, "rad", value, model, log=log))
    return Results(rows)


def errors_by_joint(results: Results, quantity: str) -> dict[str, dict[str, float]]:
    """Model -> joint -> root-mean-square error [rad]."""
    errors: dict[str, dict[str, float]] = {}
    for row in results.where(quantity=quantity, log=None):
        if row.model is not None and row.part is not None:
            errors.setdefault(row.model, {})[row.part] = row.value
    return errors


def error_table(
    results: Results, quantities: Mapping[str, str]
) -> tuple[list[str], list[list[str]]]:
    """Columns and a row per model: median, mean and maximum over joints [mrad] of each quantity.

    ``quantities`` are their titles by name.
    """
    columns = ["model"]
    for title in quantities.values():
        columns += [f"{title}, {statistic}" for statistic in ("median", "mean", "max")]
    rows: dict[str, list[str]] = {}
    for quantity in quantities:
        for model, errors in errors_by_joint(results, quantity).items():
            rows.setdefault(model, [model]).extend(summary(errors))
    return columns, list(rows.values())
