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
    source = MotorPrior.load(config.motors_of if config.prior is None else config.prior)
    if config.prior is not None:
        source = MotorPosterior.load(config.motors_of, source)
    found = export(
        source,
        config.format,
        config.out,
        motors=config.motors,
        seed=config.seed,
        model=config.model,
        joints=config.joints,
        gains=_gains(config, source),
        log=None if config.log is None else read_parquet(config.log),
    )
    progress.note(str(found))
    return found


def _gains(config: Export, source: MotorPrior | MotorPosterior) -> tuple[float, float] | None:
    """Given kp and kd; one that is not given is the median of the logs, or kd is kp if these have none."""
    if config.kp is None and config.kd is None:
        return None
    logged = prior_of(source).gains
    if logged is None:
        problem = "the logs of the prior have no gains, so its motors have a fixed kp and kd"
        raise ConfigError(problem, remedy="omit it", argument="kd" if config.kp is None else "kp")
    kp, kd = np.median(logged, axis=1).tolist()
    kp = kp if config.kp is None else config.kp
    same = np.array_equal(*logged)  # see `MotorLog.gains`
    return kp, (kp if same else kd) if config.kd is None else config.kd
