"""Baselines of a prior on real logs: models that are fitted to the same rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from motorprior.exceptions import MotorPriorError
from motorprior.identification import presets
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.baselines.response_fit import fitted_responses
from motorprior.identification.evaluation.free_runs import MotorModel
from motorprior.identification.fit_prior import fit_recipe
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import window_starts, with_window_that_fits
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import SILENT, WARNING, Notes, Progress

# baseline -> preset of identification: the physics of each motor fitted alone, and one network for all motors
PRESETS = {"per_motor": "pace", "pooled_network": "one_network"}
# for a prior of preset long_runs or quick, which are for servos with much friction
LONG_RUNS = {"per_motor": "pace_long_runs", "coulomb_viscous": "coulomb_viscous", "stribeck": "stribeck"}
BASELINE_PERIOD = 0.002  # of these presets [s]; priors with another period have no such baselines


def fitted_baselines(
    log: MotorLog,
    preset: Preset,
    folder: Path | None,
    adam_steps: int | None = None,
    seed: int = 0,
    progress: Progress = SILENT,
) -> dict[str, MotorModel | None]:
    """All baselines of a prior with this recipe, fitted to a log with known loads; each has the log's motors in order.

    Fits in ``folder``, if it is given, are reused. ``adam_steps`` are those of the pooled network, the preset's own if
    not given. A baseline that cannot be fitted or read is None, and a warning reports why.

    Raises:
        LogError: it lacks a channel, has another sample period, or is too short.
    """
    recipes = baseline_recipes(log, preset)
    models: dict[str, MotorModel | None] = dict(fitted_responses(log, preset, seed, progress))
    tuned = fitted_tuned_pd(log, progress)
    for name, (named, recipe) in recipes.items():
        if name == "pooled_network" and adam_steps is not None:
            recipe = replace(recipe, steps=adam_steps)
        try:
            out = None if folder is None else folder / name
            fitted = fit_recipe(log, named, recipe, seed, out, Notes(SILENT.note, progress), tuned=tuned)
            models[name] = fitted.model.motors(fitted.mean)
        except MotorPriorError as error:
            models[name] = None
            progress.note(f"{WARNING}baseline {name} counts as diverged: {error}")
    return models | {"tuned_pd": tuned}


def baseline_recipes(log: MotorLog, preset: Preset) -> dict[str, tuple[str, Preset]]:
    """Preset and recipe of every baseline that has one; windows are shortened to fit the log.

    Raises:
        LogError: every segment is too short for one of them.
    """
    if preset.period != BASELINE_PERIOD:
        return {}
    names = PRESETS | (LONG_RUNS if preset.window == presets.PRESETS["long_runs"].window else {})
    recipes = {name: (preset, with_window_that_fits(presets.PRESETS[preset], log)) for name, preset in names.items()}
    for _, recipe in recipes.values():
        window_starts(tuple(log.segment_slices()), recipe, log.source)
    return recipes
