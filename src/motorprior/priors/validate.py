"""Validate a prior on a log: errors of its motors and of baselines, fitted to the same rows, on held-out rows."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bounds import require_count, require_seed
from motorprior.evaluation.bands import log_coverage, zero_shot
from motorprior.evaluation.errors import PRIOR, TUNED_PD, notes_on_log
from motorprior.evaluation.free_runs import (
    MEDIAN_AND_MEAN,
    MotorModel,
    Validation,
    free_runs,
    validation_of,
)
from motorprior.evaluation.splits import first_and_rest
from motorprior.exceptions import ConfigError, LogError, MotorPriorError
from motorprior.identification import presets
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.baselines.response_fit import fitted_responses
from motorprior.identification.presets import Recipe, recipe_of
from motorprior.identification.windows import window_starts, with_window_that_fits
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined, train_test_halves
from motorprior.priors.adapt import adapt_to, note_training_log
from motorprior.priors.fit_prior import fit_recipe, trained_on
from motorprior.priors.prior_file import require_adaptable
from motorprior.progress import SHOWN, SILENT, Progress
from motorprior.results import Result, Results

SPANS = {"free_run_rmse": "1 s", "whole_run_rmse": "whole log"}  # quantity -> free runs
COVERAGE = {"free_run_rmse": "coverage", "whole_run_rmse": "whole_run_coverage"}
ADAPTED = "adapted"
TRAINED_ON = "prior_was_trained_on_this_log"
# baseline -> preset of identification: the physics of each motor fitted alone, and one network for
# all motors
BASELINE_PRESETS = {"per_motor": "pace", "pooled_network": "one_network"}
# for a prior of preset long_runs or quick, which are for servos with much friction
LONG_RUNS = {
    "per_motor": "pace_long_runs",
    "coulomb_viscous": "coulomb_viscous",
    "stribeck": "stribeck",
}
# sample period of these presets [s]; priors with another period have no such baselines
BASELINE_PERIOD = 0.002


def validate(
    prior: MotorPrior,
    log: MotorLog,
    *,
    fitted_on: Sequence[MotorLog] = (),
    seconds: float | None = None,
    adam_steps: int | None = None,
    seed: int = 0,
    folder: Path | None = None,
    progress: Progress = SHOWN,
) -> Validation:
    """Errors of a prior's motors and of baselines in free runs on the held-out rows of a log.

    Args:
        prior: of motors of this kind, from other logs.
        log: with load_inertia and external_torque, at the prior's sample period.
        fitted_on: other logs of the same motors: the prior is adapted to them, the baselines are
            fitted to them, and the whole log is the test. If none is given, the log's first half is
            used for this.
        seconds: use the log's first seconds [s] in place of its first half; not with ``fitted_on``.
        adam_steps: of the pooled network; the preset's own number if not given.
        seed: of the baselines' searches and weights.
        folder: for the fits of the baselines, where they are reused.
        progress: where to report to.

    Returns:
        ``free_run_rmse`` [rad] of free runs of 1 s and ``whole_run_rmse`` [rad] of free runs of
        whole segments: median and mean over motors, and of each motor (``part``). Models: ADAPTED,
        the prior adapted to the training rows; PRIOR, its motor of the same name or else the mean
        of the joint's class; and the `fitted_baselines`, with an error of 2π if they cannot be
        fitted. ``coverage50``, ``coverage90``, ``whole_run_coverage50`` and
        ``whole_run_coverage90`` of samples of the posterior and of `MotorPrior.predicted`.
        TRAINED_ON: 1 if the prior was trained on the log, so that the figures are not a test,
            otherwise 0.

    Raises:
        LogError: a log that lacks a channel, is too short, or has other joints than ``fitted_on``.
        ArtifactError, ConfigError: a prior of another robot or without latents, or a number out of
        range.
    """
    require_seed(seed)
    if adam_steps is not None:
        require_count("adam_steps", adam_steps)
    require_adaptable(prior, log)
    train, test = _train_and_test(log, fitted_on, seconds)
    preset = recipe_of(prior)
    note_training_log(prior, log, progress)
    for note in notes_on_log(test, preset):
        progress.report(note)
    runs = free_runs(test, preset)
    baseline_recipes(train, preset)  # a log that is too short is an error before anything is fitted
    with progress.start(f"adapt to {train.num_joints} motors", 1) as task:
        posterior = adapt_to(prior, train)
        task.advance()
    models: dict[str, MotorModel] = {
        ADAPTED: prior.model.motors(posterior.mean),
        PRIOR: prior.model.motors(prior.predicted(test).mean),
    }
    baselines = fitted_baselines(train, preset, folder, adam_steps, seed, progress)
    models |= {name: motors for name, motors in baselines.items() if motors is not None}
    failed = [name for name, motors in baselines.items() if motors is None]
    of_spans = {f"{span}_rmse": {test.source: each} for span, each in runs.items()}  # keys of SPANS
    plotted = (TUNED_PD, PRIOR, ADAPTED)
    with progress.start("free runs", 1) as task:
        found = validation_of(
            {test.source: test}, of_spans, models, ADAPTED, plotted, MEDIAN_AND_MEAN, failed
        )
        coverages = [
            Result(f"{COVERAGE[f'{span}_rmse']}{level}", "1", share, model)
            for span, each in runs.items()
            for model, motors in ((ADAPTED, posterior), (PRIOR, zero_shot(prior, test)))
            for level, share in log_coverage(prior, motors, each).items()
        ]
        task.advance()
    for warning in found.warnings:
        progress.warn(warning)
    trained = Results([Result(TRAINED_ON, "1", float(trained_on(prior, log)))])
    return replace(found, results=trained + found.results.where(log=None) + Results(coverages))


def _train_and_test(
    log: MotorLog, fitted_on: Sequence[MotorLog], seconds: float | None
) -> tuple[MotorLog, MotorLog]:
    if seconds is not None and fitted_on:
        raise ConfigError(
            "seconds given together with fitted_on", remedy="omit one of them", argument="seconds"
        )
    if not fitted_on:
        return train_test_halves(log) if seconds is None else first_and_rest(log, seconds)
    train = joined(fitted_on)
    if train.joint_names != log.joint_names:
        problem = (
            f"joints {', '.join(train.joint_names)}; {log.source} has {', '.join(log.joint_names)}"
        )
        raise LogError(
            problem, where=train.source, remedy="give logs of the same joints in the same order"
        )
    return replace(train, source=", ".join(dict.fromkeys(each.source for each in fitted_on))), log


def fitted_baselines(
    log: MotorLog,
    preset: Recipe,
    folder: Path | None,
    adam_steps: int | None = None,
    seed: int = 0,
    progress: Progress = SILENT,
) -> dict[str, MotorModel | None]:
    """All baselines of a prior with this recipe, fitted to a log with known loads; each has the log's motors in order.

    Fits in ``folder``, if it is given, are reused. ``adam_steps`` are those of the pooled network,
    the preset's own if not given. A baseline that cannot be fitted or read is None, and a warning
    reports why. Raises LogError for a log that lacks a channel, has another sample period, or is
    too short.
    """
    recipes = baseline_recipes(log, preset)
    models: dict[str, MotorModel | None] = dict(fitted_responses(log, preset, seed, progress))
    tuned = fitted_tuned_pd(log, progress)
    for name, (named, recipe) in recipes.items():
        if name == "pooled_network" and adam_steps is not None:
            recipe = replace(recipe, steps=adam_steps)
        try:
            out = None if folder is None else folder / name
            fitted = fit_recipe(
                log, named, recipe, seed, out, Progress(SILENT.report, progress.line), tuned=tuned
            )
            models[name] = fitted.model.motors(fitted.mean)
        except MotorPriorError as error:
            models[name] = None
            progress.warn(f"baseline {name} counts as diverged: {error}")
    return models | {"tuned_pd": tuned}


def baseline_recipes(log: MotorLog, preset: Recipe) -> dict[str, tuple[str, Recipe]]:
    """Preset name and recipe of every baseline that has one, with windows that fit the log; LogError if none does."""
    if preset.period != BASELINE_PERIOD:
        return {}
    names = BASELINE_PRESETS | (
        LONG_RUNS if preset.window == presets.PRESETS["long_runs"].window else {}
    )
    recipes = {
        name: (preset, with_window_that_fits(presets.PRESETS[preset], log))
        for name, preset in names.items()
    }
    for _, recipe in recipes.values():
        window_starts(tuple(log.segment_slices()), recipe, log.source)
    return recipes
