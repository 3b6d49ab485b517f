"""Fit the loads of motors that each carry a rigid body of unknown inertia; report and save them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.artifacts import write_json
from motorprior.logs.load_log import PERIOD
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined, smooth_on_grid
from motorprior.progress import Progress

if TYPE_CHECKING:  # importing it compiles
    from motorprior.identification.load_fit import FittedLoad


def with_fitted_loads(logs: Mapping[Path, MotorLog], out: Path, progress: Progress) -> dict[Path, MotorLog]:
    """The logs on a grid, with one load per joint that is fitted to all of them together; writes loads.json.

    Args:
        logs: output file -> log of the same motors and loads, with the recorded rows.
        out: folder for loads.json.
        progress: reports the loads.

    Raises:
        LogError: see `identification.load_fit.fit_loads`, or logs of different motors.
        ArtifactError: the file cannot be written.
    """
    from motorprior.identification import load_fit

    for log in logs.values():
        load_fit.require_physical_kp(log)
    smooth = {target: smooth_on_grid(log, PERIOD) for target, log in logs.items()}
    log = joined(list(smooth.values()))
    with progress.start(f"fit the loads of {log.num_joints} joints", load_fit.MAX_ROUNDS * log.num_joints) as task:
        loads = load_fit.fit_loads(log, task.advance)
    joints = dict(zip(log.joint_names, loads, strict=True))
    for (name, load), motion in zip(joints.items(), np.std(log.joint_pos, axis=0).tolist(), strict=True):
        progress.note(_load_text(name, load, motion))
    described = {
        name: {
            "inertia_kg_m2": load.inertia,
            "inertia_log_deviation": load.inertia_deviation,
            "sine_N_m": float(load.gravity[0]),
            "cosine_N_m": float(load.gravity[1]),
            "gravity_covariance_N2_m2": load.gravity_covariance.tolist(),
            "armature_log_deviation": load.armature_deviation,
            "left_rad": load.error,
        }
        for name, load in joints.items()
    }
    write_json(out / "loads.json", {"joints": described, "logs": [target.name for target in logs]})
    return {target: load_fit.with_fitted_loads(each, loads) for target, each in smooth.items()}


def _load_text(name: str, load: FittedLoad, motion: float) -> str:
    """The result for a joint whose angle has a standard deviation of ``motion`` [rad].

    Gravity is W·sin(q - h) = s·sin q + c·cos q with W = √(s² + c²); its deviation is that along (s, c).
    """
    weight = float(np.hypot(*load.gravity))
    along = load.gravity / max(weight, 1e-12)
    std = float(np.sqrt(along @ load.gravity_covariance @ along))
    gravity = f"{weight:.2g} ± {std:.1g} N·m" if weight > 2.0 * std else f"below {weight + 2.0 * std:.1g} N·m"
    text = (
        f"joint {name}: inertia {load.inertia:.2g} kg·m² (×/÷ {np.exp(load.inertia_deviation):.2f}, 1 σ); "
        f"weight {gravity}; residual {1e3 * load.error:.1f} of {1e3 * motion:.0f} mrad of its motion"
    )
    if load.armature_deviation > 0.3:
        text += f"; the armature identified with it may be off by a factor of {np.exp(load.armature_deviation):.1f}"
    return text
