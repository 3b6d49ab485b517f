"""Run an exported model next to the learned motors in the same model.

Both follow the same targets for two seconds at the model's own timestep, from its initial pose, in
the air: without contacts and joint limits, and without gravity if its base is free. So the error is
the format's, on the links that its motors will move. The targets of motors with a motion profile
pass a `MotionProfile` first, as they must where the export is used.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
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
    targets = _targets(model.opt.timestep, len(joints))
    values = motors.constants()
    limits = None
    if SPEED in values:
        limits = (values[SPEED], values[ACCELERATION])
    angles = _run_exported(model, joints, targets, limits)
    learned = _run_learned(original, motors, joints, targets, model.opt.timestep)

    error = np.abs(angles - learned).max(axis=1)
    is_unstable = ~(error < UNSTABLE)  # also NaN
    diverged_at = None
    if is_unstable.any():
        diverged_at = float(np.argmax(is_unstable) * model.opt.timestep)
    losses = {}
    for column, name in enumerate(joints):
        losses[name] = float(rmse(angles[:, column], learned[:, column]))
    return ModelRun(float(model.opt.timestep), losses, diverged_at)


def _targets(timestep: float, num_joints: int) -> np.ndarray:
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
    targets: np.ndarray,
    limits: tuple[np.ndarray, np.ndarray] | None,
) -> np.ndarray:
    """(steps, J) angles [rad] of the exported motors; NaN after they diverge.

    With ``limits`` of speed and acceleration (J,), the targets pass a `MotionProfile`.
    """
    _put_in_the_air(model)
    data = mujoco.MjData(model)
    addresses = [model.joint(name).qposadr[0] for name in joints]
    controls = [_control_of(model, name) for name in joints]
    start = data.qpos[addresses].copy()
    for actuator, target in zip(controls, start, strict=True):
        data.ctrl[_address(model, actuator)] = target
        fill_delay_line(model, data, actuator, target)

    profile = None
    if limits is not None:
        profile = MotionProfile(*limits, dt=model.opt.timestep, start=start)

    angles = np.full(targets.shape, np.nan)
    for step, change in enumerate(targets):
        angles[step] = data.qpos[addresses]
        references = start + change if profile is None else profile.step(start + change)
        for actuator, target in zip(controls, references, strict=True):
            data.ctrl[_address(model, actuator)] = target
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
    targets: np.ndarray,
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

    angles = np.zeros_like(targets)
    for step, change in enumerate(targets):
        angles[step] = data.qpos[addresses]
        for _ in range(substeps):
            driven.drive(start + change)
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
