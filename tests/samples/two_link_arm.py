"""Logs of an arm of two links on PD motors, which may carry a tool that its model lacks.

Its axes are perpendicular: a planar arm does not tell a tilted base from another zero of the first
joint.
"""

# pyright: reportAttributeAccessIssue=false
from pathlib import Path

import mujoco
import numpy as np
from motor_logs import joints_of, log_of

from motorprior.logs.loads import with_loads
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot

PERIOD = 0.002  # of the log [s]
FINE = 4  # steps of the simulation per period
KP = 30.0  # [N·m/rad]
KD = 1.2  # [N·m·s/rad]
FOREARM_MASS = 0.6  # [kg]
FOREARM_REACH = 0.22  # twice the distance of its centre of mass from the elbow [m]

_MJCF = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper_arm" pos="0 0 0.5">
      <joint name="shoulder" axis="0 1 0" range="-3 3"/>
      <inertial pos="0 0 0.14" mass="0.9" diaginertia="0.0075 0.0075 0.0006"/>
      <body name="forearm" pos="0 0 0.28">
        <joint name="elbow" axis="1 0 0" range="-3 3"/>
        <inertial pos="0 0 0.11" mass="0.6" diaginertia="0.0032 0.0032 0.0003"/>
        {tool}
      </body>
    </body>
  </worldbody>
</mujoco>
"""
_TOOL = """
<body pos="0 0 {distance}">
  <inertial pos="0 0 0" mass="{mass}" diaginertia="1e-7 1e-7 1e-7"/>
</body>
"""
_ROBOT = """
name = "arm"
motor = "drive"
model = "arm.xml"
base = "fixed"
nominal_pose = [0.6, 0.8]
kp = 30.0
kd = 1.2
torque_limit = 30.0
"""


def mjcf(tool_mass: float = 0.0, tool_distance: float = 0.3) -> str:
    """MJCF of the arm, with a tool [kg] at a distance from the elbow [m]."""
    tool = ""
    if tool_mass:
        tool = _TOOL.format(distance=tool_distance, mass=tool_mass)
    return _MJCF.format(tool=tool)


def robot_of(folder: Path, tool_mass: float = 0.0, tool_distance: float = 0.3) -> Robot:
    """The arm as a robot file in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(mjcf(tool_mass, tool_distance))
    (folder / "arm.toml").write_text(_ROBOT)
    return load_robot(folder / "arm.toml")


def swing(
    robot: Robot,
    seconds: float,
    seed: int,
    tool_mass: float = 0.0,
    elbow_zero: float = 0.0,
) -> MotorLog:
    """Log of the arm with a tool, and the loads of the model of ``robot``.

    ``elbow_zero`` is added to logged command and angle of the elbow [rad].
    """
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    commands = np.array([0.6, 0.8]) + _sines(rng, time)

    model = mujoco.MjModel.from_xml_string(mjcf(tool_mass))
    model.opt.timestep = PERIOD / FINE
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_armature[:] = 0.012
    model.dof_damping[:] = 0.1
    model.dof_frictionloss[:] = 0.15
    data = mujoco.MjData(model)
    data.qpos[:] = commands[0]
    angles = np.empty_like(commands)
    velocities = np.empty_like(commands)
    for row, command in enumerate(commands):
        angles[row] = data.qpos
        velocities[row] = data.qvel
        for _ in range(FINE):
            data.qfrc_applied[:] = KP * (command - data.qpos) - KD * data.qvel
            mujoco.mj_step(model, data)

    ones = np.ones_like(angles)
    zeros = np.array([0.0, elbow_zero])
    log = log_of(
        time,
        commands + zeros,
        angles + zeros + 1e-4 * rng.standard_normal(angles.shape),
        joint_vel=velocities,
        logged_kp=KP * ones,
        logged_kd=KD * ones,
        **joints_of(robot),
    )
    return with_loads(log, robot)


def _sines(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    frequency = np.exp(rng.uniform(np.log(0.1), np.log(2.5), (6, 2)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 2))
    sines = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    return 0.25 * np.sum(sines * np.minimum(1.0, 0.5 / frequency), axis=1)
