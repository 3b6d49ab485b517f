"""A hobby servo on a pendulum, from its table to its constants.

The servo is at its torque limit, has a coarse encoder, and is logged at 100 rows/s.
"""

from pathlib import Path

import numpy as np
import pytest
from motor_logs import TABLE_MAP

import motorprior as mp
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.progress import SILENT

# the servo
KP = 8.0  # [N·m/rad]
KD = 0.3  # [N·m·s/rad]
LIMIT = 1.6  # [N·m]
ARMATURE = 0.004  # [kg·m²]
COULOMB = 0.06  # [N·m]
VISCOUS = 0.03  # [N·m·s/rad]
DELAY = 0.02  # [s]
TICK = 0.29  # resolution of the encoder [deg]

# the pendulum: a point mass at the end of a rod
MASS = 0.3  # [kg]
LENGTH = 0.15  # [m]
ROD = 0.04  # [kg]

# the log, and the step of the simulation [s]
ROWS = 2400
PERIOD = 0.01
STEP = 2e-4
MODEL = f"""<mujoco><option timestep="0.002"/><worldbody><body name="arm" pos="0 0 0.5">
<joint name="swing" type="hinge" axis="0 1 0" range="-120 120"/>
<inertial pos="0 0 {-(MASS + 0.5 * ROD) * LENGTH / (MASS + ROD)}" mass="{MASS + ROD}" 
diaginertia="INERTIA INERTIA 1e-5"/>
</body></worldbody></mujoco>"""
ROBOT = """name = "pendulum"
motor = "My servo"
model = "pendulum.xml"
base = "fixed"
nominal_pose = [0.0]
kp = 5.0
kd = 0.2
torque_limit = 1.5
"""
UNITS = '[units]\ntime = "ms"\nangle = "deg"\ngain = "firmware"\n'
COLUMNS = f'{TABLE_MAP}posture = "fixed"\n{UNITS}[joints.swing]\nkp = 32\n'
HEADER = "t,goal_swing,pos_swing"


def goals() -> np.ndarray:
    """(ROWS,) steps and sines in turn, 4 s each [deg]."""
    rng = np.random.default_rng(1)
    time = PERIOD * np.arange(400)
    angles = []

    for frequency in (0.7, 1.5, 3.0):
        steps = np.repeat(rng.uniform(-80.0, 80.0, 8), 50)
        amplitude = min(70.0, 60.0 / frequency**0.7)
        sine = amplitude * np.sin(2.0 * np.pi * frequency * time)
        angles += [steps, sine]

    return TICK * np.round(np.concatenate(angles) / TICK)


def recorded(goal: np.ndarray) -> np.ndarray:
    """(ROWS,) readings of the encoder [deg]."""
    inertia = MASS * LENGTH**2 + ROD * LENGTH**2 / 3.0 + ARMATURE
    gravity = 9.81 * LENGTH * (MASS + 0.5 * ROD)
    targets = np.deg2rad(goal)
    steps_of_delay = round(DELAY / STEP)
    steps_per_row = round(PERIOD / STEP)
    angle = 0.0
    velocity = 0.0
    readings = []

    for step in range(ROWS * steps_per_row):
        if step % steps_per_row == 0:
            readings.append(angle)

        target = targets[max(0, step - steps_of_delay) // steps_per_row]
        torque = KP * (target - angle) - KD * velocity
        torque = min(LIMIT, max(-LIMIT, torque)) - VISCOUS * velocity - gravity * np.sin(angle)
        velocity += STEP * torque / inertia
        velocity = np.copysign(max(0.0, abs(velocity) - STEP * COULOMB / inertia), velocity)
        angle += STEP * velocity

    return TICK * np.round(np.rad2deg(readings) / TICK)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> mp.MotorLog:
    folder: Path = tmp_path_factory.mktemp("servo")
    goal = goals()
    milliseconds = 10 * np.arange(ROWS)
    lines = [HEADER]
    for time, target, angle in zip(milliseconds, goal, recorded(goal), strict=True):
        lines.append(f"{time},{target:.2f},{angle:.2f}")

    center = (MASS + 0.5 * ROD) * LENGTH / (MASS + ROD)
    inertia = MASS * LENGTH**2 + ROD * LENGTH**2 / 3.0 - (MASS + ROD) * center**2
    texts = {
        "servo.csv": "\n".join(lines),
        "columns.toml": COLUMNS,
        "pendulum.toml": ROBOT,
        "pendulum.xml": MODEL.replace("INERTIA", f"{inertia:.8f}"),
    }

    for name, text in texts.items():
        (folder / name).write_text(text)

    columns = folder / "columns.toml"
    robot = folder / "pendulum.toml"

    return mp.load_log(
        folder / "servo.csv", columns=columns, robot=robot, suspended=True, progress=SILENT
    )


def test_duplicate_rows_and_single_failed_reads_are_left_out(tmp_path: Path):
    angle = np.repeat([0.0, -30.0, 20.0], 40) + 0.29 * np.tile([0.0, 1.0], 60)
    failed = angle.copy()
    failed[[60, 100]] = 0.0
    duplicated = np.insert(np.arange(120), 9, 9)
    rows = [f"{10 * row},{angle[row]:.2f},{failed[row]:.2f}" for row in duplicated]
    (tmp_path / "servo.csv").write_text("\n".join([HEADER, *rows]))
    (tmp_path / "columns.toml").write_text(COLUMNS)
    log = mp.load_log(
        tmp_path / "servo.csv",
        columns=tmp_path / "columns.toml",
        settings=mp.LogSettings(period=None),
        allow_errors=True,  # one command with the angle is enough here
        progress=SILENT,
    )

    assert log.num_rows == 118  # without one duplicate and two failed reads


def test_commands_stay_steps(log: mp.MotorLog):
    moved = np.flatnonzero(np.diff(log.position_target[:500, 0]))
    assert 1 <= len(moved) <= 3  # two steps in a second


@pytest.mark.parametrize("seed", [1, 3])
def test_a_fit_recovers_the_constants_of_a_servo_at_its_torque_limit(log: mp.MotorLog, seed: int):
    prior = mp.fit_prior(log, preset="quick", seed=seed, progress=SILENT)
    motors = prior.training_motors(np.array([0]))
    assert isinstance(motors, GreyBoxActuator)
    constants = {name: values.item() for name, values in motors.constants().items()}
    error = prior.metrics.replay_rmse

    assert error is not None and error < 4e-3, constants
    assert constants["delay"] == pytest.approx(DELAY, abs=2e-3)
    for name, value, tolerance in (
        ("kp", KP, 0.15),
        ("torque_limit", LIMIT, 0.1),
        ("armature", ARMATURE, 0.2),
    ):
        assert constants[name] == pytest.approx(value, rel=tolerance), constants

    assert constants["coulomb"] + constants["stribeck_torque"] == pytest.approx(COULOMB, rel=0.3), (
        constants
    )
