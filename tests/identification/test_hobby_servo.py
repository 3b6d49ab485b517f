"""A hobby servo on a pendulum, at its torque limit, with a coarse encoder and 100 rows/s: from table to constants."""

from pathlib import Path

import numpy as np
import pytest
from motor_logs import TABLE_MAP

import motorprior as mp
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.progress import SILENT

KP = 8.0
KD = 0.3
LIMIT = 1.6
ARMATURE = 0.004
COULOMB = 0.06
VISCOUS = 0.03
DELAY = 0.02
MASS = 0.3
LENGTH = 0.15
ROD = 0.04
TICK = 0.29
ROWS = 2400
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
    time = 0.01 * np.arange(400)
    parts = []
    for frequency in (0.7, 1.5, 3.0):
        parts += [np.repeat(rng.uniform(-80.0, 80.0, 8), 50)]
        parts += [min(70.0, 60.0 / frequency**0.7) * np.sin(2.0 * np.pi * frequency * time)]
    return TICK * np.round(np.concatenate(parts) / TICK)


def recorded(goal: np.ndarray) -> np.ndarray:
    """(ROWS,) readings of the encoder [deg]."""
    inertia = MASS * LENGTH**2 + ROD * LENGTH**2 / 3.0 + ARMATURE
    gravity = 9.81 * LENGTH * (MASS + 0.5 * ROD)
    targets = np.deg2rad(goal)
    late = round(DELAY / STEP)
    every = round(0.01 / STEP)
    angle = 0.0
    velocity = 0.0
    found = []
    for step in range(ROWS * every):
        if step % every == 0:
            found.append(angle)
        torque = KP * (targets[max(0, step - late) // every] - angle) - KD * velocity
        torque = min(LIMIT, max(-LIMIT, torque)) - VISCOUS * velocity - gravity * np.sin(angle)
        velocity += STEP * torque / inertia
        velocity = np.copysign(max(0.0, abs(velocity) - STEP * COULOMB / inertia), velocity)
        angle += STEP * velocity
    return TICK * np.round(np.rad2deg(found) / TICK)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> mp.MotorLog:
    folder: Path = tmp_path_factory.mktemp("servo")
    goal = goals()
    rows = zip(10 * np.arange(ROWS), goal, recorded(goal), strict=True)
    table = "\n".join(
        [HEADER, *(f"{time},{target:.2f},{angle:.2f}" for time, target, angle in rows)]
    )
    center = (MASS + 0.5 * ROD) * LENGTH / (MASS + ROD)
    inertia = MASS * LENGTH**2 + ROD * LENGTH**2 / 3.0 - (MASS + ROD) * center**2
    texts = {"servo.csv": table, "columns.toml": COLUMNS, "pendulum.toml": ROBOT}
    texts["pendulum.xml"] = MODEL.replace("INERTIA", f"{inertia:.8f}")
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
        progress=SILENT,
    )
    assert log.num_rows == 118  # without one duplicate and two failed reads


def test_commands_stay_steps(log: mp.MotorLog):
    moved = np.flatnonzero(np.diff(log.position_target[:500, 0]))
    assert 1 <= len(moved) <= 3  # two steps in a second


@pytest.mark.parametrize("seed", [1, 3])
def test_the_constants_of_a_servo_at_its_torque_limit(log: mp.MotorLog, seed: int):
    prior = mp.fit_prior(log, preset="quick", seed=seed, progress=SILENT)
    motors = prior.training_motors(np.array([0]))
    assert isinstance(motors, GreyBoxActuator)
    found = {name: each.item() for name, each in motors.constants().items()}
    error = prior.metrics.replay_rmse
    assert error is not None and error < 4e-3, found
    assert found["delay"] == pytest.approx(DELAY, abs=2e-3)
    for name, value, tolerance in (
        ("kp", KP, 0.15),
        ("torque_limit", LIMIT, 0.1),
        ("armature", ARMATURE, 0.2),
    ):
        assert found[name] == pytest.approx(value, rel=tolerance), found
    assert found["coulomb"] + found["stribeck_torque"] == pytest.approx(COULOMB, rel=0.3), found
