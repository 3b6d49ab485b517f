"""Fit a motor prior to the log of a bench, or to motor logs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import BENCH_JSON, LOG, read_bench
from motorprior.bench.dynamometer import BENCH
from motorprior.bounds import require_seed
from motorprior.exceptions import ConfigError, LogError
from motorprior.identification.presets import identification_preset
from motorprior.logs.bench_names import bench_names
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.priors.fit_prior import fit_recipe, provenance_of, warn_about_cut_logs
from motorprior.progress import SILENT, Progress


@dataclass(frozen=True)
class Identify:
    """Learn a motor prior from motor logs."""

    logs: tuple[Path, ...]
    """Folder that `motorprior bench` wrote, or motor logs (.parquet) with known loads. The logs can
    be of the same motors or of different motors."""
    out: Path
    """Folder for prior.safetensors."""
    preset: str = "rollout"
    """Recipe: rollout (grey box, simulated in closed loop), long_runs (rollout with windows of a
    second, for real servos), quick (long_runs without a search for optional terms), rigid (quick
    with stiff gears, for legs whose logs do not identify the gears), paper (torque regression), or
    one of the baselines per_motor, latent_network, one_network, actuator_net, paper_wide."""
    seed: int = 0
    """Seed of weights, windows and noise."""
    steps: int | None = None
    """Adam steps of presets that train a network; the number of the preset if not given. An error
    for presets that train no network, such as long_runs."""
    torque: bool = True
    """Fit joint_torque of the logs, too; without it the prior learns from positions and velocities
    alone."""


def run_identify(config: Identify, progress: Progress = SILENT) -> MotorPrior:
    """Train a prior, unless the folder already contains it, and return it.

    Raises as `fit_recipe` and `training_log`.
    """
    require_seed(config.seed)
    recipe = identification_preset(config.preset, config.steps)
    log, provenance = training_log(config.logs, progress)
    if not config.torque:
        log = replace(log, joint_torque=None)
    return fit_recipe(
        log,
        config.preset,
        recipe,
        config.seed,
        config.out,
        progress,
        provenance,
        explains=True,
    )


def training_log(paths: Sequence[Path], progress: Progress) -> tuple[MotorLog, dict[str, Any]]:
    """The log of a bench's folder, or all logs as one, and its provenance.

    The source of the log are its files.

    Raises:
        ConfigError: no log.
        LogError: the log of a bench without its folder, or logs that do not fit together.
    """
    if not paths:
        raise ConfigError(
            "no log given", remedy="give the folder of `motorprior bench`, or motor logs"
        )

    # a bench's folder, or the log in it
    first = paths[0]
    is_log_of_bench = first.name == LOG and (first.parent / BENCH_JSON).is_file()
    folder = first.parent if is_log_of_bench else first
    if len(paths) == 1 and folder.is_dir():
        log, settings = read_bench(folder)
        return log, provenance_of([log], bench=settings.as_json())

    logs = [read_parquet(path) for path in paths]
    log = joined(logs)
    warn_about_cut_logs(logs, log, progress)
    # a user's robot may have the name of a bench
    if log.robot == BENCH and log.joint_names == bench_names(log.num_joints):
        raise LogError(
            f"the log of a bench without its {BENCH_JSON}",
            where=first,
            remedy="give the folder that `motorprior bench` wrote: `motorprior identify FOLDER`",
        )
    source = "; ".join(str(path) for path in paths)
    return replace(log, source=source), provenance_of(logs, log=log.source)
