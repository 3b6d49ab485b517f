"""Virtual dynamometer: joints with known loads, driven by physical or learned motors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays
from motorprior.actuator.kernels import measure_joint_pos, reset_actuator, step_actuator
from motorprior.compiled import njit


def next_velocity(dq: Any, torque: Any, external: Any, inertia: Any, damping: Any, dt: Any) -> Any:
    """Joint velocity [rad/s] after a step of semi-implicit Euler with implicit damping, as MuJoCo's; also for JAX.

        dq' = (dq + dt·(torque + external)/inertia) / (1 + dt·damping/inertia),   then q' = q + dt·dq'

    ``torque`` is the motor's without its damping, ``external`` that of the load [N·m]; ``inertia`` is that of load and
    armature [kg·m²], ``damping`` the motor's [N·m·s/rad].
    """
    return (dq + dt * (torque + external) / inertia) / (1.0 + dt * damping / inertia)


_next_velocity = njit(nogil=True, inline="always")(next_velocity)


@dataclass(frozen=True)
class Trial:
    """Commands and loads for n joints."""

    position_target: np.ndarray  # (steps, n) [rad]
    external_torque: np.ndarray  # (steps, n) [N·m] on the joint
    load_inertia: np.ndarray  # (n,) [kg·m²], without the motor's own
    dt: float  # sample period of the trial [s]
    joint_pos: np.ndarray | None = None  # (n,) initial angles [rad]; the first target if not given
    joint_vel: np.ndarray | None = None  # (n,) initial velocities [rad/s]; 0 if not given
    # (steps, n) further torque on the joint per its own angle [N·m/rad]; none if not given
    load_stiffness: np.ndarray | None = None


@dataclass(frozen=True)
class Response:
    """Response of n motors to a trial."""

    joint_pos: np.ndarray  # (steps, n) [rad]
    joint_vel: np.ndarray  # (steps, n) [rad/s]
    joint_torque: np.ndarray  # (steps, n) mean over the following step [N·m]
    # (steps, n) readings of the motors' encoders [rad], which sit on the rotor if the model has one
    encoder_pos: np.ndarray


@njit(cache=True, nogil=True)
def _simulate(
    arrays: ActuatorArrays,
    inertia: np.ndarray,
    targets: np.ndarray,
    external: np.ndarray,
    stiffness: np.ndarray,
    dt: float,
    fine: int,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    out: np.ndarray,
) -> None:
    """Simulate a trial into out (4, steps, n), with ``fine`` integration steps per sample."""
    steps, n = targets.shape
    h = dt / fine
    q, dq, torque = joint_pos.copy(), joint_vel.copy(), np.zeros(n)
    reset_actuator(arrays, targets[0], q)
    for step in range(steps):
        out[0, step], out[1, step], out[2, step] = q, dq, 0.0
        measure_joint_pos(arrays, q, out[3, step])
        for _ in range(fine):
            step_actuator(arrays, h, targets[step], q, dq, torque)
            for j in range(n):
                load = external[step, j] + stiffness[step, j] * q[j]
                dq[j] = _next_velocity(dq[j], torque[j], load, inertia[j], arrays.damping[j], h)
                out[2, step, j] += (torque[j] - arrays.damping[j] * dq[j]) / fine
                q[j] += h * dq[j]


def run(actuator: Actuator, trial: Trial, start_offset: float = 0.0) -> Response:
    """Simulate ``trial`` from where it begins, plus ``start_offset`` [rad].

    The integration step is the trial's period, or shorter if the ``bench_step`` of the motors' kind requires it.
    """
    fine = max(1, int(np.ceil(trial.dt / actuator.kind.bench_step - 1e-9)))
    steps, n = trial.position_target.shape
    first = trial.position_target[0] if trial.joint_pos is None else trial.joint_pos
    out = np.zeros((4, steps, n))
    _simulate(
        actuator.arrays(trial.dt / fine),
        trial.load_inertia + actuator.armature,
        np.ascontiguousarray(trial.position_target, dtype=np.float64),
        np.ascontiguousarray(trial.external_torque, dtype=np.float64),
        np.zeros((steps, n))
        if trial.load_stiffness is None
        else np.ascontiguousarray(trial.load_stiffness, np.float64),
        trial.dt,
        fine,
        np.asarray(first, np.float64) + start_offset,
        np.zeros(n) if trial.joint_vel is None else np.asarray(trial.joint_vel, np.float64),
        out,
    )
    return Response(*out)
