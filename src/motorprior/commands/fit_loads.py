"""Import logs of motors that each carry a rigid body of unknown inertia: fit the loads, report and save them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.artifacts import write_json
from motorprior.logs.formats.parquet_io import write_log
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import Progress

if TYPE_CHECKING:  # importing it compiles
    from motorprior.identification.load_fit import FittedLoad


def write_with_fitted_loads(logs: Mapping[Path, MotorLog], out: Path, progress: Progress) -> None:
    """Fit one load per joint to all logs together, and write the logs with them.

    Args:
        logs: output file -> log of the same motors and loads, on the grid of a prior.
        out: folder for loads.json.
        progress: reports the loads.

    Raises:
        LogError: see `identification.load_fit.fit_loads`, or logs of different motors.
        ArtifactError: a file cannot be written.
    """
    from motorprior.identification.load_fit import MAX_ROUNDS, fit_loads, with_fitted_loads

    log = joined(list(logs.values()))
    with progress.start(f"fit the loads of {log.num_joints} joints", MAX_ROUNDS * log.num_joints) as task:
        loads = fit_loads(log, task.advance)
    motion = np.std(log.joint_pos, axis=0)
    for name, load, std in zip(log.joint_names, loads, motion, strict=True):
        progress.note(_load_text(name, load, float(std)))
    for target, each in logs.items():
        write_log(target, with_fitted_loads(each, loads))
    joints = {
        name: {
            "inertia_kg_m2": load.inertia,
            "inertia_log_deviation": load.inertia_deviation,
            "sine_N_m": float(load.gravity[0]),
            "cosine_N_m": float(load.gravity[1]),
            "gravity_covariance_N2_m2": load.gravity_covariance.tolist(),
            "armature_log_deviation": load.armature_deviation,
            "left_rad": load.error,
        }
        for name, load in zip(log.joint_names, loads, strict=True)
    }
    write_json(out / "loads.json", {"joints": joints, "logs": [target.name for target in logs]})


def _load_text(name: str, load: FittedLoad, motion: float) -> str:
    """The result for a joint whose angle has a standard deviation of ``motion`` [rad].

    Gravity is W·sin(q - h) = s·sin q + c·cos q: W = √(s² + c²), h = atan2(-c, s); deviations by linearisation.
    """
    sine, cosine = load.gravity
    weight = float(np.hypot(sine, cosine))
    along = np.array([sine, cosine]) / max(weight, 1e-12)
    across = np.array([-along[1], along[0]])
    weight_std, across_std = (float(np.sqrt(unit @ load.gravity_covariance @ unit)) for unit in (along, across))
    angle, angle_std = float(np.arctan2(-cosine, sine)), across_std / max(weight, 1e-12)
    gravity = f"weight {weight:.2g} ± {weight_std:.1g} N·m, equilibrium at {angle:.2f} ± {angle_std:.1g} rad"
    if weight < 2.0 * weight_std or angle_std > 1.0:
        gravity = f"weight below {weight + 2.0 * weight_std:.1g} N·m"
    text = (
        f"joint {name}: inertia {load.inertia:.2g} kg·m² (×/÷ {np.exp(load.inertia_deviation):.2f}, 1 σ); {gravity}; "
        f"residual {1e3 * load.error:.1f} of {1e3 * motion:.0f} mrad of its motion"
    )
    if load.armature_deviation > 0.3:
        text += f"; the armature identified with it may be off by a factor of {np.exp(load.armature_deviation):.1f}"
    return text
