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
from motorprior.exports.exporter import Replay, with_kd
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import resample
from motorprior.signals import rmse

SMOOTH, STEPS = ("gait", "sine"), ("steps",)  # signals, in turn for the motors
# trial -> load inertia over the median armature [-], and signals; steps reach the torque limit
TRIALS = {"leg": (1.25, SMOOTH), "shank": (0.1, SMOOTH), "leg_steps": (1.25, STEPS)}
GRAVITY = 0.7 * 98.0  # torque of gravity, and its change with the angle, over the load inertia [1/s²]
SECONDS, HOLD = 3.0, 0.01  # of a trial, and of every target, like those of a 100 Hz policy [s]
_SEED = 54


def trial(name: str, armature: np.ndarray, dt: float) -> Trial:
    """One of TRIALS for motors with these armatures (n,) [kg·m²], at steps of ``dt`` [s]."""
    load, signals = TRIALS[name]
    rng, steps, n = np.random.default_rng(_SEED), round(SECONDS / dt), len(armature)
    chosen = [EXCITATIONS[signals[motor % len(signals)]].target for motor in range(n)]
    targets = np.stack([zero_order_hold(signal(rng, steps, dt), round(HOLD / dt)) for signal in chosen], axis=1)
    inertia = np.full(n, load * float(np.median(armature)))
    weight = np.tile(-GRAVITY * inertia, (steps, 1))
    return Trial(targets, weight, inertia, dt, load_stiffness=weight)


def log_trial(log: MotorLog, joints: Sequence[str], robots: int, dt: float) -> Trial:
    """Commands and loads of a log's longest segment for these joints, robot after robot, at rest at the first target.

    Raises:
        ConfigError: joints that are not in the log.
        LogError: a log without loads.
    """
    if log.load_inertia is None or log.external_torque is None:
        raise LogError("no loads", where=log.source, remedy="import it with loads (docs/your-motors.md)")
    if missing := [name for name in joints if name not in log.joint_names]:
        problem = f"{log.source} has no joint {', '.join(missing)}, but {', '.join(log.joint_names)}"
        raise ConfigError(problem, remedy="name joints of the log", argument="joints")
    segment = trial_of(resample(max(log.segments(), key=lambda each: each.num_rows), dt))
    columns = [log.joint_names.index(name) for name in joints] * robots
    external, stiffness = segment.external_torque[:, columns], segment.load_stiffness
    return Trial(
        segment.position_target[:, columns], external, segment.load_inertia[columns], dt,
        load_stiffness=np.zeros_like(external) if stiffness is None else stiffness[:, columns],
    )  # fmt: skip


def carried(motors: GreyBoxActuator, dt: float) -> np.ndarray:
    """(n,) mean absolute torque in the gears on the leg [N·m]."""
    given = trial("leg", motors.constants()["armature"], dt)
    return np.abs(run(motors, given).joint_torque).mean(axis=0)


def losses(replay: Replay, motors: GreyBoxActuator, dt: float, log: Trial | None = None) -> dict[str, float]:
    """RMSE over all motors of exported against our own joint angles [rad], by the name in TRIALS, and of a ``log``."""
    values = with_kd(motors.constants()) | {"carried": carried(motors, dt)}
    trials = {name: trial(name, values["armature"], dt) for name in TRIALS} | ({} if log is None else {"log": log})
    return {name: float(rmse(replay(values, given), run(motors, given).joint_pos)) for name, given in trials.items()}


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


def replay_mjcf(text: str, given: Trial, motor: int) -> np.ndarray:
    """(steps,) angles [rad] of the joint of a changed RIG under the commands and loads of one motor."""
    assert given.load_stiffness is not None
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = given.position_target[0, motor]
    for actuator in range(model.nu):  # fill the delay lines with a control that has never changed
        samples = int(model.actuator_history[actuator, 0])
        if samples:
            times, start = model.opt.timestep * np.arange(-samples, 0.0), given.position_target[0, motor]
            mujoco.mj_initCtrlHistory(model, data, actuator, times, np.full(samples, start))
    joint, out = data.joint("joint"), np.zeros(len(given.position_target))
    for step in range(len(out)):
        out[step] = joint.qpos[0]
        data.ctrl[0] = given.position_target[step, motor]
        joint.qfrc_applied[0] = given.external_torque[step, motor] + given.load_stiffness[step, motor] * out[step]
        mujoco.mj_step(model, data)
    return out


def as_mrad(found: Mapping[str, float]) -> str:
    """For example "leg 2.4 mrad, shank 4.7 mrad"."""
    return ", ".join(f"{name} {1e3 * value:.1f} mrad" for name, value in found.items())
