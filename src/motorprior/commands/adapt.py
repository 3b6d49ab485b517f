"""Find the motors of a log in a prior's latent space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from motorprior.bounds import require_number
from motorprior.identification.adapt import (
    OutlierTest,
    _note_findings,
    _note_training_log,
    _posterior,
    _require_no_outliers,
    adapt_to,
    motor_constants,
    outlier_test,
)
from motorprior.identification.prior_file import prior_and_robot
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.logs.splits import first_seconds
from motorprior.progress import SILENT, Progress
from motorprior.stage import description, is_finished, locked, working

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.latents.latent_fit import Posterior

POSTERIOR = "posterior.safetensors"


@dataclass(frozen=True)
class Adapt:
    """Find the motors of a log in the prior's latent space."""

    prior: Path
    """Prior that `motorprior identify` wrote."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period."""
    out: Path
    """Folder for posterior.safetensors."""
    seconds: float | None = None
    """Use only the first seconds of the log [s]; all of it if not given."""
    anyway: bool = False
    """Write the posterior even if motors are outliers of the prior."""
    robot: str | None = None
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). If none is given, the prior
    must be of the robot that the log names."""


Show: TypeAlias = "Callable[[MotorLog, Posterior, OutlierTest, dict[str, np.ndarray]], None]"


def run_adapt(
    config: Adapt,
    progress: Progress = SILENT,
    show: Show = lambda log, found, outliers, constants: None,
) -> None:
    """Adapt, unless the folder already contains this posterior.

    Args:
        config: settings.
        progress: where to report to.
        show: called with the results before outliers are rejected; the constants (M,) are those of the posterior
            means, empty for a network.

    Raises:
        LogError: the log does not fit, or has outliers and ``anyway`` is not set.
        ArtifactError: another command writes to the folder.
    """
    if config.seconds is not None:
        require_number("seconds", config.seconds)
    whole = read_parquet(config.log)
    log = first_seconds(whole, config.seconds)
    prior, robot = prior_and_robot(config.prior, log, config.robot)
    wanted = description("adapt", asdict(config), [config.prior, config.log, *(robot.files if robot else ())])
    _note_training_log(prior, whole, str(config.log), progress)
    if is_finished(config.out, wanted):
        progress.note(f"{config.out / POSTERIOR} exists already, from the same log and settings")
        return
    with locked(config.out):
        with progress.start(f"adapt to {log.num_joints} motors, {log.duration:.1f} s", 1) as task:
            found = adapt_to(prior, config.prior, log, str(config.log))
            outliers = outlier_test(prior, config.prior, log, str(config.log), found)
            task.advance()
        show(log, found, outliers, motor_constants(prior, log, found.mean))
        if not config.anyway:
            _require_no_outliers(log, outliers, config.log)
        with working(config.out, wanted):  # only now: an error above leaves the earlier posterior
            _posterior(prior, log, found, outliers).save(config.out / POSTERIOR)
    _note_findings(prior, log, found, progress)
