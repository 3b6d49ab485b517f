"""The log that a prior is fitted to: the folder of a bench, or motor logs, joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motorprior.bench.bench_folder import BENCH_JSON, LOG, read_bench
from motorprior.bench.recording import BENCH
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import MotorLog, motion_digest

MOTIONS = "motions"  # key in a prior's provenance: `motion_digest` of every log that it was trained on


@dataclass(frozen=True)
class Origin:
    """Robot, motor and provenance of a log, for the prior."""

    robot: str
    motor: str
    provenance: dict[str, Any]


def origin_of(log: MotorLog, parts: Sequence[MotorLog]) -> Origin:
    """Origin of a log that was joined from ``parts``."""
    return Origin(log.robot, log.motor, {"log": log.source, MOTIONS: [motion_digest(part) for part in parts]})


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
