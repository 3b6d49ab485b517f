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
    """Prior, or posterior with --prior."""
    out: Path
    """Folder for the files."""
    format: str
    """bam, card, mjcf, mjcf-detailed or table (docs/export.md)."""
    motors: int = 1
    """Number of samples; formats with an MJCF write as many variants of it."""
    seed: int = 0
    """Seed of the samples."""
    prior: Path | None = None
    """The prior that a posterior belongs to."""
    model: Path | None = None
    """Your MJCF, for mjcf and mjcf-detailed."""
    joints: tuple[str, ...] = ()
    """Names of the joints; those of the prior or posterior if not given."""
    kp: float | None = None
    """Gain of the motors [unit of the logs]; that of the median motor of the logs if not given."""
    kd: float | None = None
    """Damping gain, if the logs have one [unit of the logs]."""
    log: Path | None = None
    """Motor log (.parquet) of these joints with loads: the loss on it is measured, too."""


def run_export(config: Export, progress: Progress = SILENT) -> Exported:
    """Write the files, and report the loss; errors as `export`."""
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
    """Settings kp and kd; None if neither is given.

    A gain that is not given is the median of the logs; kd is kp if the logs have no kd.
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

    kp, kd = np.median(logged, axis=1).tolist()
    if config.kp is not None:
        kp = config.kp
    has_kd = not np.array_equal(*logged)  # see `MotorLog.gains`
    if config.kd is not None:
        kd = config.kd
    elif not has_kd:
        kd = kp
    return kp, kd
