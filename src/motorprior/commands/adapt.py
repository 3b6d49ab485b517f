"""Adapt a prior to a log: the posterior of its motors."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from motorprior.actuator.motor_posterior import POSTERIOR_FILE, MotorPosterior
from motorprior.actuator.motor_prior import prior_path
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.priors.adapt import adapt
from motorprior.priors.prior_file import load_prior
from motorprior.progress import SILENT, Progress
from motorprior.stage import description, is_finished, locked, working


@dataclass(frozen=True)
class Adapt:
    """Adapt a prior to a log: the posterior of its motors."""

    prior: Path
    """Prior of the log's robot, as `motorprior identify` wrote it, or the name of a shipped motor
    card."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period."""
    out: Path
    """Folder for posterior.safetensors."""
    allow_outliers: bool = False
    """Write the posterior even if motors are outliers of the prior."""


def run_adapt(config: Adapt, progress: Progress = SILENT) -> MotorPosterior:
    """Adapt, unless the folder already contains this posterior, and return it.

    Raises errors as `adapt`.
    """
    log = replace(read_parquet(config.log), source=str(config.log))
    prior = load_prior(config.prior, log)

    stage = description("adapt", asdict(config), [prior_path(config.prior), config.log])
    if is_finished(config.out, stage):
        progress.note(
            f"{config.out / POSTERIOR_FILE} exists already, from the same log and settings"
        )
        return MotorPosterior.load(config.out / POSTERIOR_FILE, prior)

    with locked(config.out):
        posterior = adapt(prior, log, allow_outliers=config.allow_outliers, progress=progress)
        with working(config.out, stage):  # only now: an error above leaves the earlier posterior
            posterior.save(config.out / POSTERIOR_FILE)
    return posterior
