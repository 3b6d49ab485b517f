"""A log whose joints each carry a rigid body that nobody weighed: the load is fitted, told, and kept beside the log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.artifacts import write_json
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.progress import Progress

if TYPE_CHECKING:  # it compiles
    from motorprior.identification.load_fit import FittedLoads

ENDING = ".loads.json"
"""Of the file beside the log, after the log's name."""
UNSURE = 0.3
"""Standard deviation of the logarithm of an inertia from which on the user is warned."""


def with_unknown_load(log: MotorLog, beside: Path, progress: Progress) -> MotorLog:
    """The log with the loads of `identification.load_fit`.

    Args:
        log: without loads, on the grid of a prior.
        beside: the file that the log will be; what was found goes into one of its name that ends with ENDING.
        progress: where the loads are told.

    Raises:
        LogError: gains that are not stated in N·m/rad, another period, or too short a log.
    """
    from motorprior.identification.load_fit import ROUNDS, fit_loads, with_fitted_loads

    with progress.start(f"fit the loads of {log.num_joints} joints", ROUNDS) as task:
        loads = fit_loads(log, task.advance)
    found = _by_joint(log, loads)
    for name, load in found.items():
        progress.note(_sentence(name, load))
    beside.parent.mkdir(parents=True, exist_ok=True)
    write_json(beside.with_suffix(ENDING), found)
    return with_fitted_loads(log, loads)


def _by_joint(log: MotorLog, loads: FittedLoads) -> dict[str, dict[str, float]]:
    """Joint -> inertia, most torque of the weight and the angle at which the load hangs, with standard deviations."""
    sine, cosine = loads.gravity.T
    most = np.hypot(sine, cosine)
    values = {
        "inertia_kg_m2": loads.inertia,
        "inertia_relative_deviation": loads.inertia_deviation,
        "weight_N_m": most,
        "weight_deviation_N_m": np.hypot(*(loads.gravity * loads.gravity_deviation).T) / np.maximum(most, 1e-12),
        "hangs_at_rad": np.arctan2(-cosine, sine),
        "left_rad": loads.error,
    }
    return {
        name: {what: float(value[joint]) for what, value in values.items()}
        for joint, name in enumerate(log.joint_names)
    }


def _sentence(name: str, load: dict[str, float]) -> str:
    inertia, percent = load["inertia_kg_m2"], 100.0 * load["inertia_relative_deviation"]
    weight, deviation = load["weight_N_m"], load["weight_deviation_N_m"]
    warning = "; an armature that is identified from this log is as unsure as this inertia"
    return (
        f"joint {name}: inertia {inertia:.2g} kg·m² (± {percent:.0f} %), weight {weight:.2g} ± {deviation:.1g} N·m, "
        f"hangs at {load['hangs_at_rad']:.2f} rad, {1e3 * load['left_rad']:.1f} mrad of the motion not explained"
        + (warning if load["inertia_relative_deviation"] > UNSURE else "")
    )
