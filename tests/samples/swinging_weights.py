"""Logs of geared motors that swing known weights, with something that the log does not state."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from motor_logs import log_of

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motors import Motors
from motorprior.bench.dynamometer import next_velocity
from motorprior.identification.physics.motor_problem import INITIAL_MOTOR, encoded
from motorprior.logs.motor_log import MotorLog

PERIOD = 0.002
"""Period of the log [s]."""

FINE = 4
"""Steps of the simulation per period."""

KP = 20.0
"""Proportional gain of the motors [N·m/rad]."""

KD = 1.0
"""Derivative gain of the motors [N·m·s/rad]."""

INERTIA = 0.06
"""Inertia of the weights about their joints [kg·m²]."""

WEIGHT = 2.0
"""Largest torque of gravity on the weights [N·m]."""

MOTOR = INITIAL_MOTOR | {
    "kp": KP,
    "kd_over_kp": KD / KP,
    "delay": 0.005,
    "torque_limit": 30.0,
    "armature": 0.012,
    "coulomb": 0.15,
    "stribeck_torque": 0.02,
    "viscous_damping": 0.05,
    "load_friction": 0.01,
    "gear_stiffness": 900.0,
    "backlash": 0.001,
    "gear_damping": 0.3,
}


@dataclass(frozen=True)
class World:
    """What really happens; all of it is unknown to the log."""

    # (time (N, 1) [s], command (N, J) [rad]) -> command that the motors get
    command: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda time, command: command
    # share of the weight that the controller compensates
    compensation: float = 0.0
    # times [s] from which the motors have no torque, and have torque again
    off_after: float = np.inf
    on_after: float = np.inf
    # angle of an end stop [rad]
    stop: float = np.inf
    # angle at which the weights hang down, of all or of each (J,) [rad]
    hangs_at: float | np.ndarray = 0.0
    # factor on weight and inertia
    load: float = 1.0
    # commands and angles over the logged ones
    ratio: float = 1.0


def swing(
    seconds: float,
    seed: int,
    joints: int = 1,
    world: World | None = None,
    stated_gains: float | None = 1.0,
    has_steps: bool = True,
) -> MotorLog:
    """Log of ``joints`` motors in sines, and in steps, around 0.3 rad.

    It states ``stated_gains`` times the true gains, or none.
    """
    world = world or World()
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    target = 0.3 + _sines(rng, time, joints)
    if has_steps:
        target = target + _steps(rng, time, joints)
    angle = _angles(time, world.ratio * target, world) / world.ratio
    angle = angle + 2e-4 * rng.standard_normal(angle.shape)

    ones = np.ones_like(angle)
    gains = {}
    if stated_gains is not None:
        gains = {"logged_kp": stated_gains * KP * ones, "logged_kd": stated_gains * KD * ones}
    return log_of(
        time,
        target,
        angle,
        joint_names=("left", "right", "middle")[:joints],
        load_inertia=INERTIA * ones,
        external_torque=-WEIGHT * np.sin(angle),
        load_stiffness=-WEIGHT * np.cos(angle),
        **gains,
    )


def _sines(rng: np.random.Generator, time: np.ndarray, joints: int) -> np.ndarray:
    frequency = np.exp(rng.uniform(np.log(0.1), np.log(2.5), (6, joints)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, joints))
    sines = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    return 0.3 * np.sum(sines * np.minimum(1.0, 0.5 / frequency), axis=1)


def _steps(rng: np.random.Generator, time: np.ndarray, joints: int) -> np.ndarray:
    rows = 300
    steps = rng.uniform(-0.4, 0.4, (len(time) // rows + 1, joints)).repeat(rows, axis=0)
    steps[rng.random(len(steps)) < 0.3] *= 0.5
    return steps[: len(time)]


def _angles(time: np.ndarray, target: np.ndarray, world: World) -> np.ndarray:
    """(N, J) angles [rad] from rest at the first target."""
    joints = target.shape[1]
    model = GreyBox(encoded(MOTOR, ()), np.eye(len(encoded(MOTOR, ()))), PERIOD)
    h = PERIOD / FINE
    commands = world.command(time[:, None], target)
    q = np.minimum(commands[0], world.stop)
    dq = np.zeros(joints)
    motors = Motors(model.motors(np.zeros((joints, model.num_latents))), h, q)

    angles = np.empty_like(target)
    inertia = world.load * INERTIA + motors.armature
    for row, command in enumerate(commands):
        angles[row] = q
        for _ in range(FINE):
            torque, damping = motors.step(command, q, dq)
            if world.off_after <= time[row] < world.on_after:
                torque = torque * 0.0 - 0.1 * dq
                damping = 0.0 * damping
            weight = -world.load * WEIGHT * np.sin(q - world.hangs_at)
            weight = weight + world.compensation * world.load * WEIGHT * np.sin(q)
            dq = next_velocity(dq, torque, weight, inertia, damping, h)
            q = q + h * dq
            is_stopped = q > world.stop
            q = np.where(is_stopped, world.stop, q)
            dq = np.where(is_stopped, np.minimum(dq, 0.0), dq)
    return angles
