"""Behaviour of a prior's classes of joints on a bench."""

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.geared_motor_step import STRIBECK_VELOCITY
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import respond_alike

LOAD = 3.0  # inertia of the load over the motor's armature [-]
# before the step [s], its height [rad], time after it [s]
SETTLE = 0.1
STEP = 0.2
STEP_DURATION = 1.5
# first and last frequency [Hz], [s], [rad]
CHIRP = (0.5, 8.0)
CHIRP_DURATION = 4.0
CHIRP_AMPLITUDE = 0.1
SPEEDS = np.linspace(0.0, 6.0, 61)  # at which friction is evaluated [rad/s]
NUM_SAMPLES = 100


@dataclass(frozen=True)
class ClassBehaviour:
    """Responses of samples of one class and of its training motors: name -> (D, T) and (M, T)."""

    name: str
    axes: dict[str, np.ndarray]  # (T,) time [s], or speed [rad/s]
    sampled: dict[str, np.ndarray]
    training_motors: dict[str, np.ndarray]


def class_behaviours(prior: MotorPrior) -> list[ClassBehaviour]:
    """Step and chirp response [rad] on a load of LOAD, and friction [N·m] of grey boxes, of NUM_SAMPLES samples."""
    found = []
    period = prior.model.period
    for name in prior.classes.names:
        sampled = prior.sample((name,) * NUM_SAMPLES, np.random.default_rng([0, len(found)]))
        trained = prior.training_motors(prior.classes.rows_of(name))
        has_physics = isinstance(trained, GreyBoxActuator)
        armature = (
            trained.constants()["armature"] if has_physics else np.maximum(trained.armature, 1e-3)
        )
        inertia = LOAD * float(np.median(armature))
        responses = _responses(sampled, inertia, period)
        axes = {}
        for key, values in responses.items():
            axes[key] = SPEEDS if key == "friction" else period * np.arange(values.shape[1])
        found.append(ClassBehaviour(name, axes, responses, _responses(trained, inertia, period)))
    return found


def _responses(motors: Actuator, inertia: float, period: float) -> dict[str, np.ndarray]:
    target = np.full(round((SETTLE + STEP_DURATION) / period), STEP)
    target[: round(SETTLE / period)] = 0.0
    time, (low, high) = np.arange(0.0, CHIRP_DURATION, period), CHIRP
    phase = 2.0 * np.pi * time * (low + 0.5 * (high - low) * time / CHIRP_DURATION)
    targets = {"step": target, "chirp": CHIRP_AMPLITUDE * np.sin(phase)}
    found = {
        name: respond_alike(motors, each, inertia, 0.0, period).joint_pos.T
        for name, each in targets.items()
    }
    if isinstance(motors, GreyBoxActuator):
        values = {name: value[:, None] for name, value in motors.constants().items()}
        stribeck = values["stribeck_torque"] / (1.0 + (SPEEDS / STRIBECK_VELOCITY) ** 2)
        found["friction"] = values["coulomb"] + stribeck + values["viscous_damping"] * SPEEDS
    return found
