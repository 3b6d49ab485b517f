"""Behaviour of a prior's classes of joints on a bench."""

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.geared_motor_step import STRIBECK_VELOCITY
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import response_of_all

LOAD = 3.0  # inertia of the load over the motor's armature [-]
MIN_ARMATURE = 1e-3  # of a network, for its load [kg·m²]
NUM_SAMPLES = 100
# step
SETTLE = 0.1  # time before the step [s]
STEP = 0.2  # height [rad]
STEP_DURATION = 1.5  # time after the step [s]
# chirp
CHIRP = (0.5, 8.0)  # first and last frequency [Hz]
CHIRP_DURATION = 4.0  # [s]
CHIRP_AMPLITUDE = 0.1  # [rad]
# friction
SPEEDS = np.linspace(0.0, 6.0, 61)  # at which it is evaluated [rad/s]


@dataclass(frozen=True)
class ClassBehaviour:
    """Responses of samples of one class and of its training motors: name -> (D, T) and (M, T)."""

    name: str
    axes: dict[str, np.ndarray]  # (T,) time [s], or speed [rad/s]
    sampled: dict[str, np.ndarray]
    training_motors: dict[str, np.ndarray]


def class_behaviours(prior: MotorPrior) -> list[ClassBehaviour]:
    """Behaviour of NUM_SAMPLES samples and of the training motors of every class.

    The step and chirp responses [rad] are on a load of LOAD. Grey boxes also have friction [N·m].
    """
    return [_class_behaviour(prior, name, index) for index, name in enumerate(prior.classes.names)]


def _class_behaviour(prior: MotorPrior, name: str, index: int) -> ClassBehaviour:
    period = prior.model.period
    sampled = prior.sample((name,) * NUM_SAMPLES, np.random.default_rng([0, index]))
    training_motors = prior.training_motors(prior.classes.rows_of(name))

    if isinstance(training_motors, GreyBoxActuator):
        armature = training_motors.constants()["armature"]
    else:
        armature = np.maximum(training_motors.armature, MIN_ARMATURE)
    inertia = LOAD * float(np.median(armature))

    responses = _responses(sampled, inertia, period)
    axes = {}
    for key, values in responses.items():
        axes[key] = SPEEDS if key == "friction" else period * np.arange(values.shape[1])
    return ClassBehaviour(name, axes, responses, _responses(training_motors, inertia, period))


def _responses(motors: Actuator, inertia: float, period: float) -> dict[str, np.ndarray]:
    """(n, T) responses by name, see `class_behaviours`."""
    responses = {}
    for name, target in (("step", _step(period)), ("chirp", _chirp(period))):
        response = response_of_all(motors, target, inertia, 0.0, period)
        responses[name] = response.joint_pos.T

    if isinstance(motors, GreyBoxActuator):
        responses["friction"] = _friction(motors)
    return responses


def _step(period: float) -> np.ndarray:
    """Target of the step [rad]."""
    target = np.full(round((SETTLE + STEP_DURATION) / period), STEP)
    target[: round(SETTLE / period)] = 0.0
    return target


def _chirp(period: float) -> np.ndarray:
    """Target of the chirp [rad]."""
    low, high = CHIRP
    time = np.arange(0.0, CHIRP_DURATION, period)
    phase = 2.0 * np.pi * time * (low + 0.5 * (high - low) * time / CHIRP_DURATION)
    return CHIRP_AMPLITUDE * np.sin(phase)


def _friction(motors: GreyBoxActuator) -> np.ndarray:
    """(n, SPEEDS) friction torque of motors without load [N·m]."""
    constants = {name: value[:, None] for name, value in motors.constants().items()}
    stribeck = constants["stribeck_torque"] / (1.0 + (SPEEDS / STRIBECK_VELOCITY) ** 2)
    return constants["coulomb"] + stribeck + constants["viscous_damping"] * SPEEDS
