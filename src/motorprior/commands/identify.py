"""Fit a motor prior to the log of a bench, or to motor logs."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from motorprior.identification.fit_prior import _fitted_in, _Job, _recipe
from motorprior.progress import SILENT, Progress
from motorprior.stage import description

if TYPE_CHECKING:  # they import JAX
    pass
from motorprior.bench.bench_folder import BENCH_JSON, LOG, read_bench
from motorprior.bench.recording import BENCH
from motorprior.exceptions import ConfigError, LogError
from motorprior.identification.training_log import MOTIONS, Origin, origin_of
from motorprior.logs.motor_log import MotorLog, motion_digest
from motorprior.logs.operations import joined
from motorprior.logs.readers.motor_log_file import read_parquet


@dataclass(frozen=True)
class Identify:
    """Learn a motor prior from the log of a bench, or from logs of a suspended robot."""

    bench: Path | tuple[Path, ...]
    """Folder that `motorprior bench` wrote, or motor logs (.parquet) with known loads, of the same or of different
    motors."""
    out: Path
    """Folder for prior.safetensors."""
    preset: str = "rollout"
    """Recipe: rollout (closed loop, grey box), long_runs (the same over windows of a second, for real servos),
    quick (long_runs without a search for optional terms), paper (torque regression), or one of the baselines
    one_motor, per_motor, latent_network, one_network, actuator_net, paper_wide."""
    seed: int = 0
    """Seed of weights, windows and noise."""
    steps: int | None = None
    """Adam steps; the preset's own number if not given. Not for presets that train no network, such as long_runs."""
    torque: bool = True
    """Use the log's joint_torque; otherwise the prior learns from positions and velocities alone."""


def run_identify(config: Identify, progress: Progress = SILENT) -> None:
    """Train, unless the folder already contains this prior.

    Raises:
        LogError, ConfigError: the log does not fit the recipe.
    """
    from motorprior.identification.presets import with_logged_settings

    recipe = _recipe(config.preset, config.steps, config.seed)
    log, inputs, origin = training_log(config.bench)
    recipe = with_logged_settings(recipe, log)
    settings = {name: value for name, value in asdict(config).items() if name != "bench"}  # among the inputs
    wanted = description("identify", settings, inputs, recipe=asdict(recipe))
    log = log if config.torque else replace(log, joint_torque=None)
    _fitted_in(config.out, wanted, _Job(log, str(inputs[0]), config.preset, recipe, config.seed, origin), progress)


def training_log(given: Path | tuple[Path, ...]) -> tuple[MotorLog, list[Path], Origin]:
    """The log of a bench's folder, or all logs as one; the files that the prior depends on, the log first.

    Raises:
        ConfigError: nothing is given, or a folder among several paths.
        LogError, ArtifactError: missing, truncated or inconsistent files.
    """
    paths = [given] if isinstance(given, Path) else list(given)
    if not paths:
        raise ConfigError("no log given", remedy="give the folder of `motorprior bench`, or motor logs")
    paths = [path.parent if path.name == LOG and (path.parent / BENCH_JSON).is_file() else path for path in paths]
    folder = next((path for path in paths if path.is_dir()), None)
    if folder is None:
        logs = [read_parquet(path) for path in paths]
        log = joined(logs)
        if log.robot == BENCH:
            remedy = "give the folder that `motorprior bench` wrote: `motorprior identify FOLDER`"
            raise LogError(f"the log of a bench without its {BENCH_JSON}", where=paths[0], remedy=remedy)
        return log, paths, origin_of(log, logs)
    if len(paths) > 1:
        raise ConfigError("not a motor log", where=folder, remedy="give one bench's folder alone, or .parquet files")
    if not any((folder / name).is_file() for name in (LOG, BENCH_JSON)):
        remedy = "give the folder that `motorprior bench` wrote, or motor logs (.parquet)"
        raise LogError(f"a folder without {LOG}", where=folder, remedy=remedy)
    log, settings = read_bench(folder)
    provenance = {"bench": settings.as_json(), MOTIONS: [motion_digest(log)]}
    return log, [folder / LOG, folder / BENCH_JSON], Origin(settings.fleet.robot, settings.fleet.motor, provenance)
