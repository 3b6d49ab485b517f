"""Baselines of a prior on real logs: models that are fitted to the same rows."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from motorprior.actuator.latent import LatentActuator
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.identification.fit_prior import fit_recipe
from motorprior.logs.loads import with_some_load
from motorprior.logs.motor_log import MotorLog, log_digest
from motorprior.progress import SILENT, Progress, WithoutNotes
from motorprior.stage import description, is_finished, working

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.baselines.response_models import ResponseMotors
    from motorprior.identification.evaluation.log_fidelity import LogModel
    from motorprior.identification.presets import Preset

# baseline -> preset of identification: the physics of each motor fitted alone, and one network for all motors
PRESETS = {"per_motor": "pace", "pooled_network": "one_network"}
# for a prior of preset long_runs or quick, which are for servos with much friction
LONG_RUNS = {"per_motor": "pace_long_runs", "coulomb_viscous": "coulomb_viscous", "stribeck": "stribeck"}
BASELINE_PERIOD = 0.002  # of these presets [s]; priors with another period have no such baselines
RESPONSES = "responses.safetensors"


@dataclass(frozen=True)
class BaselineFits:
    """How the baselines are fitted.

    Attributes:
        folder: of the slow fits, which are reused.
        adam_steps: of the pooled network; the preset's own number if not given.
        seed: of searches and weights.
    """

    folder: Path
    adam_steps: int | None = None
    seed: int = 0


def fitted_baselines(
    log: MotorLog, preset: Preset, fits: BaselineFits, progress: Progress = SILENT
) -> dict[str, LogModel]:
    """All baselines, fitted to a log with known loads; each has the log's motors in its order.

    Args:
        log: training rows.
        preset: recipe of the prior: sample period and warm-up.
        fits: how they are fitted.
        progress: where to report to.

    Raises:
        LogError: it lacks a channel, has another sample period, or is too short.
    """
    recipes = baseline_recipes(log, preset)
    models: dict[str, LogModel] = dict(fitted_responses(log, preset, fits, progress))
    for name, (named, recipe) in recipes.items():
        if name == "pooled_network" and fits.adam_steps is not None:
            recipe = replace(recipe, steps=fits.adam_steps)
        fitted = fit_recipe(log, named, recipe, fits.seed, fits.folder / name, WithoutNotes(progress))
        models[name] = LatentActuator(fitted.network, fitted.mean)
    return models | {"tuned_pd": fitted_tuned_pd(log, progress)}


def fitted_tuned_pd(log: MotorLog, progress: Progress) -> LogModel:
    """One PD for all motors, which scales with the gains of a log that has any."""
    from motorprior.identification.baselines.pd_fit import TUNING, tuned_pd
    from motorprior.identification.baselines.replay_error import scaled_gains, with_scaled_gains

    with progress.start("tune one PD", TUNING) as task:
        return with_scaled_gains(tuned_pd(log, task.advance, scaled_gains(log)), log)


def baseline_recipes(
    log: MotorLog, preset: Preset, wanted: Collection[str] | None = None
) -> dict[str, tuple[str, Preset]]:
    """Preset and recipe of every baseline that has one; windows are shortened to fit the log.

    Args:
        log: training rows.
        preset: recipe of the prior.
        wanted: names of the baselines; all if not given.

    Raises:
        LogError: every segment is too short for one of them.
    """
    from motorprior.identification.presets import PRESETS as NAMED
    from motorprior.identification.training_data.windows import window_starts, with_window_that_fits

    if preset.period != BASELINE_PERIOD:
        return {}
    names = PRESETS | (LONG_RUNS if preset.window == NAMED["long_runs"].window else {})
    names = {name: preset for name, preset in names.items() if wanted is None or name in wanted}
    recipes = {name: (preset, with_window_that_fits(NAMED[preset], log)) for name, preset in names.items()}
    for _, recipe in recipes.values():
        window_starts(tuple(log.segment_slices()), recipe, log.source)
    return recipes


def with_gains_of(preset: Preset, log: MotorLog) -> Preset:
    """A recipe that reads the gains of a log, if it has any."""
    return replace(preset, gain_unit=log.gain_unit if log.stated_kp is not None else "")


def fitted_responses(
    log: MotorLog, preset: Preset, fits: BaselineFits, progress: Progress = SILENT
) -> dict[str, ResponseMotors]:
    """pure_delay, second_order and servo_limits; read from the folder if they were fitted to the same log.

    They need no load: without one, a function of the joint's angle represents gravity.

    Raises:
        LogError: another sample period, or no segment that is long enough.
    """
    from motorprior.identification.baselines.response_fit import fit_responses
    from motorprior.identification.baselines.response_models import CONSTANTS, ResponseMotors
    from motorprior.identification.evaluation.log_fidelity import whole_runs

    out = fits.folder / "responses"
    wanted = description("responses", {"seed": fits.seed}, [], asdict(preset)) | {"inputs": [log_digest(log)]}
    if not is_finished(out, wanted):
        with working(out, wanted):
            gravity = "angle" if log.external_torque is None else "torque"
            runs = whole_runs(with_some_load(log), preset, log.source)
            with progress.start("fit responses that need no load", log.num_joints) as task:
                found = fit_responses(runs, gravity, fits.seed, task.advance, log.firmware)
            header = {"constants": list(CONSTANTS), "joint_names": list(log.joint_names)}
            write_tensors(out / RESPONSES, {name: model.constants for name, model in found.items()}, header)
    kept = read_tensors(out / RESPONSES)[0]
    return {name: ResponseMotors(name, constants) for name, constants in kept.items()}
