"""Write motors of a prior or posterior for another simulator."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ConfigError
from motorprior.exports.exporter import prior_of
from motorprior.exports.registry import Exported, export
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.progress import SILENT, Progress


@dataclass(frozen=True)
class Export:
    """Write sampled motors for another simulator."""

    motors_of: Path
    """File of the motors to write: a prior, or a posterior, which also needs --prior."""
    out: Path
    """Folder for the files."""
    format: str
    """bam, card, mjcf, mjcf-detailed or table (docs/export.md)."""
    motors: int = 1
    """Number of sampled motors; formats with an MJCF write one variant of it per sample."""
    seed: int = 0
    """Seed of the samples."""
    prior: Path | None = None
    """The prior that a posterior was adapted from."""
    model: Path | None = None
    """Your MJCF, for the formats mjcf and mjcf-detailed."""
    joints: tuple[str, ...] = ()
    """Names of the joints; the joints of the prior or posterior if not given."""
    kp: float | None = None
    """Position gain of the motors [unit of the logs]; the median of the logs if not given."""
    kd: float | None = None
    """Velocity gain of the motors [unit of the logs]; the median of the logs if not given."""
    log: Path | None = None
    """Motor log (.parquet) of these joints with loads. If given, the command also measures how much
    accuracy the exported motors lose on this log."""


def run_export(config: Export, progress: Progress = SILENT) -> Exported:
    """Write the files, and report the loss of accuracy; raises the errors of `export`."""
    source = _loaded(config)
    log = None if config.log is None else read_parquet(config.log)
    exported = export(
        source,
        config.format,
        config.out,
        motors=config.motors,
        seed=config.seed,
        model=config.model,
        joints=config.joints,
        gains=_gains(config, source),
        log=log,
    )
    progress.note(str(exported))
    return exported


def _loaded(config: Export) -> MotorPrior | MotorPosterior:
    if config.prior is None:
        return MotorPrior.load(config.motors_of)
    prior = MotorPrior.load(config.prior)
    return MotorPosterior.load(config.motors_of, prior)


def _gains(config: Export, source: MotorPrior | MotorPosterior) -> tuple[float, float] | None:
    """The gains (kp, kd) of the exported motors; None if the settings give neither.

    A gain that is not given is the median of the logs. If the logs have no kd, its column in
    `MotorLog.gains` repeats kp, and kd follows a given kp.
    """
    if config.kp is None and config.kd is None:
        return None
    logged = prior_of(source).gains
    if logged is None:
        raise ConfigError(
            "the logs of the prior have no gains, so its motors have a fixed kp and kd",
            remedy="omit it",
            argument="kd" if config.kp is None else "kp",
        )

    command_mode = prior_of(source).command_mode
    if command_mode in ("velocity", "torque") and (config.kp is None or config.kd is None):
        raise ConfigError(
            f"the logs of the prior have {command_mode} commands, so they do not give the other "
            "gain",
            remedy="give kp and kd, for motors that follow positions",
            argument="kp" if config.kp is None else "kd",
        )

    kp, kd = np.median(logged, axis=1).tolist()
    if config.kp is not None:
        kp = config.kp
    logged_kp, logged_kd = logged
    has_kd = not np.array_equal(logged_kp, logged_kd)
    if config.kd is not None:
        kd = config.kd
    elif not has_kd:
        kd = kp
    return kp, kd
