"""Validate a prior on a log: errors of its motors and of baselines on held-out rows."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bounds import require_count, require_seed
from motorprior.evaluation.bands import log_coverage, zero_shot
from motorprior.evaluation.errors import PER_MOTOR, PRIOR, TUNED_PD, notes_on_log
from motorprior.evaluation.free_runs import (
    FREE_RUN,
    MEDIAN_AND_MEAN,
    WHOLE_RUN,
    MotorModel,
    Validation,
    free_runs,
    validation_of,
)
from motorprior.evaluation.splits import first_and_rest
from motorprior.exceptions import ConfigError, LogError, MotorPriorError
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.baselines.response_fit import fitted_responses
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS, Recipe, recipe_of
from motorprior.identification.windows import window_starts, with_window_that_fits
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.logs.operations import joined, train_test_halves
from motorprior.priors.adapt import adapt_to, note_command_mode, note_training_log
from motorprior.priors.fit_prior import fit_recipe, trained_on
from motorprior.priors.prior_file import require_adaptable
from motorprior.progress import SILENT, WARNINGS_AND_PROGRESS, Progress
from motorprior.results import Result, Results

# span of free runs -> quantity in the results
QUANTITIES = {FREE_RUN: "free_run_rmse", WHOLE_RUN: "whole_run_rmse"}
_COVERAGES = {FREE_RUN: "coverage", WHOLE_RUN: "whole_run_coverage"}
ADAPTED = "adapted"
TRAINED_ON = "prior_was_trained_on_this_log"
# baseline -> preset of identification. per_motor fits the physics of each motor alone;
# pooled_network is one network for all motors.
POOLED_NETWORK = "pooled_network"
BASELINE_PRESETS = {PER_MOTOR: "pace", POOLED_NETWORK: "one_network"}
# baseline -> preset for a prior of preset long_runs or quick; these are for servos with much
# friction
SERVO_BASELINE_PRESETS = {
    PER_MOTOR: "pace_long_runs",
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
    progress: Progress = WARNINGS_AND_PROGRESS,
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
        Results of these quantities:

        ``free_run_rmse`` and ``whole_run_rmse`` are errors [rad] of free runs of 1 s and of whole
        segments: median and mean over the motors, and the error of each motor (``part``). There are
        three kinds of models. ``adapted`` is the prior adapted to the training rows. ``prior`` is
        not adapted: a joint has the training motor of the same name or, if there is none, the mean
        motor of the joint's class. The `fitted_baselines` have an error of 2π if they cannot be
        fitted.

        ``coverage50``, ``coverage90``, ``whole_run_coverage50`` and ``whole_run_coverage90`` are
        shares of the recorded angles within the 50 % and 90 % bands of sampled motors. The motors
        of ``adapted`` are samples of the posterior, the motors of ``prior`` are samples of
        `MotorPrior.predicted`.

        ``prior_was_trained_on_this_log`` is 1 if the prior was trained on the log, so that the
        results are not a test, and 0 otherwise.

    Raises:
        LogError: a log that lacks a channel, is too short, or has other joints than ``fitted_on``.
        ArtifactError: a prior of another robot or without latents.
        ConfigError: a number out of range.
    """
    require_seed(seed)
    if adam_steps is not None:
        require_count("adam_steps", adam_steps)
    log = checked(log)
    require_adaptable(prior, log)
    train, test = _train_and_test(log, fitted_on, seconds)
    recipe = recipe_of(prior)
    note_training_log(prior, log, progress)
    note_command_mode(prior, log, progress)
    for note in notes_on_log(test, recipe):
        progress.report(note)

    runs = free_runs(test, recipe)
    baseline_recipes(train, recipe)  # a log that is too short is an error before anything is fitted
    with progress.start(f"adapt to {train.num_joints} motors", 1) as task:
        posterior = adapt_to(prior, train, progress)
        task.advance()

    models: dict[str, MotorModel] = {
        ADAPTED: prior.model.motors(posterior.mean),
        PRIOR: prior.model.motors(prior.predicted(test).mean),
    }
    failed = []
    baselines = fitted_baselines(train, recipe, folder, adam_steps, seed, progress)
    for name, motors in baselines.items():
        if motors is None:
            failed.append(name)
        else:
            models[name] = motors

    with progress.start("free runs", 1) as task:
        validation = validation_of(
            logs={test.source: test},
            runs={test.source: runs},
            quantities=QUANTITIES,
            models=models,
            main_model=ADAPTED,
            plotted=(TUNED_PD, PRIOR, ADAPTED),
            statistics=MEDIAN_AND_MEAN,
            failed=failed,
        )
        coverages = _coverages(prior, {ADAPTED: posterior, PRIOR: zero_shot(prior, test)}, runs)
        task.advance()
    for warning in validation.warnings:
        progress.warn(warning)

    is_trained = Results([Result(TRAINED_ON, "1", float(trained_on(prior, log)))])
    errors = validation.results.where(log=None)
    return replace(validation, results=is_trained + errors + coverages)


def coverage_quantity(span: str, level: int) -> str:
    """Quantity of the share inside the band of ``level`` percent in free runs of a span."""
    return f"{_COVERAGES[span]}{level}"


def _coverages(
    prior: MotorPrior,
    posteriors: Mapping[str, LatentPosterior],
    runs: Mapping[str, Sequence[WindowRuns]],
) -> Results:
    """Coverage of the bands of each posterior, in free runs of 1 s and of whole segments."""
    rows = []
    for span, windows in runs.items():
        for model, posterior in posteriors.items():
            for level, share in log_coverage(prior, posterior, windows).items():
                rows.append(Result(coverage_quantity(span, level), "1", share, model))
    return Results(rows)


def _train_and_test(
    log: MotorLog, fitted_on: Sequence[MotorLog], seconds: float | None
) -> tuple[MotorLog, MotorLog]:
    """Rows to adapt to and to fit baselines to, and rows to test on."""
    if seconds is not None and fitted_on:
        problem = "seconds given together with fitted_on"
        raise ConfigError(problem, remedy="omit one of them", argument="seconds")
    if not fitted_on:
        return train_test_halves(log) if seconds is None else first_and_rest(log, seconds)

    train = joined(fitted_on)
    if train.joint_names != log.joint_names:
        joints = ", ".join(log.joint_names)
        problem = f"joints {', '.join(train.joint_names)}; {log.source} has {joints}"
        remedy = "give logs of the same joints in the same order"
        raise LogError(problem, where=train.source, remedy=remedy)
    sources = dict.fromkeys(training_log.source for training_log in fitted_on)
    return replace(train, source=", ".join(sources)), log


def fitted_baselines(
    log: MotorLog,
    recipe: Recipe,
    folder: Path | None,
    adam_steps: int | None = None,
    seed: int = 0,
    progress: Progress = SILENT,
) -> dict[str, MotorModel | None]:
    """All baselines of a prior, fitted to a log with known loads.

    Args:
        log: log of the motors; the motors of a baseline are in the order of its joints.
        recipe: recipe of the prior.
        folder: folder of the fits, where they are reused.
        adam_steps: of the pooled network; the preset's own number if not given.
        seed: of searches and weights.
        progress: where to report to.

    Returns:
        The baselines by name. A baseline that cannot be fitted or read is None, and a warning
        reports why.

    Raises:
        LogError: the log lacks a channel, has another sample period, or is too short.
    """
    recipes = baseline_recipes(log, recipe)
    models: dict[str, MotorModel | None] = dict(fitted_responses(log, recipe, seed, progress))
    tuned = fitted_tuned_pd(log, progress)
    progress_without_notes = Progress(SILENT.report, progress.print_line)
    for name, (preset, baseline_recipe) in recipes.items():
        if name == POOLED_NETWORK and adam_steps is not None:
            baseline_recipe = replace(baseline_recipe, steps=adam_steps)
        out = None if folder is None else folder / name
        try:
            fitted = fit_recipe(
                log, preset, baseline_recipe, seed, out, progress_without_notes, tuned=tuned
            )
            models[name] = fitted.model.motors(fitted.mean)
        except MotorPriorError as error:
            models[name] = None
            progress.warn(f"baseline {name} counts as diverged: {error}")
    return models | {TUNED_PD: tuned}


def baseline_recipes(log: MotorLog, recipe: Recipe) -> dict[str, tuple[str, Recipe]]:
    """Preset name and recipe of every baseline that has a preset, with windows that fit the log.

    ``recipe`` is the prior's. Raises LogError if the log is too short for a window.
    """
    if recipe.period != BASELINE_PERIOD:
        return {}
    presets_of_baselines = dict(BASELINE_PRESETS)
    # not the window, which `with_window_that_fits` shortens
    has_long_runs = recipe.warm_up == PRESETS["long_runs"].warm_up
    if has_long_runs:
        presets_of_baselines |= SERVO_BASELINE_PRESETS

    if log.has_command_frames:
        del presets_of_baselines[POOLED_NETWORK]  # it learns position commands only

    recipes = {}
    for name, preset in presets_of_baselines.items():
        recipes[name] = (preset, with_window_that_fits(PRESETS[preset], log))
    # only for the error of a log that is too short
    segments = tuple(log.segment_slices())
    for _, baseline_recipe in recipes.values():
        window_starts(segments, baseline_recipe, log.source)
    return recipes
