"""Errors of a prior and of baselines on held-out rows of a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_text
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import ConfigError, LogError
from motorprior.identification.adapt import adapt_to, note_training_log
from motorprior.identification.evaluation.errors import MAX_ERROR, PRIOR, TUNED_PD, LogErrors, log_warnings
from motorprior.identification.evaluation.free_runs import (
    WHOLE_RUN,
    MotorModel,
    free_run_errors,
    free_runs,
    traces,
    write_traces,
)
from motorprior.identification.evaluation.log_tables import error_results
from motorprior.identification.fit_prior import trained_on
from motorprior.identification.log_baselines import baseline_recipes, fitted_baselines
from motorprior.identification.presets import recipe_of
from motorprior.identification.prior_file import load_prior
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.logs.splits import first_and_rest, train_test_halves
from motorprior.progress import SILENT, Progress
from motorprior.results import Result, Results
from motorprior.stage import PAGE, description, is_finished, read_results, working, write_results

SPANS = {"free_run_rmse": "1 s", "whole_run_rmse": "whole log"}  # quantity -> free runs
COVERAGE = {"free_run_rmse": "coverage", "whole_run_rmse": "whole_run_coverage"}
ADAPTED = "adapted"
TRAINED_ON = "prior_was_trained_on_this_log"


@dataclass(frozen=True)
class ValidateLog:
    """Measure the errors of a prior's motors and of baselines in free runs on a held-out log."""

    prior: Path
    """Prior that `motorprior identify` wrote from other logs of the robot that the log names."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period, of any motors."""
    out: Path
    """Folder for figures.json and report.html."""
    fitted_on: tuple[Path, ...] = ()
    """Other logs of the same motors: the prior is adapted to them, the baselines are fitted to them, and the whole log
    is the test. If none is given, the log's first half is used for this and its second half is the test."""
    seconds: float | None = None
    """Use the log's first seconds [s] in place of its first half; not with fitted_on."""
    adam_steps: int | None = None
    """Adam steps of the pooled network; the preset's own number if not given."""
    seed: int = 0
    """Seed of the baselines' searches and weights."""


def run_validate_log(config: ValidateLog, progress: Progress = SILENT) -> Results:
    """Measure, or read the results if the folder holds them already.

    Returns:
        ``free_run_rmse`` [rad] of free runs of 1 s and ``whole_run_rmse`` [rad] of free runs of whole segments: median
        and mean over motors, and of each motor (``part``). Models: ADAPTED, the prior adapted to the training rows;
        PRIOR, its motor of the same name or else its central motor; and the baselines of `log_baselines`.
        ``coverage50``, ``coverage90``, ``whole_run_coverage50`` and ``whole_run_coverage90`` of samples of the
        posterior and of z ~ N(0, I). TRAINED_ON: 1 if the prior was trained on the log, so that the figures are not
        a test, otherwise 0.

    Raises:
        LogError, ArtifactError: a log or a prior that cannot be used.
        ConfigError: a number out of range, seconds together with fitted_on, or a prior of another robot.
    """
    require_seed(config.seed)
    if config.adam_steps is not None:
        require_count("adam_steps", config.adam_steps)
    log = replace(read_parquet(config.log), source=str(config.log))
    prior, (train, test) = load_prior(config.prior, log), _train_and_test(config, log)
    wanted = description("validate-log", asdict(config), [config.prior, config.log, *config.fitted_on])
    note_training_log(prior, log, progress)
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            results = _measure(config, prior, train, test, progress)
            trained = Result(TRAINED_ON, "1", float(trained_on(prior, log)))
            write_results(config.out, results + Results.of([trained]))
            _write_page(config)
    return read_results(config.out)


def _train_and_test(config: ValidateLog, log: MotorLog) -> tuple[MotorLog, MotorLog]:
    if config.seconds is not None and config.fitted_on:
        raise ConfigError("seconds given together with fitted_on", remedy="omit one of them", argument="seconds")
    if not config.fitted_on:
        return train_test_halves(log) if config.seconds is None else first_and_rest(log, config.seconds)
    train = joined([read_parquet(path) for path in config.fitted_on])
    if train.joint_names != log.joint_names:
        problem = f"joints {', '.join(train.joint_names)}; {config.log} has {', '.join(log.joint_names)}"
        remedy = "give logs of the same joints in the same order"
        raise LogError(problem, where=config.fitted_on[0], remedy=remedy)
    return replace(train, source=", ".join(map(str, config.fitted_on))), log


def _measure(config: ValidateLog, prior: MotorPrior, train: MotorLog, test: MotorLog, progress: Progress) -> Results:
    from motorprior.identification.evaluation.bench_truth import log_coverage, zero_shot

    preset = recipe_of(prior)
    for line in log_warnings(test, preset):
        progress.note(line)
    runs = free_runs(test, preset)
    baseline_recipes(train, preset)  # a log that is too short is an error before anything is fitted
    with progress.start(f"adapt to {train.num_joints} motors", 1) as task:
        posterior = adapt_to(prior, train)
        task.advance()
    models: dict[str, MotorModel] = {
        ADAPTED: prior.model.motors(posterior.mean),
        PRIOR: prior.model.motors(prior.expected(test.joint_names)),
    }
    baselines = fitted_baselines(train, preset, config.out / "baselines", config.adam_steps, config.seed, progress)
    models |= {name: motors for name, motors in baselines.items() if motors is not None}
    failed = {name: np.full((1, test.num_joints), MAX_ERROR) for name, motors in baselines.items() if motors is None}
    results, errors = Results(), {}
    with progress.start("free runs", len(runs)) as task:
        for span, each in runs.items():
            quantity = f"{span}_rmse"  # a key of SPANS
            found = {name: values[None] for name, values in free_run_errors(each, models).items()}
            errors[span] = LogErrors((test.source,), test.joint_names, found | failed)
            results += error_results(errors[span], quantity, {"median": np.median, "mean": np.mean}).where(log=None)
            results += Results.of(
                Result(f"{COVERAGE[quantity]}{level}", "1", share, model)
                for model, motors in ((ADAPTED, posterior), (PRIOR, zero_shot(prior, test.num_joints)))
                for level, share in log_coverage(prior, motors, each).items()
            )
            task.advance()
    warnings = errors[WHOLE_RUN].warnings(ADAPTED)
    for line in warnings:
        progress.note(line)
    drawn = traces(errors[WHOLE_RUN], ADAPTED, {test.source: runs[WHOLE_RUN]}, models, (TUNED_PD, PRIOR, ADAPTED))
    write_traces(config.out, drawn, warnings)
    return results


def _write_page(config: ValidateLog) -> None:
    from motorprior.report.chapters import validated_log
    from motorprior.report.page import page  # here: it imports matplotlib

    title = f"Motors in a held-out log: {config.log.name}"
    write_text(config.out / PAGE, page(title, [validated_log(config.out)], asdict(config), repr(config)))
