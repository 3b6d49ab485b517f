"""Virtual motors that each swing a bar of known inertia and weight, recorded as a user would: command and angle."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from motor_logs import TABLE_MAP, log_of, write_table

from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.motors import Motors
from motorprior.actuator.physical import PhysicalMotors
from motorprior.bench.dynamometer import next_velocity
from motorprior.logs.motor_log import MotorLog

INERTIA = np.array([0.005, 0.012])
WEIGHT = np.array([0.4, 0.7])
HANGS_AT = np.array([-0.4, 1.0])
PERIOD = 0.002
FINE = 8
SPEED = 2.0 * np.pi * np.array([0.3, 0.7, 1.3, 2.2, 3.5])
SIZE = np.array([0.5, 0.3, 0.2, 0.1, 0.05])


@dataclass(frozen=True)
class Bars:
    log: MotorLog
    motors: PhysicalMotors

    @property
    def gravity(self) -> np.ndarray:
        """(M, 2): WEIGHT·sin(q - HANGS_AT) = s·sin q + c·cos q."""
        return np.stack([WEIGHT * np.cos(HANGS_AT), -WEIGHT * np.sin(HANGS_AT)], axis=1)


def swing(seconds: float) -> Bars:
    """Sines, then steps; angles with 0.3 mrad of noise."""
    motors = load_fleet("mixed").sample(2, 2)
    rng = np.random.default_rng(2)
    assert isinstance(motors, PhysicalMotors)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, len(SPEED)))
    target = np.einsum("k,tjk->tj", SIZE, np.sin(time[:, None, None] * SPEED + phase))
    second_half = time >= 0.5 * time[-1]
    steps = rng.uniform(-0.8, 0.8, (len(time) // 400 + 1, 2)).repeat(400, axis=0)[: len(time)]
    target[second_half] = steps[second_half]
    angle = _angles(motors, target)
    seen = angle + 3e-4 * rng.standard_normal(angle.shape)
    kp, kd = (np.tile(gain, (len(time), 1)) for gain in (motors.kp, motors.kd))
    known = {
        "joint_names": ("left", "right"),
        "robot": "bars",
        "motor": "any",
        "logged_kp": kp,
        "logged_kd": kd,
    }
    return Bars(log_of(time, target, seen, **known), motors)


def _angles(motors: PhysicalMotors, target: np.ndarray) -> np.ndarray:
    q = target[0].copy()
    dq = np.zeros(2)
    h = PERIOD / FINE
    running = Motors(motors.actuator(), h, q)
    found = np.empty_like(target)
    for row, command in enumerate(target):
        found[row] = q
        for _ in range(FINE):
            torque, damping = running.step(command, q, dq)
            dq = next_velocity(
                dq, torque, -WEIGHT * np.sin(q - HANGS_AT), INERTIA + running.armature, damping, h
            )
            q = q + h * dq
    return found


def bars_table(bars: Bars, folder: Path) -> tuple[Path, Path]:
    """A table in ms and degrees, and its column map, which states the gains."""
    log = bars.log
    columns = folder / "bars.toml"
    joints = [
        f"[joints.{joint}]\nkp = {kp}\nkd = {kd}\n"
        for joint, kp, kd in zip(log.joint_names, bars.motors.kp, bars.motors.kd, strict=True)
    ]
    columns.write_text(
        f'robot = "bars"\n{TABLE_MAP}[units]\ntime = "ms"\nangle = "deg"\n' + "".join(joints)
    )
    return write_table(log, folder / "swing.csv", 1e3, 180.0 / np.pi), columns
