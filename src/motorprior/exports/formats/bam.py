"""JSON of better-actuator-models (BAM): one file per sample and joint, friction model m5, actuator unitree_go1.

BAM's actuator unitree_go1 has our law without velocity filter: clip(kp·ratio·(target - q) - damping·dq, ±max_torque).
Its friction m5, with E of the load and M of the motor [N·m], is

    friction_base + |load_friction_external·E - load_friction_motor·M| + friction_stribeck·s,
    s = exp(-|dq/dtheta_stribeck|^alpha)

In a rigid gear with load inertia J and armature a, the gear transmits (J·M - a·E)/(J + a): the two load frictions are
load_friction·J/(J + a) and load_friction·a/(J + a), here for J = a. kp, damping and command_delay are not parameters of
BAM's models: set them where the file is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from motorprior.actuator.geared_motor_step import STRIBECK_VELOCITY
from motorprior.artifacts import write_json
from motorprior.bench.dynamometer import Trial
from motorprior.exports.bam_law import BamMotor
from motorprior.exports.exporter import Constants, Exporter, Request, one_motor

# exp(-|v/(1.22·STRIBECK_VELOCITY)|^1.05) is close to our 1/(1 + (v/STRIBECK_VELOCITY)²)
STRIBECK_SHAPE = {"dtheta_stribeck": 1.22 * STRIBECK_VELOCITY, "alpha": 1.05}


def parameters(v: Mapping[str, float]) -> dict[str, float | str]:
    """BAM's parameters of one motor, of its constants by name."""
    return {
        "model": "m5", "actuator": "unitree_go1", "ratio": 1.0, "max_torque": v["torque_limit"],
        "armature": v["armature"], "q_offset": -v["encoder_zero"], "friction_base": v["coulomb"],
        "friction_stribeck": v["stribeck_torque"], "friction_viscous": v["viscous_damping"],
        "load_friction_motor": 0.5 * v["load_friction"], "load_friction_external": 0.5 * v["load_friction"],
        "load_friction_motor_stribeck": 0.0, "load_friction_external_stribeck": 0.0, **STRIBECK_SHAPE,
        "kp": v["kp"], "damping": v["kd"], "command_delay": v["delay"],
    }  # fmt: skip


def write(request: Request) -> list[Path]:
    """One JSON per sample and joint; the key motorprior, which BAM ignores, has origin and loss."""
    files, about = [], request.provenance()
    for index, joint, values in request.motors():
        files.append(request.out / f"{joint}_{index:03d}.json")
        write_json(files[-1], parameters(values) | {"motorprior": about})
    return files


def replay(values: Constants, given: Trial) -> np.ndarray:
    """(steps, n) joint angles [rad] of BAM's law and its own integration."""
    servos = [BamMotor.of(parameters(one_motor(values, motor))) for motor in range(len(values["kp"]))]
    return np.stack([servo.simulate(given, motor) for motor, servo in enumerate(servos)], axis=1)


EXPORTER = Exporter("bam", ("velocity_filter", "gear_stiffness", "backlash", "gear_damping"), write, replay)
