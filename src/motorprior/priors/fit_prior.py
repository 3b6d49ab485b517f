"""Fit a motor prior to motor logs."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.gains import check_gain_units
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import COMMAND_MODE, MotorPrior
from motorprior.actuator.prior_tables import SPREAD
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bounds import require_seed
from motorprior.evaluation import training_errors
from motorprior.evaluation.errors import (
    MAX_UNEXPLAINED,
    PRIOR,
    evaluate_replay,
    notes_on_log,
    replay_errors,
)
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.checkpoint import Arrays, Checkpoint, parts_of, unsaved
from motorprior.identification.explanations.explain import explain
from motorprior.identification.identify import identify, work_of
from motorprior.identification.latents.standardise import (
    MIN_MOTORS,
    RELIABLE_MOTORS,
    spread_source,
    with_scaled_spread,
)
from motorprior.identification.physics.motor_problem import grey_box
from motorprior.identification.physics.window_runs import TorqueMotors
from motorprior.identification.presets import Recipe, identification_preset, with_logged_settings
from motorprior.identification.torque_use import with_usable_torque
from motorprior.identification.training_result import TrainingResult
from motorprior.identification.windows import (
    TrainingData,
    subsampled,
    training_data,
    used_seconds_text,
    with_window_that_fits,
)
from motorprior.logs.bench_names import bench_names
from motorprior.logs.command_modes import reference_gains
from motorprior.logs.motor_log import (
    PHYSICAL_GAINS,
    POSTURES,
    MotorLog,
    checked,
    log_digest,
    motion_digest,
    motor_logs,
)
from motorprior.logs.operations import joined
from motorprior.priors.prior_file import soft_gear_notes
from motorprior.progress import SILENT, WARNINGS_AND_PROGRESS, Note, Progress
from motorprior.stage import description, is_finished, locked, working

PRIOR_FILE = "prior.safetensors"
CHECKPOINT = "unfinished_{}.safetensors"
# rows per motor that grey boxes are fitted to: more of them cost time, and change little
MAX_ROWS = 60_000
MIN_SAVED = 1.0  # work that an interruption may lose, besides the running step [s]
# key in a prior's provenance: `motion_digest` of every log that it was trained on
_MOTIONS = "motions"


def fit_prior(
    logs: MotorLog | Sequence[MotorLog],
    preset: str = "rollout",
    seed: int = 0,
    *,
    steps: int | None = None,
    out: str | Path | None = None,
    progress: Progress = WARNINGS_AND_PROGRESS,
) -> MotorPrior:
    """Learn the distribution of motors from their logs.

    Args:
        logs: of some motors, with loads known (preset rollout) or joint_torque (preset paper), at
            the preset's sample period. Logs of the same joint names are more of the same motors,
            logs of other names are further motors.
        preset: rollout (closed loop, grey box), paper (torque regression), or another of
            `identification.presets`.
        seed: of weights, windows and noise; the fit is deterministic.
        steps: Adam steps; the preset's own number if not given; only of presets that train a
            network.
        out: folder for prior.safetensors; a repeated call loads it; an interrupted fit
            continues there where it was, but for a second. Nothing is written without
            it.
        progress: where to report to, for example ``Lines()``; by default work is reported on
            stderr, and warnings are Python warnings.

    Returns:
        The prior, with the robot, the recipe and the metrics of its training.

    Raises:
        ConfigError: an unknown preset, a number out of range, or steps of a preset that trains no
            network.
        LogError: logs that do not fit together, or that lack a channel, rows or motion that the
            preset needs.
        ArtifactError: ``out`` cannot be written.
    """
    require_seed(seed)
    recipe = identification_preset(preset, steps)
    checked_logs = [checked(log) for log in motor_logs(logs)]
    log = joined(checked_logs)
    warn_about_cut_logs(checked_logs, log, progress)
    provenance = provenance_of(checked_logs, log=log.source)
    folder = None if out is None else Path(out)
    return fit_recipe(log, preset, recipe, seed, folder, progress, provenance, explains=True)


def warn_about_cut_logs(logs: Sequence[MotorLog], joined_log: MotorLog, progress: Progress) -> None:
    """Warn if logs of different motors were cut to the shortest of them when they were joined."""
    longest = max(logs, key=lambda log: log.num_rows)
    shortest = min(logs, key=lambda log: log.num_rows)
    if joined_log.num_rows < longest.num_rows:
        progress.warn(
            f"logs of different motors are cut to the shortest: {shortest.duration:.1f} s "
            f"({shortest.source}) of up to {longest.duration:.1f} s ({longest.source}) -> record "
            "the motors equally long, or leave out the shortest log"
        )


def fit_recipe(
    log: MotorLog,
    preset: str,
    recipe: Recipe,
    seed: int,
    out: Path | None,
    progress: Progress = SILENT,
    provenance: Mapping[str, Any] | None = None,
    tuned: TorqueMotors | None = None,
    *,
    explains: bool = False,
) -> MotorPrior:
    """`fit_prior` with any recipe, named ``preset``.

    Args:
        log: all logs, joined.
        preset: name of the recipe.
        recipe: of the fit.
        seed: of weights, windows and noise.
        out: folder, as for `fit_prior`.
        progress: where to report to.
        provenance: of the log; `provenance_of` the log if not given.
        tuned: a PD that was tuned to the log, to compare with; it is tuned here if not given.
        explains: whether notes state what in the log explains the errors.
    """
    recipe = with_window_that_fits(with_logged_settings(recipe, log), log)
    provenance = provenance or provenance_of([log], log=log.source)
    settings = {"preset": preset, "seed": seed, "provenance": provenance}
    stage = description("identify", settings, [], recipe.as_json())
    stage["inputs"] = [log_digest(replace(log, source=""))]
    if out is not None and is_finished(out, stage):
        progress.note(f"{out / PRIOR_FILE} exists already, from the same logs and settings")
        return MotorPrior.load(out / PRIOR_FILE)

    if log.gains is not None and recipe.gain_unit == PHYSICAL_GAINS:
        check_gain_units(log.gains, log.source)

    # an error in the log leaves an earlier prior in the folder
    data = training_data(log, recipe, log.source)
    fitted = partial(
        _fitted, log, recipe, preset, seed, provenance, tuned, explains, progress, data
    )
    if out is None:
        return fitted(unsaved)
    with locked(out), working(out, stage):
        steps = _SavedSteps(out, stage)
        if steps.are_continued:
            progress.note(f"continues the interrupted fit in {out}")
        fitted(steps).save(out / PRIOR_FILE)
        for path in out.glob(CHECKPOINT.format("*")):
            path.unlink()
    return MotorPrior.load(out / PRIOR_FILE)


class _SavedSteps:
    """A `Checkpoint` in a folder; steps of another stage there are ignored.

    Steps are written together whenever the unsaved ones took MIN_SAVED.
    """

    def __init__(self, folder: Path, stage: dict[str, Any]):
        self._folder = folder
        self._stage = stage
        self._steps: dict[str, Arrays] = {}
        self._unsaved: dict[str, np.ndarray] = {}
        self._saved_at = time.monotonic()

        for path in sorted(folder.glob(CHECKPOINT.format("*"))):
            tensors, header = read_tensors(path)
            if header == stage:
                for key, array in tensors.items():
                    name, _, array_name = key.partition(":")
                    self._steps.setdefault(name, {})[array_name] = array
        self.are_continued = bool(self._steps)  # an interrupted run has finished some

    def __call__(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        """Arrays of a step that an interrupted run has finished; otherwise computed."""
        if name not in self._steps:
            self._steps[name] = compute()
            for array_name, array in self._steps[name].items():
                self._unsaved[f"{name}:{array_name}"] = array

            if time.monotonic() - self._saved_at > MIN_SAVED:
                write_tensors(self._folder / CHECKPOINT.format(name), self._unsaved, self._stage)
                self._unsaved = {}
                self._saved_at = time.monotonic()
        return self._steps[name]


def _fitted(
    log: MotorLog,
    recipe: Recipe,
    preset: str,
    seed: int,
    provenance: Mapping[str, Any],
    tuned: TorqueMotors | None,
    explains: bool,
    progress: Progress,
    data: TrainingData,
    checkpoint: Checkpoint,
) -> MotorPrior:
    """Fit the prior and its metrics."""
    if recipe.grey_boxes:
        data, notes = with_usable_torque(log, data, recipe)
        for note in notes:
            progress.report(note)
    used = subsampled(data, recipe, MAX_ROWS) if recipe.grey_boxes else data
    _report_data(log, recipe, used, progress)
    with progress.start(f"identify {preset}", work_of(recipe)) as task:
        result = identify(used, recipe, seed, task.advance, checkpoint)
    recipe = result.recipe  # with the selected terms
    model = result.model
    if isinstance(model, GreyBox) and log.command_mode != "position":
        model = replace(model, command_mode=log.command_mode)
    mean = result.mean
    log_var = result.log_var
    classes = result.classes or ClassLatents.with_one_class(log.num_joints, model.num_latents)

    metrics = replace(
        result.metrics,
        final_loss=float(result.losses[-1]),
        minutes_of_log=log.duration / 60 * log.num_joints,
        aggregate_posterior_kl=training_errors.aggregate_posterior_kl(mean, log_var),
    )
    metrics = training_errors.with_training_errors(metrics, model, data, recipe, mean, log)
    for note in result.notes:
        progress.report(note)
    if explains and isinstance(model, GreyBox):
        separate, x = _separate(result)
        for note in _explanations(log, data, result, separate, x):
            progress.report(note)
        if log.joint_names != bench_names(log.num_joints):
            # here: the import of the package stays light
            from motorprior.evaluation.held_out_baselines import better_baselines

            for note in better_baselines(separate, x, log, recipe, seed, progress):
                progress.report(note)

    misfit = np.ones(log.num_joints)
    if isinstance(model, GreyBox):
        if tuned is None:
            tuned = fitted_tuned_pd(log, progress, checkpoint=parts_of("tuned_pd", checkpoint))
        errors = evaluate_replay(model.motors(mean), tuned, log, recipe, progress)
        unexplained = float(np.median(errors.unexplained(PRIOR)))
        replay_rmse = float(np.median(errors.models[PRIOR]))
        metrics = replace(metrics, replay_rmse=replay_rmse, unexplained=unexplained)

        replayed, velocity = replay_errors(model.motors(mean), log, recipe.nominal_conditions)
        misfit = training_errors.residual_scale(metrics.residuals, replayed, velocity)
        growth, growth_std = training_errors.residual_growth(
            metrics, model, mean, classes, log, recipe
        )
        metrics = replace(metrics, residual_growth=growth, residual_growth_std=growth_std)

        factor = _std_factor(unexplained)
        model, mean, log_var, classes = with_scaled_spread(model, mean, log_var, classes, factor)
        if model.copula is not None and factor > 1.0:
            progress.note(f"the standard deviation of the prior is scaled by {factor:.2f}")

    fit = {
        "recipe": json.loads(json.dumps(recipe.as_json())),
        "seed": seed,
        SPREAD: spread_source(model, classes),
    }
    if log.command_mode != "position":
        fit[COMMAND_MODE] = log.command_mode
    is_bench = log.joint_names == bench_names(log.num_joints)
    prior = MotorPrior(
        model=model,
        mean=mean,
        log_var=log_var,
        preset=preset,
        robot=log.robot,
        motor=log.motor,
        provenance={**provenance, **fit},
        metrics=metrics,
        joint_names=() if is_bench else log.joint_names,
        gains=reference_gains(log) if model.gain_unit else None,
        given_classes=classes,
        misfit=misfit,
        estimates=result.estimates,
    )
    if log.posture is not None and np.all(log.posture == POSTURES.index("suspended")):
        motors = prior.training_motors(np.arange(log.num_joints))
        for note in soft_gear_notes(motors, log.joint_names):
            progress.warn(note)
    return prior


def _separate(result: TrainingResult) -> tuple[GreyBox, np.ndarray]:
    """The fitted motors with one latent per constant: model and latents (M, K)."""
    assert isinstance(result.model, GreyBox)
    outputs = result.model.outputs(result.mean)
    center = np.median(outputs, axis=0)
    return grey_box(center, result.model.terms, result.recipe), outputs - center


def _explanations(
    log: MotorLog, data: TrainingData, result: TrainingResult, separate: GreyBox, x: np.ndarray
) -> list[Note]:
    """What in the log explains the errors of the fitted motors, see `_separate`."""
    if data.command_mode in ("velocity", "torque"):
        return []
    return explain(log, data, result.recipe, separate, x).notes()


def _report_data(log: MotorLog, recipe: Recipe, data: TrainingData, progress: Progress) -> None:
    """Report few motors, the used seconds of log, and doubts about the log."""
    if recipe.num_latents and log.num_joints < RELIABLE_MOTORS:
        is_assumed = recipe.grey_boxes and log.num_joints < MIN_MOTORS
        deviation = "assumed" if is_assumed else "uncertain"
        motors = f"{log.num_joints} motor{'s' if log.num_joints > 1 else ''}"
        progress.note(
            f"{motors} cannot define a distribution: the prior reproduces these motors, but the "
            f"standard deviation of its samples is {deviation} (record {RELIABLE_MOTORS} or more)"
        )
    progress.note(used_seconds_text(data, recipe, log))
    for note in notes_on_log(log, recipe):
        progress.report(note)


def _std_factor(unexplained: float) -> float:
    """Factor on the prior's standard deviation: samples vary more where the model lacks physics.

    It is 1 up to MAX_UNEXPLAINED, and 2 where nothing is explained.
    """
    excess = max(0.0, min(1.0, unexplained) - MAX_UNEXPLAINED)
    return 1.0 + excess / (1.0 - MAX_UNEXPLAINED)


def provenance_of(logs: Sequence[MotorLog], **origin: Any) -> dict[str, Any]:
    """Provenance of a prior that is fitted to these logs; ``origin`` is a file or a bench."""
    return {**origin, _MOTIONS: [motion_digest(log) for log in logs]}


def trained_on(prior: MotorPrior, log: MotorLog) -> bool:
    """Whether the provenance of the prior lists the motion of this log."""
    return motion_digest(log) in prior.provenance.get(_MOTIONS, ())
