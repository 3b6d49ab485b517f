"""Virtual motors that swing bars of known inertia and weight; a log has commands and angles."""

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
"""Inertia of the bars about their joints [kg·m²]."""

WEIGHT = np.array([0.4, 0.7])
"""Largest torque of gravity on the bars [N·m]."""

HANGS_AT = np.array([-0.4, 1.0])
"""Angles at which the bars hang down [rad]."""

PERIOD = 0.002
"""Period of the log [s]."""

FINE = 8
"""Steps of the simulation per period."""

SPEED = 2.0 * np.pi * np.array([0.3, 0.7, 1.3, 2.2, 3.5])
"""Angular frequencies of the sines [rad/s]."""

SIZE = np.array([0.5, 0.3, 0.2, 0.1, 0.05])
"""Amplitudes of the sines [rad]."""


@dataclass(frozen=True)
class Bars:
    """A log of two bars and the true motors."""

    log: MotorLog
    motors: PhysicalMotors

    @property
    def gravity(self) -> np.ndarray:
        """(M, 2) coefficients (s, c) of WEIGHT·sin(q - HANGS_AT) = s·sin q + c·cos q [N·m]."""
        return np.stack([WEIGHT * np.cos(HANGS_AT), -WEIGHT * np.sin(HANGS_AT)], axis=1)


def swing(seconds: float) -> Bars:
    """Bars in sines and then in steps; angles with 0.3 mrad of noise."""
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
    measured_angle = angle + 3e-4 * rng.standard_normal(angle.shape)
    log = log_of(
        time,
        target,
        measured_angle,
        joint_names=("left", "right"),
        robot="bars",
        motor="any",
        logged_kp=np.tile(motors.kp, (len(time), 1)),
        logged_kd=np.tile(motors.kd, (len(time), 1)),
    )
    return Bars(log, motors)


def _angles(motors: PhysicalMotors, target: np.ndarray) -> np.ndarray:
    """(N, 2) angles [rad] of the bars at (N, 2) targets, from rest at the first target."""
    q = target[0].copy()
    dq = np.zeros(2)
    h = PERIOD / FINE
    running = Motors(motors.actuator(), h, q)
    angles = np.empty_like(target)

    for row, command in enumerate(target):
        angles[row] = q
        for _ in range(FINE):
            torque, damping = running.step(command, q, dq)
            weight = -WEIGHT * np.sin(q - HANGS_AT)
            dq = next_velocity(dq, torque, weight, INERTIA + running.armature, damping, h)
            q = q + h * dq
    return angles


def bars_table(bars: Bars, folder: Path) -> tuple[Path, Path]:
    """Paths of a table in ms and degrees and of its column map, which states the gains."""
    log = bars.log
    columns = folder / "bars.toml"
    joints = [
        f"[joints.{joint}]\nkp = {kp}\nkd = {kd}\n"
        for joint, kp, kd in zip(log.joint_names, bars.motors.kp, bars.motors.kd, strict=True)
    ]
    units = '[units]\ntime = "ms"\nangle = "deg"\n'
    columns.write_text(f'robot = "bars"\n{TABLE_MAP}{units}' + "".join(joints))

    table = write_table(log, folder / "swing.csv", 1e3, 180.0 / np.pi)
    return table, columns
