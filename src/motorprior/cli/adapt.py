"""``motorprior adapt``: the posterior of z for the motors of a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.cli.bounds import require_at_least
from motorprior.cli.console import bar, table
from motorprior.cli.motors import load_prior
from motorprior.cli.recipe import recipe_of
from motorprior.cli.stage import begin, description, digest, finish, is_finished
from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.parquet_io import read_log

POSTERIOR = "posterior.safetensors"
FALSE_ALARMS = 0.01
"""About this share of the logs of the prior's own fleet is called unlike it, however many motors a log has."""


@dataclass(frozen=True)
class Adapt:
    """Find where in the prior's latent space the motors of a log are."""

    prior: tyro.conf.Positional[Path]
    """Prior that `motorprior identify` wrote."""
    log: tyro.conf.Positional[Path]
    """Motor log (.parquet) with joint_vel, load_inertia and external_torque, at the prior's sample period."""
    out: Path
    """Folder for posterior.safetensors."""
    seconds: float | None = None
    """Use the first seconds of the log only [s]; all of it if not given."""
    anyway: bool = False
    """Write the posterior even if the log is unlike anything the prior knows."""


def first_seconds(log: MotorLog, seconds: float | None) -> MotorLog:
    """The first rows of a log; a last segment cut to a single row is left out."""
    if seconds is None:
        return log
    period = float(np.median(np.diff(log.time)))
    kept = log.rows(slice(0, max(2, round(seconds / period))))
    last = kept.segment_slices()[-1]
    return kept.rows(slice(0, last.start)) if last.stop - last.start < 2 else kept


def adapt_to(prior: MotorPrior, path: Path, log: MotorLog, where: str) -> tuple[Any, np.ndarray]:
    """Posterior of every motor of the log, and how surprising each is.

    Raises:
        LogError: the log lacks a channel, has another period, or is shorter than a window.
        ArtifactError: a prior without latents or without the figures of its own errors.
    """
    from motorprior.identification.adapt import adapt
    from motorprior.identification.reference import ending, knows_its_errors, pieces, surprise
    from motorprior.identification.windows import training_data

    preset = recipe_of(prior, path)
    if prior.network.num_latents == 0 or not knows_its_errors(prior.metrics, preset.objective == "rollout"):
        raise ArtifactError(
            "it has no latents, or does not know its own errors", where=path, remedy="identify it with preset rollout"
        )
    data = training_data(log, preset, where)
    # A prior that never saw torques judges by positions, whatever the log has.
    knows_torque = f"loss_mean{ending(False)}" in prior.metrics or preset.objective == "torque"
    data = replace(data, has_torque=data.has_torque and knows_torque)
    which = ending(data.has_torque) if knows_torque else ""
    found = adapt(prior.network, data, preset, prior.metrics[f"loss_mean{which}"])
    return found, surprise(prior.metrics, found.loss, pieces(found.windows, preset), which)


def run_adapt(config: Adapt) -> None:
    """Adapt, unless the folder holds this very posterior already.

    Raises:
        LogError: the log does not fit, or is unlike anything the prior knows and --anyway was not given.
    """
    if config.seconds is not None:
        require_at_least(0, seconds=config.seconds)
    prior, log = load_prior(config.prior), first_seconds(read_log(config.log), config.seconds)
    wanted = description("adapt", asdict(config), [config.prior, config.log])
    if is_finished(config.out, wanted):
        return
    with bar(f"adapt to {log.num_joints} motors, {log.duration:.1f} s", 1) as progress:
        found, surprising = adapt_to(prior, config.prior, log, str(config.log))
        progress.advance()
    rows = [
        [name, f"{loss:.3f}", f"{chance:.3f}", " ".join(f"{value:+.2f}" for value in mean)]
        for name, loss, chance, mean in zip(log.joint_names, found.loss, surprising, found.mean, strict=True)
    ]
    table("Posterior of z", ["motor", "loss", "P(as bad)", "mean"], rows)
    bound = FALSE_ALARMS / log.num_joints
    strangers = [name for name, chance in zip(log.joint_names, surprising, strict=True) if chance < bound]
    if strangers and not config.anyway:
        raise LogError(
            f"motors {strangers} are unlike any the prior was trained on: a motor of its fleet fits as badly with a "
            f"chance below {bound:.2g} (one log in {1 / FALSE_ALARMS:.0f} of that fleet gets this far)",
            where=config.log,
            remedy="check the log with `motorprior logs check`, train a prior on such motors, or give --anyway",
        )
    begin(config.out)
    posterior = MotorPosterior(
        found.mean,
        found.covariance,
        log.joint_names,
        digest(config.prior),
        log.duration,
        tuple(float(value) for value in surprising),
    )
    posterior.save(config.out / POSTERIOR)
    finish(config.out, wanted)
