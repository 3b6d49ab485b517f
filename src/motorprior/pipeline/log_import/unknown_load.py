"""Logs whose joints each carry a rigid body that nobody weighed: the load is fitted to all of them, told, and kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.artifacts import write_json
from motorprior.logs.formats.parquet_io import write_log
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.progress import Progress

if TYPE_CHECKING:  # it compiles
    from motorprior.identification.load_fit import FittedLoad

LOADS = "loads.json"
"""File of the loads, beside the logs."""
UNSURE = 0.3
"""Standard deviation of the logarithm of an armature from which on the user is warned."""


def write_with_unknown_loads(logs: Mapping[Path, MotorLog], out: Path, progress: Progress) -> None:
    """Write recordings of the same motors with the same loads, which are fitted to all of them.

    Args:
        logs: by the file that each becomes, without loads, on the grid of a prior.
        out: folder for LOADS.
        progress: where the loads are told.

    Raises:
        LogError: see `identification.load_fit.fit_loads`, or logs of different motors.
        ArtifactError: a file cannot be written.
    """
    from motorprior.identification.load_fit import MAX_ROUNDS, fit_loads, with_fitted_loads

    log = joined(list(logs.values()))
    with progress.start(f"fit the loads of {log.num_joints} joints", MAX_ROUNDS * log.num_joints) as task:
        loads = fit_loads(log, task.advance)
    motion = np.std(log.joint_pos, axis=0)
    for name, load, moved in zip(log.joint_names, loads, motion, strict=True):
        progress.note(_sentence(name, load, float(moved)))
    for target, each in logs.items():
        write_log(target, with_fitted_loads(each, loads))
    write_json(out / LOADS, _as_json(log.joint_names, loads) | {"logs": [target.name for target in logs]})


def _as_json(names: Sequence[str], loads: Sequence[FittedLoad]) -> dict[str, object]:
    return {
        "joints": {
            name: {
                "inertia_kg_m2": load.inertia,
                "inertia_log_deviation": load.inertia_deviation,
                "sine_N_m": float(load.gravity[0]),
                "cosine_N_m": float(load.gravity[1]),
                "gravity_covariance_N2_m2": load.gravity_covariance.tolist(),
                "armature_log_deviation": load.armature_deviation,
                "left_rad": load.error,
            }
            for name, load in zip(names, loads, strict=True)
        }
    }


def weight_of(load: FittedLoad) -> tuple[float, float, float, float]:
    """Most torque W of the weight and its standard deviation [N·m]; angle where it hangs, and that one's [rad].

    W·sin(q - h) = s·sin q + c·cos q, so that W = √(s² + c²) and h = atan2(-c, s); deviations by their derivatives.
    """
    sine, cosine = load.gravity
    weight = float(np.hypot(sine, cosine))
    along = np.array([sine, cosine]) / max(weight, 1e-12)
    across = np.array([-along[1], along[0]])
    deviations = [float(np.sqrt(unit @ load.gravity_covariance @ unit)) for unit in (along, across)]
    return weight, deviations[0], float(np.arctan2(-cosine, sine)), deviations[1] / max(weight, 1e-12)


def _sentence(name: str, load: FittedLoad, motion: float) -> str:
    """What was found, for a joint whose angle varies by ``motion`` [rad]."""
    weight, unsure, hangs, unsure_hangs = weight_of(load)
    pull = f"weight {weight:.2g} ± {unsure:.1g} N·m, hangs at {hangs:.2f} ± {unsure_hangs:.1g} rad"
    if weight < 2.0 * unsure or unsure_hangs > 1.0:
        pull = f"no weight beyond {weight + 2.0 * unsure:.1g} N·m"
    warning = (
        f"; the armature that is identified from it may be off by a factor of {np.exp(load.armature_deviation):.1f}"
    )
    return (
        f"joint {name}: inertia {load.inertia:.2g} kg·m², times or over {np.exp(load.inertia_deviation):.2f}; {pull}; "
        f"{1e3 * load.error:.1f} of {1e3 * motion:.0f} mrad of its motion are not explained"
        + (warning if load.armature_deviation > UNSURE else "")
    )
