"""Write motors of a prior or posterior in any format. A new format is a file in `exports.formats` with its EXPORTER."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import mujoco
import numpy as np

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import constants_of
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import ConfigError
from motorprior.exports import formats
from motorprior.exports.exporter import Exporter, Request, motors_of, sampled
from motorprior.exports.replay import carried, log_trial, losses
from motorprior.logs.motor_log import MotorLog

MAX_STEP = 0.002  # of the replay [s]


def find_exporters() -> dict[str, Exporter]:
    """The EXPORTER of every module in `exports.formats` by name."""
    found = (import_module(f"{formats.__name__}.{module.name}").EXPORTER for module in iter_modules(formats.__path__))
    return {exporter.name: exporter for exporter in found}


def is_supported(exporter: Exporter) -> bool:
    """Whether the installed MuJoCo has what the format uses."""
    return int(mujoco.__version__.split(".")[0]) >= exporter.mujoco


@dataclass(frozen=True)
class Exported:
    """Result of `export`."""

    files: tuple[Path, ...]
    losses: dict[str, float]  # RMSE against our own motors by load [rad]; empty for a format without loss
    not_expressed: dict[str, float]  # median by name of the constants that the format lacks


def export(
    source: MotorPrior | MotorPosterior,
    format: str,
    out: str | Path,
    *,
    motors: int = 1,
    seed: int = 0,
    model: str | Path | None = None,
    joints: tuple[str, ...] = (),
    gains: np.ndarray | None = None,
    log: MotorLog | None = None,
) -> Exported:
    """Write ``motors`` samples per joint for another simulator, and measure what the format loses.

    Args:
        source: prior or posterior with physical constants.
        format: bam, card, mjcf, mjcf-detailed or table (docs/export.md).
        out: folder for the files.
        motors: number of samples, K; formats with an MJCF write K variants of it.
        seed: of the samples; same arguments, same bytes.
        model: your MJCF, for mjcf and mjcf-detailed.
        joints: names of the J joints; those of the source if not given, one joint for a bench's prior.
        gains: (2, J) kp and kd, see `MotorPrior.sample`.
        log: of the J joints, with loads: the loss on it is measured, too.

    Returns:
        Files, and RMSE of the exported motors against ours, in closed loop on a leg and a shank (`exports.replay`).

    Raises:
        ConfigError: an unknown format or joint, a model missing, or a prior without physical constants.
        ArtifactError: the model cannot be read, or ``out`` cannot be written.
        LogError: a log without loads.
    """
    exporters = find_exporters()
    if format not in exporters:
        raise ConfigError(f"no format {format!r}", remedy=f"use one of {', '.join(exporters)}", argument="format")
    exporter = exporters[format]
    require_count("motors", motors)
    require_seed(seed)
    if exporter.needs_model and model is None:
        raise ConfigError(f"format {format} changes your MJCF", remedy="give model", argument="model")
    if not is_supported(exporter):
        problem = f"format {format} needs MuJoCo {exporter.mujoco}, and this is {mujoco.__version__}"
        raise ConfigError(problem, remedy="export where no extra holds MuJoCo back", argument="format")
    sample = sampled(source, motors, seed, joints or source.joint_names or ("motor",), gains)
    values, period, terms = sample.constants(), sample.prior.model.period, sample.robots[0].model.motor.terms
    step = min(MAX_STEP, period)
    flat = motors_of({name: value.ravel() for name, value in values.items()}, terms, period)
    lost = {name: float(np.median(np.abs(values[name]))) for name in exporter.drops}
    found: dict[str, float] = {}
    if exporter.replay is not None:
        lost |= {name: float(np.median(value)) for name, value in values.items() if name in constants_of(terms)}
        recorded = None if log is None else log_trial(log, sample.joint_names, motors, step)
        found = losses(exporter.replay, flat, step, recorded)
    values["carried"] = carried(flat, step).reshape(motors, -1)
    request = Request(sample, values, Path(out), None if model is None else Path(model), found, lost)
    return Exported(tuple(exporter.write(request)), found, lost)
