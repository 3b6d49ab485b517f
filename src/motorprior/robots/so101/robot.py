"""SO-101 follower arm (TheRobotStudio/SO-ARM100) as a `Robot`, with the sources of its constants.

so101.xml has the links of ``so101_new_calib``, whose zero is the middle of each joint's range. The
limits are the model's.
"""

from pathlib import Path

from motorprior.robots.model_source import ModelFile
from motorprior.robots.motor_models import MotorModel, StatedValue
from motorprior.robots.robot import GRAVITY, Joint, Robot
from motorprior.robots.servos import ServoChain

_FOLDER = Path(__file__).parent
_FLEETS = ("so101", "so101_servos")
_LIMITS = {
    "shoulder_pan": (-1.9198621771937616, 1.9198621771937634),
    "shoulder_lift": (-1.7453292519943224, 1.7453292519943366),
    "elbow_flex": (-1.69, 1.69),
    "wrist_flex": (-1.6580628494556928, 1.6580627293335335),
    "wrist_roll": (-2.7438472969992493, 2.841206309382605),
    "gripper": (-0.17453297762778586, 1.7453291995659765),
}
# kp [N·m/rad], kd [N·m·s/rad] and torque limit [N·m]: the model's position actuators, which are
# fitted to one unit
_GAINS = (17.8, 0.6, 3.35)
_COUNT = len(_LIMITS)
# Torque limit: forcerange of so101.xml. Speed without load: assumption, 0.19 to 0.22 s per 60
# degrees. The standard deviations are assumptions.
_STS3215 = MotorModel(
    "STS3215", torque_limit=StatedValue(3.35, 0.15), max_speed=StatedValue(5.0, 0.15)
)
_SERVOS = ServoChain(
    model="STS3215",
    ids=tuple(range(1, _COUNT + 1)),  # LeRobot's numbers, from the base to the gripper
    # LeRobot's calibration makes the middle of the range count 2048. Assumed: counts grow with the
    # angles of the model; docs/hardware.md describes how to check it.
    signs=(1,) * _COUNT,
    zeros=(2048,) * _COUNT,
    fleet="so101_servos",
    rest=(0.0, -1.74, 1.68, 1.2, 0.0, 0.0),  # folded
)
SO101 = Robot(
    name="so101",
    motor="Feetech STS3215",
    joints=tuple(Joint(name, *limits, *_GAINS) for name, limits in _LIMITS.items()),
    base="fixed",
    model=ModelFile.of(_FOLDER / "so101.xml"),
    num_links=7,
    nominal=(
        0.0,
        -0.6,
        0.0,
        0.0,
        0.0,
        0.8,
    ),  # raised: half a radian about it, it is free of the table
    weight=round(GRAVITY * 0.632006, 9),
    reference_torque=2.68,  # 0.8 of the torque limit
    load_inertia=(4.8e-6, 0.025),  # from the model, about the joints
    given_classes=tuple(_LIMITS),  # one motor, other places
    motor_models=(_STS3215,) * _COUNT,
    fleets=tuple((name, str(_FOLDER / "fleets" / f"{name}.toml")) for name in _FLEETS),
    twin_physics_dt=0.00025,  # the jaw is light: at 1 ms a physical gear on it would be unstable
    servos=_SERVOS,
)
