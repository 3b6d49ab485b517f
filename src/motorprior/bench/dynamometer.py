"""Virtual dynamometer: joints with known loads, driven by physical or learned motors."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.command_frame import SENT, Frames, framed_arrays
from motorprior.actuator.kernels import measure_joint_pos, reset_actuator, step_actuator
from motorprior.compiled import njit
from motorprior.logs.command_modes import gain_factors
from motorprior.logs.motor_log import MotorLog

BENCH = "bench"  # robot name in the log of a bench


def next_velocity(dq: Any, torque: Any, external: Any, inertia: Any, damping: Any, dt: Any) -> Any:
    """Joint velocity [rad/s] after a step of semi-implicit Euler with implicit damping.

    As in MuJoCo; also for JAX.

        dq' = (dq + dt·(torque + external)/inertia) / (1 + dt·damping/inertia)
        q'  = q + dt·dq'

    Args:
        dq: velocity before the step [rad/s].
        torque: of the motor without its damping [N·m].
        external: torque of the load [N·m].
        inertia: of the joint, with the armature [kg·m²].
        damping: of the motor [N·m·s/rad].
        dt: step [s].
    """
    return (dq + dt * (torque + external) / inertia) / (1.0 + dt * damping / inertia)


_next_velocity = njit(nogil=True, inline="always")(next_velocity)


@njit(cache=True, nogil=True, inline="always")
def step_joints(arrays, h, target, external, stiffness, inertia, q, dq, torque):
    """Advance n joints on their motors (`ActuatorArrays`) by one step of ``h`` [s].

    All vectors are (n,), in SI units. The load is external + stiffness·q; ``inertia`` includes the
    armature. The function writes q, dq, and the torque of the motors without their damping. The
    JAX rollout cannot use it, since JAX arrays cannot be written; it uses `next_velocity`.
    """
    step_actuator(arrays, h, target, q, dq, torque)
    for j in range(q.shape[0]):
        load = external[j] + stiffness[j] * q[j]
        dq[j] = _next_velocity(dq[j], torque[j], load, inertia[j], arrays.damping[j], h)
        q[j] += h * dq[j]


@dataclass(frozen=True)
class Trial:
    """Commands and loads for n joints."""

    position_target: np.ndarray  # (steps, n) [rad]
    external_torque: np.ndarray  # (steps, n) [N·m] on the joint
    load_inertia: np.ndarray  # (n,) [kg·m²], without the motor
    dt: float  # sample period [s]
    joint_pos: np.ndarray | None = None  # (n,) initial angles [rad]; the first target if not given
    joint_vel: np.ndarray | None = None  # (n,) initial velocities [rad/s]; 0 if not given
    # (steps, n) external torque per joint angle [N·m/rad]; 0 if not given
    load_stiffness: np.ndarray | None = None
    # the rest of the command in MIT mode, (steps, n) or numbers; None for position commands
    frames: Frames | None = None


def trial_of(segment: MotorLog) -> Trial:
    """A segment of a log with known loads as a trial.

    Joints start in the recorded state or, if the encoders are on the rotors, with zero velocity at
    the first target.
    """
    assert segment.external_torque is not None
    assert segment.load_inertia is not None
    trial = Trial(
        segment.position_target, segment.external_torque, segment.load_inertia[0], segment.period
    )

    if segment.load_stiffness is not None:
        torque_at_zero = segment.external_torque - segment.load_stiffness * segment.joint_pos
        trial = replace(
            trial, external_torque=torque_at_zero, load_stiffness=segment.load_stiffness
        )

    if segment.has_command_frames:
        missing = np.zeros_like(segment.joint_pos)
        velocity_target = segment.velocity_target
        feedforward = segment.torque_feedforward
        frames = Frames(
            missing if velocity_target is None else velocity_target,
            missing if feedforward is None else feedforward,
            *gain_factors(segment),
        )
        trial = replace(trial, frames=frames)

    if segment.encoder == "joint":
        velocity = None if segment.joint_vel is None else segment.joint_vel[0]
        trial = replace(trial, joint_pos=segment.joint_pos[0], joint_vel=velocity)
    return trial


@dataclass(frozen=True)
class Response:
    """Response of n motors to a trial."""

    joint_pos: np.ndarray  # (steps, n) [rad]
    joint_vel: np.ndarray  # (steps, n) [rad/s]
    joint_torque: np.ndarray  # (steps, n) mean over the following step [N·m]
    # (steps, n) encoder readings [rad]; the encoder is on the rotor if the model has a rotor, and
    # on the joint otherwise
    encoder_pos: np.ndarray


@njit(cache=True, nogil=True)
def _simulate(
    arrays, inertia, targets, external, stiffness, frames, dt, substeps, joint_pos, joint_vel, out
):
    """Simulate a trial into out (4, steps, n), with ``substeps`` integration steps per sample.

    ``frames`` (steps, 4·n) are the rows of `ActuatorArrays.frames`; (0, 0) for position commands.
    """
    steps, n = targets.shape
    h = dt / substeps
    q = joint_pos.copy()
    dq = joint_vel.copy()
    torque = np.zeros(n)
    has_frames = frames.shape[0] > 0
    if has_frames:
        arrays.frames[SENT, :] = frames[0]
    reset_actuator(arrays, targets[0], q)
    for step in range(steps):
        if has_frames:
            arrays.frames[SENT, :] = frames[step]
        out[0, step] = q
        out[1, step] = dq
        out[2, step] = 0.0
        measure_joint_pos(arrays, q, out[3, step])
        for _ in range(substeps):
            step_joints(
                arrays, h, targets[step], external[step], stiffness[step], inertia, q, dq, torque
            )
            for j in range(n):
                out[2, step, j] += (torque[j] - arrays.damping[j] * dq[j]) / substeps


def run(actuator: Actuator, trial: Trial, start_offset: float = 0.0) -> Response:
    """Simulate ``trial`` from its initial angles plus ``start_offset`` [rad].

    The integration step is the period of the trial, or shorter if the ``bench_step`` of the
    actuator kind requires it.
    """
    steps_per_sample = trial.dt / actuator.kind.bench_step
    substeps = max(1, int(np.ceil(steps_per_sample - 1e-9)))
    h = trial.dt / substeps
    arrays = actuator.arrays(h) if trial.frames is None else framed_arrays(actuator, h)
    inertia = trial.load_inertia + actuator.armature

    # compiled code needs contiguous arrays
    targets = np.ascontiguousarray(trial.position_target, float)
    external = np.ascontiguousarray(trial.external_torque, float)
    stiffness = np.zeros_like(targets)
    if trial.load_stiffness is not None:
        stiffness = np.ascontiguousarray(trial.load_stiffness, float)

    frames = np.zeros((0, 0))
    if trial.frames is not None:
        quantities = [np.broadcast_to(values, targets.shape) for values in trial.frames]
        frames = np.concatenate(quantities, axis=1, dtype=np.float64)

    steps, n = targets.shape
    initial_pos = targets[0] if trial.joint_pos is None else np.asarray(trial.joint_pos, float)
    q = initial_pos + start_offset
    dq = np.zeros(n) if trial.joint_vel is None else np.asarray(trial.joint_vel, float)
    out = np.zeros((4, steps, n))
    _simulate(arrays, inertia, targets, external, stiffness, frames, trial.dt, substeps, q, dq, out)
    return Response(*out)


def response_of_all(
    actuator: Actuator,
    target: np.ndarray,
    inertia: float,
    external: np.ndarray | float,
    period: float,
) -> Response:
    """Response of all motors to the same target (steps,) [rad] on the same load.

    The external torque [N·m] is (steps,) or constant, the load inertia is in kg·m², the period of
    the targets in s.
    """
    shape = (len(target), actuator.num_motors)
    targets = np.broadcast_to(target[:, None], shape)
    torque = np.broadcast_to(np.reshape(external, (-1, 1)), shape)
    load = np.full(actuator.num_motors, inertia)
    return run(actuator, Trial(targets, torque, load, period))
