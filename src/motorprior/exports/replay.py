"""Replay exported motors next to our own: one hinge on a leg and on a shank, in closed loop.

Loads scale with the motors, whose median armature is a: the shank has the inertia 0.1·a, the leg 1.25·a, both with the
gravity of a pendulum of 0.1 m, linear about 45°. For the motors of the shipped robot (a = 0.0032 kg·m²) these are its
bare shank and its leg.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.bench.dynamometer import Trial, run, trial_of
from motorprior.bench.excitation import EXCITATIONS, zero_order_hold
from motorprior.exceptions import ConfigError, LogError
from motorprior.exports.exporter import Exporter, with_kd
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import resample
from motorprior.signals import rms

LOADS = {"leg": 1.25, "shank": 0.1}  # load inertia over the median armature [-]
GRAVITY = 0.7 * 98.0  # torque of gravity, and its change with the angle, over the load inertia [1/s²]
SECONDS, HOLD = 3.0, 0.01  # of a trial, and of every target, like those of a 100 Hz policy [s]
SMOOTH, STEPS = ("gait", "sine"), ("steps",)  # signals, in turn for the motors
_SEED = 54


def trial(load: str, armature: np.ndarray, dt: float = 0.002, signals: tuple[str, ...] = SMOOTH) -> Trial:
    """Commands and load for motors with these armatures (n,) [kg·m²], at steps of ``dt`` [s]."""
    rng, steps, n = np.random.default_rng(_SEED), round(SECONDS / dt), len(armature)
    chosen = [EXCITATIONS[signals[motor % len(signals)]].target for motor in range(n)]
    targets = np.stack([zero_order_hold(signal(rng, steps, dt), round(HOLD / dt)) for signal in chosen], axis=1)
    inertia = np.full(n, LOADS[load] * float(np.median(armature)))
    weight = np.tile(-GRAVITY * inertia, (steps, 1))
    return Trial(targets, weight, inertia, dt, load_stiffness=weight)


def carried(motors: GreyBoxActuator, dt: float = 0.002) -> np.ndarray:
    """(n,) mean absolute torque in the gears on the leg [N·m]."""
    given = trial("leg", motors.constants()["armature"], dt)
    return np.abs(run(motors, given).joint_torque).mean(axis=0)


def losses(exporter: Exporter, motors: GreyBoxActuator, dt: float = 0.002) -> dict[str, float]:
    """RMSE over all motors of exported against our own joint angles [rad]: leg, shank, and leg_steps.

    The latter with targets that jump, where the torque limit is reached. Empty for a format without loss.
    """
    if exporter.replay is None:
        return {}
    values = with_kd(motors.constants()) | {"carried": carried(motors, dt)}
    found = {}
    for name, load, signals in (("leg", "leg", SMOOTH), ("shank", "shank", SMOOTH), ("leg_steps", "leg", STEPS)):
        given = trial(load, values["armature"], dt, signals)
        found[name] = float(rms(exporter.replay(values, given) - run(motors, given).joint_pos))
    return found


def log_loss(
    exporter: Exporter, motors: GreyBoxActuator, joints: Sequence[str], log: MotorLog, dt: float = 0.002
) -> float:
    """RMSE of exported against our own joint angles [rad] under the commands and loads of a log's longest segment.

    ``motors`` are those of ``joints``, robot after robot. Both start at rest at the first target.

    Raises:
        ConfigError: joints that are not in the log.
        LogError: a log without loads.
    """
    assert exporter.replay is not None
    if log.load_inertia is None or log.external_torque is None:
        raise LogError("no loads", where=log.source, remedy="import it with loads (docs/your-motors.md)")
    if missing := [name for name in joints if name not in log.joint_names]:
        problem = f"{log.source} has no joint {', '.join(missing)}, but {', '.join(log.joint_names)}"
        raise ConfigError(problem, remedy="name joints of the log", argument="joints")
    log = log.with_joints([log.joint_names.index(name) for name in joints])
    segment = trial_of(resample(max(log.segments(), key=lambda each: each.num_rows), dt))
    copies = (1, motors.num_motors // log.num_joints)
    stiffness = segment.load_stiffness
    stiffness = np.zeros_like(segment.external_torque) if stiffness is None else stiffness
    given = Trial(
        np.tile(segment.position_target, copies), np.tile(segment.external_torque, copies),
        np.tile(segment.load_inertia, copies[1]), segment.dt, load_stiffness=np.tile(stiffness, copies),
    )  # fmt: skip
    values = with_kd(motors.constants()) | {"carried": carried(motors, dt)}
    return float(rms(exporter.replay(values, given) - run(motors, given).joint_pos))


RIG = """<mujoco>
  <option timestep="{dt!r}" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="link"><inertial pos="0 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
      <joint name="joint" axis="0 1 0"/></body>
  </worldbody>
  <actuator>
    <motor name="joint" joint="joint"/>
  </actuator>
</mujoco>
"""


def replay_mjcf(texts: list[str], given: Trial, joint: str = "joint") -> np.ndarray:
    """(steps, n) angles [rad] of ``joint`` in n models with one control, at their own timestep."""
    assert given.load_stiffness is not None
    out = np.zeros(given.position_target.shape)
    for motor, text in enumerate(texts):
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        start = given.position_target[0, motor]
        data.qpos[:] = start
        fill_history(model, data, np.full(model.nu, start))
        pos, dof = int(model.joint(joint).qposadr[0]), int(model.joint(joint).dofadr[0])
        for step in range(len(out)):
            out[step, motor] = data.qpos[pos]
            data.ctrl[0] = given.position_target[step, motor]
            external, stiffness = given.external_torque[step, motor], given.load_stiffness[step, motor]
            data.qfrc_applied[dof] = external + stiffness * data.qpos[pos]
            mujoco.mj_step(model, data)
    return out


def fill_history(model: mujoco.MjModel, data: mujoco.MjData, ctrl: np.ndarray) -> None:
    """Fill the delay lines of the actuators with controls that have never changed; ``ctrl`` is (nu,)."""
    for actuator in range(model.nu):
        samples = int(model.actuator_history[actuator, 0])
        if samples:
            values = np.full(samples, ctrl[actuator])
            times = model.opt.timestep * np.arange(-samples, 0.0)
            mujoco.mj_initCtrlHistory(model, data, actuator, times, values)


def rig(given: Trial, motor: int) -> str:
    """The test model with the load of one motor: MJCF of one hinge and its actuator."""
    return RIG.format(dt=given.dt, inertia=float(given.load_inertia[motor]))


def as_mrad(found: Mapping[str, float]) -> str:
    """For example "leg 2.4 mrad, shank 4.7 mrad"."""
    return ", ".join(f"{name} {1e3 * value:.1f} mrad" for name, value in found.items())
