"""An arm on a fixed base whose motors give way under its weight, recorded in slow motion."""

from pathlib import Path

import numpy as np
from motor_logs import TABLE_MAP, log_of, write_table

from motorprior.logs.loads import gravity_torque
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.load import load_robot

JOINTS = ("shoulder", "elbow")

KP = 20.0
"""Stiffness of the motors [N·m/rad]."""

FRICTION = 0.01
"""Error of position by dry friction [rad]."""

LAG = 0.03
"""Error of position per speed [s]."""

DESCRIPTION = """
name = "arm"
motor = "servo"
model = "arm.xml"
base = "fixed"
nominal_pose = 0.0
kp = 20.0
kd = 0.5
torque_limit = 5.0
"""
MODEL = """<mujoco><worldbody><body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<joint name="shoulder" axis="0 1 0" range="-120 120"/>
<body pos="0.2 0 0"><inertial pos="0.1 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/>
<joint name="elbow" axis="0 1 0" range="-120 120"/>
</body></body></worldbody></mujoco>"""


def write_arm(folder: Path) -> str:
    """Path of the robot's description, with its model beside it."""
    (folder / "arm.toml").write_text(DESCRIPTION, "utf-8")
    (folder / "arm.xml").write_text(MODEL, "utf-8")
    return str(folder / "arm.toml")


def slow_motion(robot: str) -> MotorLog:
    """Log of 20 s at 100 Hz, both joints up to 0.3 rad/s."""
    time = 0.01 * np.arange(2000)
    rate = 2.0 * np.pi * np.array([0.05, 0.07])
    phase = np.array([0.0, 1.0])
    angle = 0.7 * np.sin(rate * time[:, None] + phase)
    speed = 0.7 * rate * np.cos(rate * time[:, None] + phase)
    log = log_of(time, angle, angle.copy(), joint_names=JOINTS, robot="arm", motor="servo")
    gravity = gravity_torque(log, load_robot(robot))
    assert gravity is not None

    sag = gravity(angle) / KP
    log.position_target[:] = angle - sag + FRICTION * np.sign(speed) + LAG * speed
    return log


def arm_table(log: MotorLog, folder: Path, turned: str = "") -> tuple[Path, str]:
    """Paths of a table in rad and of its column map, in which the sign of a joint may be turned."""
    columns = folder / "columns.toml"
    signs = ""
    for joint in JOINTS:
        sign = -1 if joint == turned else 1
        signs += f"[joints.{joint}]\nsign = {sign}\n"

    columns.write_text(f'robot = "arm"\n{TABLE_MAP}{signs}', "utf-8")
    return write_table(log, folder / "arm.csv"), str(columns)
