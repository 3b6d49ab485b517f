"""Run an exported model next to the learned motors in the same model.

Both follow the same targets for two seconds at the model's own timestep, from its initial pose, in
the air: without contacts and joint limits, and without gravity if its base is free. So the error is
the format's, on the links that its motors will move. Motors of velocity commands follow
VELOCITY_PER_CHANGE times the changes of the targets. Motors of torque commands get the torques of
gravity at the start, and those that accelerate their joints by ACCELERATION_PER_CHANGE times the
changes. The targets of motors with a motion profile
pass a `MotionProfile` first, as they must where the export is used.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.exports.exporter import UNSTABLE
from motorprior.exports.motion_profile import ACCELERATION, SPEED, MotionProfile
from motorprior.exports.plain_joint import fill_delay_line
from motorprior.signals import rmse
from motorprior.simulation.driven_joints import DrivenJoints, drives

SECONDS = 2.0  # duration of a run [s]
AMPLITUDE = 0.15  # amplitude of the targets about the initial pose [rad]
VELOCITY_PER_CHANGE = 10.0  # [1/s]
ACCELERATION_PER_CHANGE = 100.0  # [1/s²]
MIN_FREQUENCY = 0.5  # [Hz]
MAX_FREQUENCY = 3.0  # [Hz]
_IN_THE_AIR = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


@dataclass(frozen=True)
class ModelRun:
    """Errors of an exported model."""

    timestep: float  # [s]
    losses: dict[str, float]  # RMSE by joint [rad]
    diverged_at: float | None  # time at which it diverges [s]; None if it does not


def run_model(
    original: Path, exported: Path, motors: GreyBoxActuator, joints: Sequence[str]
) -> ModelRun:
    """Errors of the joints' motors in the file ``exported``, made from the file ``original``.

    Args:
        original: the user's model.
        exported: the same model with exported motors.
        motors: the learned motors, one per joint.
        joints: names of the J joints.
    """
    model = mujoco.MjModel.from_xml_path(str(exported))
    changes = _changes(model.opt.timestep, len(joints))
    values = motors.constants()
    limits = None
    if SPEED in values:
        limits = (values[SPEED], values[ACCELERATION])
    commands = _commands(original, motors, joints, changes)
    angles = _run_exported(model, joints, commands, limits)
    learned = _run_learned(original, motors, joints, commands, model.opt.timestep)

    error = np.abs(angles - learned).max(axis=1)
    is_unstable = ~(error < UNSTABLE)  # also NaN
    diverged_at = None
    if is_unstable.any():
        diverged_at = float(np.argmax(is_unstable) * model.opt.timestep)
    losses = {}
    for column, name in enumerate(joints):
        losses[name] = float(rmse(angles[:, column], learned[:, column]))
    return ModelRun(float(model.opt.timestep), losses, diverged_at)


def _commands(
    original: Path, motors: GreyBoxActuator, joints: Sequence[str], changes: np.ndarray
) -> np.ndarray:
    """(steps, J) commands of the motors, see above; position targets are relative to the start."""
    if motors.command_mode in ("position", "mit"):
        return changes
    if motors.command_mode == "velocity":
        return VELOCITY_PER_CHANGE * changes

    model = _without_actuators(original, joints)
    _put_in_the_air(model)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dofs = [model.joint(name).dofadr[0] for name in joints]
    torque = np.array(data.qfrc_bias[dofs])  # of gravity
    joint_inertia = motors.constants()["armature"] - model.dof_armature[dofs]
    momentum = np.zeros(model.nv)
    for joint, dof in enumerate(dofs):
        mujoco.mj_mulM(model, data, momentum, np.eye(model.nv)[dof])
        joint_inertia[joint] += momentum[dof]
    return torque + ACCELERATION_PER_CHANGE * joint_inertia * changes


def _changes(timestep: float, num_joints: int) -> np.ndarray:
    """(steps, J) changes of the targets [rad]: a chirp, shifted in time between the joints."""
    time = np.arange(0.0, SECONDS, timestep)[:, None] + 0.1 * np.arange(num_joints)
    sweep = (MAX_FREQUENCY - MIN_FREQUENCY) / (2.0 * SECONDS)
    phase = 2.0 * math.pi * (MIN_FREQUENCY * time + sweep * time**2)
    ramp = np.minimum(1.0, np.arange(len(time)) * timestep / 0.2)[:, None]  # starts at rest
    return AMPLITUDE * ramp * np.sin(phase)


def _put_in_the_air(model: mujoco.MjModel) -> None:
    model.opt.disableflags |= int(_IN_THE_AIR)
    if _FREE in model.jnt_type:
        model.opt.gravity[:] = 0.0


def _run_exported(
    model: mujoco.MjModel,
    joints: Sequence[str],
    commands: np.ndarray,
    limits: tuple[np.ndarray, np.ndarray] | None,
) -> np.ndarray:
    """(steps, J) angles [rad] of the exported motors; NaN after they diverge.

    With ``limits`` of speed and acceleration (J,), the targets pass a `MotionProfile`.
    """
    _put_in_the_air(model)
    data = mujoco.MjData(model)
    addresses = [model.joint(name).qposadr[0] for name in joints]
    controls = [_control_of(model, name) for name in joints]
    # controls that are no angles have the bias 0 for the angle
    start = data.qpos[addresses] * (model.actuator_biasprm[controls, 1] != 0.0)
    for actuator, control in zip(controls, start, strict=True):
        data.ctrl[_address(model, actuator)] = control
        fill_delay_line(model, data, actuator, control)

    profile = None
    if limits is not None:
        profile = MotionProfile(*limits, dt=model.opt.timestep, start=start)

    angles = np.full(commands.shape, np.nan)
    for step, command in enumerate(commands):
        angles[step] = data.qpos[addresses]
        references = start + command if profile is None else profile.step(start + command)
        for actuator, control in zip(controls, references, strict=True):
            data.ctrl[_address(model, actuator)] = control
        mujoco.mj_step(model, data)
        if (
            data.time < (step + 0.5) * model.opt.timestep
        ):  # MuJoCo resets a simulation that diverged
            break
    return angles


def _control_of(model: mujoco.MjModel, joint: str) -> int:
    """Index of the servo of a joint: on the joint, or on its rotor."""
    names = {joint, f"{joint}_rotor"}
    for actuator in range(len(model.actuator_trntype)):
        driven = model.joint(int(model.actuator_trnid[actuator, 0])).name
        if driven in names and _address(model, actuator) >= 0:
            return actuator
    raise AssertionError(joint)  # every exported joint has a servo


def _address(model: mujoco.MjModel, actuator: int) -> int:
    """Address of an actuator's control; negative in MuJoCo 4 if it has none."""
    addresses = getattr(model, "actuator_ctrladr", None)
    if addresses is None:
        return actuator
    return int(addresses[actuator]) if model.actuator_ctrlnum[actuator] else -1


def _run_learned(
    original: Path,
    motors: GreyBoxActuator,
    joints: Sequence[str],
    commands: np.ndarray,
    timestep: float,
) -> np.ndarray:
    """(steps, J) angles [rad] of the learned motors, in steps that they support."""
    model = _without_actuators(original, joints)
    _put_in_the_air(model)
    substeps = math.ceil(timestep / motors.model.period - 1e-9)
    model.opt.timestep = timestep / substeps
    if int(model.opt.integrator) == _RK4:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    driven = DrivenJoints(model, data, motors, joints)
    addresses = [model.joint(name).qposadr[0] for name in joints]
    start = data.qpos[addresses].copy()

    angles = np.zeros_like(commands)
    for step, command in enumerate(commands):
        angles[step] = data.qpos[addresses]
        for _ in range(substeps):
            if motors.command_mode == "velocity":
                driven.drive(start, velocity_target=command)
            elif motors.command_mode == "torque":
                driven.drive(start, torque_feedforward=command)
            else:
                driven.drive(start + command)
            mujoco.mj_step(model, data)
    return angles


def _without_actuators(path: Path, joints: Sequence[str]) -> mujoco.MjModel:
    """The model without the actuators that drive the joints."""
    spec = mujoco.MjSpec.from_file(str(path))
    model = spec.compile()
    indices = [model.joint(name).id for name in joints]
    for actuator in np.flatnonzero(drives(model)[:, indices].any(axis=1))[::-1].tolist():
        spec.delete(spec.actuators[actuator])
    for key in list(spec.keys):  # their controls no longer fit
        spec.delete(key)
    return spec.compile()
