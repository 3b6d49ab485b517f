"""Logs of an arm of two links on PD motors, with something that the log does not state.

Its axes are perpendicular: a planar arm does not tell a tilted base from another zero of the first
joint. The arm may also be planar, or stand on a joint that turns about the vertical.
"""

from pathlib import Path

import mujoco
import numpy as np
from motor_logs import joints_of, log_of

from motorprior.logs.loads import with_loads
from motorprior.logs.loads_dynamics import gravity_in_base
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.load import load_robot
from motorprior.robots.robot import GRAVITY, Robot

PERIOD = 0.002  # of the log [s]
FINE = 4  # steps of the simulation per period
KP = 30.0  # [N·m/rad]
KD = 1.2  # [N·m·s/rad]
FOREARM_MASS = 0.6  # [kg]
FOREARM_REACH = 0.22  # twice the distance of its centre of mass from the elbow [m]

_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
_LINKS = """
<body name="upper_arm" pos="0 0 0.06">
  <joint name="shoulder" axis="{shoulder}" range="-3 3"/>
  <inertial pos="0 0 0.14" mass="0.9" diaginertia="0.0075 0.0075 0.0006"/>
  <body name="forearm" pos="0 0 0.28">
    <joint name="elbow" axis="{elbow}" range="-3 3"/>
    <inertial pos="0 0 0.11" mass="0.6" diaginertia="0.0032 0.0032 0.0003"/>
    {tool}
  </body>
</body>
"""
_TURRET = """
<body name="turret" pos="0 0 0.44">
  <joint name="yaw" axis="0 0 1" range="-3 3"/>
  <inertial pos="0 0 0.03" mass="0.7" diaginertia="0.0012 0.0012 0.0008"/>
  {links}
</body>
"""
_MJCF = '<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>'
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
nominal_pose = 0.6
kp = 30.0
kd = 1.2
torque_limit = 30.0
"""


def mjcf(tool_mass: float = 0.0, tool_distance: float = 0.3, axes: str = "yx") -> str:
    """MJCF of the arm, with a tool [kg] at a distance from the elbow [m].

    ``axes`` are those of shoulder and elbow, or of yaw ("z"), shoulder and elbow.
    """
    tool = ""
    if tool_mass:
        tool = _TOOL.format(distance=tool_distance, mass=tool_mass)
    *_, shoulder, elbow = axes
    bodies = _LINKS.format(shoulder=_AXES[shoulder], elbow=_AXES[elbow], tool=tool)
    if len(axes) == 3:
        bodies = _TURRET.format(links=bodies)
    return _MJCF.format(bodies=bodies)


def robot_of(
    folder: Path, tool_mass: float = 0.0, tool_distance: float = 0.3, axes: str = "yx"
) -> Robot:
    """The arm as a robot file in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(mjcf(tool_mass, tool_distance, axes))
    (folder / "arm.toml").write_text(_ROBOT)
    return load_robot(folder / "arm.toml")


def swing(
    robot: Robot,
    seconds: float,
    seed: int,
    tool_mass: float = 0.0,
    elbow_zero: float = 0.0,
    tilt: tuple[float, float] = (0.0, 0.0),
    axes: str = "yx",
    states_gains: bool = True,
) -> MotorLog:
    """Log of the arm with a tool, and the loads of the model of ``robot``, which has these axes.

    ``elbow_zero`` is added to logged command and angle of the elbow [rad]. ``tilt`` is roll and
    pitch of the base [rad].
    """
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    joints = len(axes)
    commands = np.array([0.0, 0.6, 0.8])[-joints:] + _sines(rng, time, joints)

    model = mujoco.MjModel.from_xml_string(mjcf(tool_mass, axes=axes))
    model.opt.timestep = PERIOD / FINE
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.gravity[:] = gravity_in_base(np.array(tilt), GRAVITY)
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

    gains = {}
    if states_gains:
        ones = np.ones_like(angles)
        gains = {"logged_kp": KP * ones, "logged_kd": KD * ones}
    zeros = np.zeros(joints)
    zeros[-1] = elbow_zero
    log = log_of(
        time,
        commands + zeros,
        angles + zeros + 1e-4 * rng.standard_normal(angles.shape),
        joint_vel=velocities,
        **gains,
        **joints_of(robot),
    )
    return with_loads(log, robot)


def _sines(rng: np.random.Generator, time: np.ndarray, joints: int) -> np.ndarray:
    frequency = np.exp(rng.uniform(np.log(0.1), np.log(2.5), (6, joints)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, joints))
    sines = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    return 0.25 * np.sum(sines * np.minimum(1.0, 0.5 / frequency), axis=1)
