"""Fidelity of a prior where there is no truth: on a log that nothing was fitted to."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.parquet_io import read_parquet
from motorprior.pipeline.adapt import adapt_to
from motorprior.pipeline.motor_choice import load_prior
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.recipe import recipe_of
from motorprior.pipeline.stage import description, is_finished, read_results, working, write_results
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class ValidateLog:
    """Measure how far a prior's motors are from a held-out log: its first half tells of them, the second is judged."""

    prior: Path
    """Prior that `motorprior identify` wrote from other logs."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period, of any motors."""
    out: Path
    """Folder for figures.json."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_validate_log(config: ValidateLog, progress: Progress = SILENT) -> Results:
    """Measure, or read what this very measurement found.

    Returns:
        ``free_run_rmse`` [rad] of free runs of a second, median and mean over motors, of the prior adapted to the first
        half (by its preset's name), its central motor (``prior_mean``) and one PD tuned on the first half; and
        ``coverage50`` and ``coverage90`` of the adapted prior's draws.

    Raises:
        LogError, ArtifactError: a log or a prior that cannot be used.
    """
    robot = load_robot(config.robot)
    prior, log = load_prior(config.prior, robot), read_parquet(config.log)
    wanted = description("validate-log", asdict(config), [config.prior, config.log, *robot.files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            write_results(config.out, _measure(config, prior, log, progress))
    return read_results(config.out)


def _measure(config: ValidateLog, prior: MotorPrior, log: MotorLog, progress: Progress) -> Results:
    from motorprior.identification.log_fidelity import free_run_errors, free_runs, known_half, log_coverage

    known, judged = known_half(log)
    runs = free_runs(judged, recipe_of(prior, config.prior), str(config.log))
    with progress.start(f"adapt to {log.num_joints} motors, tune a PD, free runs", 3) as task:
        found = adapt_to(prior, config.prior, known, str(config.log))
        task.advance()
        models: dict[str, Actuator] = {prior.preset: LatentActuator(prior.network, found.mean)}
        models["prior_mean"] = LatentActuator(prior.network, prior.expected(judged.joint_names))
        models["tuned_pd"] = _tuned_pd(known)
        task.advance()
        errors = free_run_errors(runs, models)
        task.advance()
    rows = [
        Result("free_run_rmse", "rad", float(of(values)), model, statistic=statistic)
        for model, values in errors.items()
        for statistic, of in (("median", np.median), ("mean", np.mean))
    ]
    covered = log_coverage(prior, found, runs)
    return Results.of(rows + [Result(f"coverage{level}", "1", share) for level, share in covered.items()])


def _tuned_pd(log: MotorLog) -> IdealPd:
    from motorprior.identification.baselines import EVERYTHING, fit_pd, repeated

    return repeated(fit_pd(log, IdealPd.uniform(1, 10.0, 0.5, 1.5), EVERYTHING), log.num_joints)
