"""Fit a motor prior to motor logs."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import SPREAD, MotorPrior, check_gain_units
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bounds import require_seed
from motorprior.evaluation import reference
from motorprior.evaluation.errors import (
    MAX_UNEXPLAINED,
    evaluate_replay,
    notes_on_log,
    replay_errors,
)
from motorprior.identification.checkpoint import Arrays, Checkpoint, unsaved
from motorprior.identification.identify import identify, work_of
from motorprior.identification.latents.standardise import (
    MIN_MOTORS,
    RELIABLE_MOTORS,
    spread_source,
    with_scaled_spread,
)
from motorprior.identification.physics.window_runs import MotorsOnLoads
from motorprior.identification.presets import Recipe, identification_preset, with_logged_settings
from motorprior.identification.windows import TrainingData, training_data, used_seconds_text
from motorprior.logs.bench_names import bench_names
from motorprior.logs.motor_log import (
    PHYSICAL_GAINS,
    MotorLog,
    checked,
    log_digest,
    motion_digest,
    motor_logs,
)
from motorprior.logs.operations import joined
from motorprior.progress import SHOWN, SILENT, Progress
from motorprior.stage import description, is_finished, locked, working

PRIOR = "prior.safetensors"
CHECKPOINT = "unfinished_{}.safetensors"
# key in a prior's provenance: `motion_digest` of every log that it was trained on
_MOTIONS = "motions"


def fit_prior(
    logs: MotorLog | Sequence[MotorLog],
    preset: str = "rollout",
    seed: int = 0,
    *,
    steps: int | None = None,
    out: str | Path | None = None,
    progress: Progress = SHOWN,
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
        out: folder for prior.safetensors; a repeated call loads it; an interrupted fit continues
            there after the selection of terms or the fit of the motors. Nothing is written without
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
    parts = [checked(log, where=log.source) for log in motor_logs(logs)]
    log = joined(parts)
    provenance = provenance_of(parts, log=log.source)
    return fit_recipe(
        log, preset, recipe, seed, None if out is None else Path(out), progress, provenance
    )


def fit_recipe(
    log: MotorLog,
    preset: str,
    recipe: Recipe,
    seed: int,
    out: Path | None,
    progress: Progress = SILENT,
    provenance: Mapping[str, Any] | None = None,
    tuned: MotorsOnLoads | None = None,
) -> MotorPrior:
    """`fit_prior` with any recipe, named ``preset``.

    ``provenance`` is that of the log, `provenance_of` it if not given; ``tuned`` a PD that was
    tuned to the log, to compare with; it is tuned here if not given.
    """
    recipe = with_logged_settings(recipe, log)
    provenance = provenance or provenance_of([log], log=log.source)
    settings = {"preset": preset, "seed": seed, "provenance": provenance}
    wanted = description("identify", settings, [], recipe.as_json()) | {
        "inputs": [log_digest(replace(log, source=""))]
    }
    if out is not None and is_finished(out, wanted):
        progress.note(f"{out / PRIOR} exists already, from the same logs and settings")
        return MotorPrior.load(out / PRIOR)
    if log.gains is not None and recipe.gain_unit == PHYSICAL_GAINS:
        check_gain_units(log.gains, log.source)
    # an error in the log leaves an earlier prior in the folder
    data = training_data(log, recipe, log.source)
    fitted = partial(_fitted, log, recipe, preset, seed, provenance, tuned, progress, data)
    if out is None:
        return fitted(unsaved)
    with locked(out), working(out, wanted):
        fitted(partial(_checkpoint, out, wanted)).save(out / PRIOR)
        for path in out.glob(CHECKPOINT.format("*")):
            path.unlink()
    return MotorPrior.load(out / PRIOR)


def _checkpoint(
    folder: Path, wanted: dict[str, Any], name: str, compute: Callable[[], Arrays]
) -> Arrays:
    """Arrays of an earlier interrupted run with the same logs and settings, or else computed and written."""
    path = folder / CHECKPOINT.format(name)
    if path.exists() and (found := read_tensors(path))[1] == wanted:
        return found[0]
    found = compute()
    write_tensors(path, found, wanted)
    return found


def _fitted(
    log: MotorLog,
    recipe: Recipe,
    preset: str,
    seed: int,
    provenance: Mapping[str, Any],
    tuned: MotorsOnLoads | None,
    progress: Progress,
    data: TrainingData,
    checkpoint: Checkpoint,
) -> MotorPrior:
    """Fit the prior and its metrics."""
    if recipe.num_latents and log.num_joints < RELIABLE_MOTORS:
        deviation = "assumed" if recipe.grey_boxes and log.num_joints < MIN_MOTORS else "uncertain"
        progress.note(
            f"{log.num_joints} motor{'s' if log.num_joints > 1 else ''} cannot define a distribution: the prior "
            f"reproduces these motors, but the standard deviation of its samples is {deviation} (record "
            f"{RELIABLE_MOTORS} or more)"
        )
    progress.note(used_seconds_text(data, recipe))
    for note in notes_on_log(log, recipe):
        progress.report(note)
    with progress.start(f"identify {preset}", work_of(recipe)) as task:
        found = identify(data, recipe, seed, task.advance, checkpoint)
    model = found.model
    mean = found.mean
    log_var = found.log_var
    misfit = np.ones(log.num_joints)
    classes = found.classes or ClassLatents.one(log.num_joints, model.num_latents)
    metrics = {
        "final_loss": float(found.losses[-1]),
        "minutes_of_log": log.duration / 60 * log.num_joints,
    }
    metrics |= {
        "aggregate_posterior_kl": reference.aggregate_posterior_kl(mean, log_var),
        **found.metrics,
    }
    metrics |= reference.reference_metrics(model, data, found.recipe, mean, log)
    for note in found.notes:
        progress.report(note)
    if isinstance(model, GreyBox):
        errors = evaluate_replay(model.motors(mean), tuned, log, found.recipe, progress)
        unexplained = float(np.median(errors.unexplained("prior")))
        metrics |= {
            "replay_rmse": float(np.median(errors.models["prior"])),
            "unexplained": unexplained,
        }
        # where the model lacks physics, samples vary more: the factor is 1 up to MAX_UNEXPLAINED
        # and 2 at 1
        factor = 1.0 + max(0.0, min(1.0, unexplained) - MAX_UNEXPLAINED) / (1.0 - MAX_UNEXPLAINED)
        misfit = reference.residual_scale(
            metrics, *replay_errors(model.motors(mean), log, found.recipe.nominal_conditions)
        )
        metrics |= reference.residual_growth(model, mean, classes, log, found.recipe, metrics)
        model, mean, log_var, classes = with_scaled_spread(model, mean, log_var, classes, factor)
        if model.copula is not None and factor > 1.0:
            progress.note(f"the standard deviation of the prior is scaled by {factor:.2f}")
    names = () if log.joint_names == bench_names(log.num_joints) else log.joint_names
    trained = {"recipe": json.loads(json.dumps(found.recipe.as_json())), "seed": seed}
    trained[SPREAD] = spread_source(model, classes)
    return MotorPrior(
        model,
        mean,
        log_var,
        preset,
        log.robot,
        log.motor,
        {**provenance, **trained},
        metrics,
        names,
        log.gains if model.gain_unit else None,
        classes,
        misfit,
    )


def provenance_of(logs: Sequence[MotorLog], **origin: Any) -> dict[str, Any]:
    """Provenance of a prior that is fitted to these logs, with their ``origin``, such as a file or a bench."""
    return {**origin, _MOTIONS: [motion_digest(log) for log in logs]}


def trained_on(prior: MotorPrior, log: MotorLog) -> bool:
    """Whether the provenance of the prior lists the motion of this log."""
    return motion_digest(log) in prior.provenance.get(_MOTIONS, ())
